"""Imports go downwards only: docs/architecture.md has the layers."""

import ast
import sys

import pytest

from .conftest import REPOSITORY

EDGE = ("fgrecon.cli", "fgrecon.viz", "fgrecon.evaluation", "fgrecon.replay", "fgrecon.export")
CORE = ("pipeline", "model", "shape", "pose", "priors", "catalogue", "category", "camera", "observation", "options")
CORE += ("reconstruction", "result", "track", "robust", "checks", "errors", "keypoints", "vehicles", "from_image")
CORE += ("boxes", "render", "simulate")


def imports(*places):
    """(file, imported module) of every import in these packages and modules, those inside functions included."""
    for place in places:
        path = REPOSITORY / place
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path.with_suffix(".py")]:
            for node in ast.walk(ast.parse(file.read_text())):
                if isinstance(node, ast.Import):
                    yield from ((file.name, alias.name) for alias in node.names)
                elif isinstance(node, ast.ImportFrom):
                    assert node.level == 0, f"{file}: relative import"
                    yield file.name, node.module


def within(module, packages):
    return any(module == package or module.startswith(f"{package}.") for package in packages)


def test_factors_depend_on_gtsam_and_numpy_alone():
    allowed = ("factors", "gtsam", "numpy", *sys.stdlib_module_names)
    assert [found for found in imports("factors") if not within(found[1], allowed)] == []


@pytest.mark.parametrize("name", CORE)
def test_what_computes_knows_nothing_of_drawing_scoring_and_the_command_line(name):
    found = list(imports(f"fgrecon/{name}"))
    assert found
    assert [item for item in found if within(item[1], (*EDGE, "typer", "rich", "matplotlib", "rerun"))] == []


def test_stages_do_not_look_up():
    above = {"pose": ("fgrecon.shape", "fgrecon.pipeline"), "shape": ("fgrecon.pipeline",)}
    for name, forbidden in above.items():
        assert [item for item in imports(f"fgrecon/{name}") if within(item[1], forbidden)] == []


def test_only_the_command_line_parses_options():
    others = [path.stem for path in (REPOSITORY / "fgrecon").iterdir() if path.name not in ("cli", "data")]
    found = imports(*(f"fgrecon/{name}" for name in others if name not in ("py", "__pycache__")))
    assert [item for item in found if within(item[1], ("typer", "fgrecon.cli"))] == []
