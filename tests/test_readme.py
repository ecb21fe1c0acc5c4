"""What the README shows is true: its example file and its lines of Python work, its links and picture exist."""

import json
import re

import numpy as np
import pytest
from typer.testing import CliRunner

from fgrecon.cli import main
from fgrecon.io.catalogue import load_category
from fgrecon.io.keypoint_file import parse_keypoints

from .conftest import REPOSITORY

README = (REPOSITORY / "README.md").read_text()


def block(language):
    return re.search(rf"```{language}\n(.*?)```", README, re.DOTALL).group(1)


def test_the_keypoint_file(tmp_path):
    file = tmp_path / "cars.json"
    file.write_text(block("json"))
    done = CliRunner().invoke(main.app, ["reconstruct", str(file), "--json", "-", "--size-prior", "kitti"])
    assert done.exit_code == 0, done.output
    (car,) = json.loads(done.stdout)["instances"]
    assert car["id"] == "car-1"
    assert car["result"]["status"] == "converged"
    # it was made from a car at this place
    assert car["rotation_y"] == pytest.approx(0.7, abs=0.05)
    assert np.linalg.norm(np.subtract(car["location"], [-3.2, 1.65, 13.0])) < 1.0


def test_the_lines_of_python(capsys):
    (car,) = parse_keypoints(json.loads(block("json")), load_category("car14")).instances
    known = {
        "keypoints": car.keypoints,
        "intrinsics": (721.5377, 721.5377, 609.5593, 172.854),
        "confidence": car.confidence,
        "box": car.box,
    }
    exec(block("python"), known)
    assert capsys.readouterr().out.startswith("converged 0.")


@pytest.mark.parametrize("document", ["README.md", "docs/architecture.md"])
def test_links_lead_somewhere(document):
    text = (REPOSITORY / document).read_text()
    links = [link for link in re.findall(r"\]\(([^)]+)\)", text) if not link.startswith("http")]
    assert [link for link in links if not (REPOSITORY / link).exists()] == []


def test_every_named_option_exists():
    help_text = ""
    for command in (["demo"], ["reconstruct"], ["track"], ["replay"], ["evaluate", "tracks"], ["prior", "build"]):
        help_text += CliRunner().invoke(main.app, [*command, "--help"], terminal_width=200).stdout
    shell = "\n".join(re.findall(r"```bash\n(.*?)```", README, re.DOTALL))
    named = set(re.findall(r"(--[a-z-]+)", shell + "\n".join(re.findall(r"`(--[^`]+)`", README))))
    assert named - {"--quiet", "--help"} <= set(re.findall(r"--[a-z-]+", help_text))


@pytest.mark.parametrize("name", ["demo", "recording"])
def test_the_pictures_are_small(name):
    assert (REPOSITORY / f"docs/images/{name}.png").stat().st_size < 400_000
