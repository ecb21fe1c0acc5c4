"""What the README shows is true: its Python works, its pictures are small, `.ci/run` finds its test command."""

import re
import tomllib

import numpy as np
import pytest
from typer.testing import CliRunner

from fgrecon.cli import main
from tests.conftest import REPOSITORY
from tests.docs.pages import blocks

README = (REPOSITORY / "README.md").read_text(encoding="utf-8")


def test_the_one_call():
    known = {}
    exec(blocks(README, "python")[0], known)
    result = known["result"]
    assert result.status == "converged"
    # its keypoints were made from a car at this place
    assert result.rotation_y == pytest.approx(0.7, abs=0.1)
    assert np.linalg.norm(result.location - [-3.2, 1.65, 13.0]) < 1.5


@pytest.mark.slow
def test_from_a_photograph(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(main.app, ["sample", "--out", "sample"]).exit_code == 0
    known = {"fgrecon": __import__("fgrecon")}
    exec(blocks(README, "python")[1], known)
    assert any(car.result is not None for car in known["cars"])


def test_two_commands_do_all_the_set_up():
    install = [line for line in "".join(blocks(README, "bash")).splitlines() if "pip install" in line]
    assert len(install) == 2
    assert "fgrecon demo" in install[0]
    marked = re.search(r"<!-- tests -->\n```bash\n(.*)\n```\n<!-- end -->", README).group(1)
    assert marked == install[1]
    assert "pytest" in marked


def test_it_is_short():
    assert len(README.split()) <= 700


def test_the_citation_has_the_version():
    version = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    assert f"\nversion: {version}\n" in (REPOSITORY / "CITATION.cff").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", ["demo.jpg", "demo.gif", "recording.png"])
def test_the_pictures_are_small(name):
    assert (REPOSITORY / f"docs/images/{name}").stat().st_size < 400_000
