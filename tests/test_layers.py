"""Imports go downwards only. This table is the house: docs/reference/rooms.md says what is in each room."""

import ast
import sys
from graphlib import TopologicalSorter

import pytest

from .conftest import REPOSITORY

ROOMS = {
    "factors": set(),
    "core": {"factors"},
    "io": {"core"},
    "io/keypoints": {"core", "io"},
    "io/datasets": {"core", "io"},
    "io/cameras": {"core", "io", "io/datasets"},
    "io/sensors": {"core", "io", "io/cameras", "io/datasets"},
    "solve/vehicle": {"factors", "core"},
    "io/export": {"core", "io", "io/datasets", "solve/vehicle"},
    "solve/proposals": {"factors", "core", "solve/vehicle"},
    "solve/graph": {"factors", "core", "solve/vehicle", "solve/proposals"},
    "solve/time": {"factors", "core", "solve/proposals", "solve/graph"},
    "solve": {"factors", "core", "io", "solve/vehicle", "solve/proposals", "solve/graph", "solve/time"},
    "perception/keypoints": {"core", "io"},
    "perception": {
        *("factors", "core", "io", "io/cameras", "io/datasets", "io/sensors", "solve"),
        "perception/keypoints",
    },
    "": {
        "factors",
        "core",
        "io",
        "io/keypoints",
        "solve",
        "perception",
    },  # the public face: fgrecon/__init__.py
    "batch": {
        "factors",
        "core",
        "io",
        "io/datasets",
        "io/cameras",
        "io/export",
        "io/keypoints",
        "solve",
        "perception",
        "perception/keypoints",
    },
    "video": {
        *(
            "factors",
            "core",
            "io",
            "io/datasets",
            "io/cameras",
            "io/export",
            "solve",
            "batch",
            "perception",
            "perception/keypoints",
        ),
    },
    "simulation": {"factors", "core", "solve/vehicle"},
    "viz": {"factors", "core", "io", "perception/keypoints", "batch", "video"},
    "calibration": {
        *("core", "io", "io/datasets", "io/export", "solve/vehicle", "perception", "perception/keypoints", "video"),
    },
    "app": {
        *("core", "io", "io/cameras", "io/export", "io/keypoints", "solve", "simulation", "perception"),
        *("perception/keypoints", "batch", "video", "viz"),
    },
    "cli": {
        *("core", "io", "io/datasets", "io/cameras", "io/export", "io/keypoints", "solve", "simulation", "perception"),
        *("perception/keypoints", "batch", "video", "viz", "calibration", "app"),
    },
    "research": {"core", "simulation"},
    "research/io": {"core", "io", "io/sensors"},
    "research/io/annotations": {"core", "io", "io/keypoints"},
    "research/annotation": {
        *("factors", "core", "io", "solve", "solve/vehicle", "solve/proposals", "solve/graph"),
        *("perception", "perception/keypoints", "calibration"),
    },
    "research/evaluation": {
        *("core", "io", "io/export", "solve", "solve/vehicle", "solve/proposals", "perception", "perception/keypoints"),
        *("simulation", "video", "calibration", "research"),
        "research/io",
    },
    "research/training/priors": {"core", "io", "research/io/annotations", "io/keypoints", "solve/vehicle"},
    "research/training": {"factors", "research/io/annotations", "research/training/priors"},
    "research/training/keypoints": {
        *("factors", "core", "io", "research/io/annotations", "solve/vehicle", "simulation"),
        *("perception", "perception/keypoints", "research/training/priors"),
    },
    "research/paper": {
        *(
            "core",
            "io",
            "research/io/annotations",
            "solve",
            "solve/vehicle",
            "solve/proposals",
            "solve/graph",
            "simulation",
        ),
        *("perception", "perception/keypoints", "calibration"),
        *("research", "research/evaluation", "research/training/priors", "research/training/keypoints"),
        "research/io",
    },
    "research/viz": {"core", "io", "viz", "research/evaluation", "research/paper"},
    "research/cli/evaluate": {
        *("core", "io", "io/datasets", "io/export", "perception/keypoints", "simulation", "viz", "calibration", "cli"),
        *("research/evaluation", "research/viz"),
        "research/io",
    },
    "research/cli/training": {
        *(
            "core",
            "io",
            "io/datasets",
            "research/io",
            "research/io/annotations",
            "perception",
            "perception/keypoints",
            "viz",
            "calibration",
            "cli",
        ),
        *("research/annotation", "research/training/priors", "research/training/keypoints", "research/paper"),
        "research/viz",
        "research/cli/evaluate",
    },
    "research/cli/paper": {
        *("core", "io", "viz", "cli", "research/evaluation", "research/training/priors"),
        *("research", "research/paper", "research/viz", "research/cli/evaluate"),
    },
    "research/cli": {"cli"},
}
"""Each room, and the rooms that its files may import."""

RESEARCH = REPOSITORY / "research"

DRAWING = ("matplotlib", "rerun", "typer", "rich")
"""Libraries that what computes, reads and writes knows nothing of."""


def _files():
    """Dotted name and path of every module of the three packages."""
    for root, package in ((REPOSITORY, "factors"), (REPOSITORY, "fgrecon"), (RESEARCH, "fgrecon_research")):
        for path in sorted((root / package).rglob("*.py")):
            parts = path.relative_to(root).with_suffix("").parts
            if parts[-1] == "__main__":
                continue  # the command line's door
            yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts), path


FILES = dict(_files())


def _room(module):
    folder = FILES[module].parent.relative_to(REPOSITORY).as_posix()
    if folder.startswith("factors"):
        return folder
    return folder.replace("research/fgrecon_research", "research").removeprefix("fgrecon").removeprefix("/")


def _imports(path, *, all_levels=True):
    """Modules that a file imports; with `all_levels` those inside functions and for type checkers included."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree) if all_levels else tree.body:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                yield whole if whole in FILES else node.module


def test_every_folder_is_a_room_of_the_table():
    assert {_room(module) for module in FILES} == set(ROOMS)


def test_the_table_has_no_cycle():
    TopologicalSorter(ROOMS).prepare()


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_only_what_the_table_allows(room):
    found = {}
    for module, path in FILES.items():
        if _room(module) == room:
            for imported in _imports(path):
                if imported in FILES and _room(imported) != room:
                    found.setdefault(_room(imported), []).append(f"{module} imports {imported}")
    assert {name: files for name, files in found.items() if name not in ROOMS[room]} == {}
    assert ROOMS[room] - {"factors"} <= set(found) | {"factors"}, "the table allows what nobody imports"


def test_no_file_imports_itself_through_others():
    arrows = {
        module: {imported for imported in _imports(path) if imported in FILES and imported != module}
        for module, path in FILES.items()
        if path.name != "__init__.py"
    }
    TopologicalSorter(arrows).prepare()


def test_factors_depend_on_gtsam_and_numpy_alone():
    allowed = {"factors", "gtsam", "numpy", *sys.stdlib_module_names}
    for module, path in FILES.items():
        if _room(module) == "factors":
            assert {name.partition(".")[0] for name in _imports(path)} <= allowed, path


@pytest.mark.parametrize(
    "room",
    [
        "core",
        "io",
        "io/keypoints",
        "io/cameras",
        "io/export",
        "batch",
        "video",
        "calibration",
        "simulation",
        *(r for r in ROOMS if "solve" in r or "perception" in r),
    ],
)
def test_what_computes_knows_nothing_of_drawing_and_the_command_line(room):
    for module, path in FILES.items():
        if _room(module) == room:
            assert not {name.partition(".")[0] for name in _imports(path)} & set(DRAWING), path
