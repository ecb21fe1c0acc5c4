"""README, tutorial, guides and other pages run as they stand, in the order of the page, in an empty folder."""

import re
import shlex
import shutil
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from fgrecon.cli import main
from fgrecon_research.cli import COMMANDS
from tests.conftest import REPOSITORY
from tests.docs.pages import PAGES, commands, fenced, name_of

GUIDES = [
    REPOSITORY / "README.md",
    REPOSITORY / "docs/index.md",
    REPOSITORY / "docs/tutorial/index.md",
    REPOSITORY / "docs/reference/options.md",
    REPOSITORY / "docs/reference/formats.md",
    *sorted((REPOSITORY / "docs/explanation").glob("*.md")),
    *sorted((REPOSITORY / "docs/how-to").glob("*.md")),
]
NEEDS_MORE = {
    r"\bDATA\b|nuscenes/|av2/|kitti360#": "real data",
    r"learn keypoints\.npz": "annotations of the user's",
    r"^fgrecon replay \S+$": "a window",
    r"--web": "serves until it is stopped",
}
"""What in a line of a shell block says that the tests cannot run it, and what it needs."""
OTHER_ENGINES = "ray.data", "map_partitions", "mapInArrow", "import apache_beam", "from ultralytics"
"""What in a `py` block says that it is a piece for a package that is not there."""
INSTALL = {
    "fgrecon-research": r"\[fgrecon-research\]\(|\./research",
    "video": r"\[video\]|extra\S* `video`",
}
"""Words by which a page names a package or an extra."""
SAMPLE = "fgrecon sample --out sample"
ELSEWHERE = {
    "CONTRIBUTING.md": "what the workflow runs",
    "docs/reference/licences.md": "the workflow's job `build`",
    "fgrecon/data/sizes/kitti.md": "real data",
    "fgrecon/data/weights/keypoints-car14-history.md": "real data, for hours",
}
"""Pages whose blocks do not run here, and why; those of the API pages are doctests."""


@pytest.fixture(scope="session")
def sample(tmp_path_factory):
    """A folder in which `fgrecon sample --out sample` has run."""
    folder = tmp_path_factory.mktemp("guides")
    done = CliRunner().invoke(main.app, ["sample", "--out", str(folder / "sample")])
    assert done.exit_code == 0, done.output
    return folder / "sample"


UNTRAINED = pytest.mark.filterwarnings("ignore::fgrecon.errors.ContradictoryInputWarning")  # hardly a point fits


@pytest.mark.slow
@pytest.mark.parametrize(
    "guide", [pytest.param(one, id=one.stem, marks=UNTRAINED if one.stem == "network" else ()) for one in GUIDES]
)
def test_its_blocks_run_in_order_in_an_empty_folder(guide, sample, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    if guide.stem == "formats":  # a page to look something up: the results that it reads are there
        shutil.copytree(sample, "sample")
        run_commands("```bash\nfgrecon reconstruct sample/cars.json --json result.json\n```\n", sample)
    names = {}
    for language, block in fenced(guide.read_text(encoding="utf-8")):
        if language == "python":
            names = {"__name__": guide.stem}  # no block needs another one's names
            exec(compile(block, guide.name, "exec"), names)
        elif language == "py" and not any(word in block for word in OTHER_ENGINES):
            (tmp_path / "script.py").write_text(block, encoding="utf-8")
            subprocess.run([sys.executable, "script.py"], check=True, capture_output=True)
        elif language == "bash":
            run_commands(f"```bash\n{block}```\n", sample)
    if guide.stem == "photograph":  # "three cars, 11, 14 and 18 m ahead, and this finds all of them"
        found = sorted(float(car.result.location[2]) for car in names["cars"])
        assert found == pytest.approx([11.0, 14.0, 18.0], abs=1.5)


def test_no_page_with_blocks_is_missing():
    having = {
        page for page in PAGES if any(language in ("bash", "python", "py") for language, _ in fenced(page.read_text()))
    }
    run = {*GUIDES, *(REPOSITORY / "docs/reference/api").glob("*.md")}
    assert {name_of(page) for page in having - run} == set(ELSEWHERE)


def run_commands(text, sample):
    for line in commands(text):
        if line == SAMPLE:
            shutil.copytree(sample, "sample", dirs_exist_ok=True)  # it is the same each time
        elif not any(re.search(pattern, line) for pattern in NEEDS_MORE):
            done = CliRunner().invoke(main.app, shlex.split(line)[1:])
            assert done.exit_code == 0, f"{line}: {done.output}"


def needed(line):
    """The package or extra beside fgrecon that a command needs, if any."""
    words = shlex.split(line)[1:]
    if len(words) > 1 and words[1] in COMMANDS.get(words[0], {}):
        return "fgrecon-research"
    return "video" if any(word.endswith(".mp4") for word in words) else None


@pytest.mark.parametrize("guide", GUIDES, ids=lambda path: path.stem)
def test_what_a_command_needs_is_named_before_it(guide):
    text = guide.read_text(encoding="utf-8")
    for found in re.finditer(r"^fgrecon .+$", text, re.MULTILINE):
        if (package := needed(found.group().split("  #")[0])) is not None:
            assert re.search(INSTALL[package], text[: found.end()]), found.group()


def test_extras_are_installed_from_the_checkout_and_quoted():
    """There is no package of the name in the registry, and shells such as zsh take brackets for a pattern."""
    lines = [
        (page.name, line)
        for page in PAGES
        for line in page.read_text(encoding="utf-8").splitlines()
        if "pip install" in line and re.search(r"(fgrecon|\.)\[", line)
    ]
    assert len(lines) > 3
    assert [one for one in lines if not re.search(r"""['"]\.\[[\w,]+\]['"]""", one[1])] == []
