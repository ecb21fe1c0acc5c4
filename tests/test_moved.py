"""Modules that have moved are found by their old names, with a warning that says where they are."""

import importlib
import subprocess
import sys

import pytest

from fgrecon._moved import MOVED


@pytest.mark.parametrize(("old", "new"), MOVED.items())
def test_a_moved_module_is_the_one_of_the_new_name(old, new):
    sys.modules.pop(old, None)
    parent = old.rpartition(".")[0]
    if parent != "fgrecon" and parent in MOVED:
        sys.modules.pop(parent, None)
        with pytest.warns(DeprecationWarning, match=f"{parent} is now"):
            importlib.import_module(parent)
    with pytest.warns(DeprecationWarning, match=f"{old} is now {new}"):
        module = importlib.import_module(old)
    assert module is importlib.import_module(new)
    assert module.__name__ == module.__spec__.name == new


def test_the_warning_points_at_the_import():
    code = (
        "import fgrecon.pose.aspnp\nfrom fgrecon.camera import Camera\nimport fgrecon\nassert Camera is fgrecon.Camera"
    )
    done = subprocess.run([sys.executable, "-W", "always", "-c", code], capture_output=True, text=True, check=True)
    lines = [line for line in done.stderr.splitlines() if "DeprecationWarning" in line]
    assert [line.partition(":")[0] for line in lines] == ["<string>"] * 3
