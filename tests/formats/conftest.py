"""Tests with the data sets' own devkits are a job of their own; each devkit has an environment of its own.

bash tests/formats/install.sh FOLDER && FGRECON_DEVKITS=FOLDER pytest -m formats tests/formats
"""

import json
import os
import subprocess
from pathlib import Path

import pytest

HERE = Path(__file__).parent
_JOB = "a job of its own: tests/formats/install.sh FOLDER, then FGRECON_DEVKITS=FOLDER pytest -m formats tests/formats"


def pytest_collection_modifyitems(config, items):
    if "formats" in (config.option.markexpr or ""):
        return
    for item in items:
        if item.get_closest_marker("formats"):
            item.add_marker(pytest.mark.skip(reason=_JOB))


@pytest.fixture
def devkit(tmp_path):
    """Runs a script of `devkits` in the environment of a devkit, and gives what it prints as JSON."""
    folder = os.environ.get("FGRECON_DEVKITS")

    def run(environment, script, *arguments, given=""):
        python = Path(folder or "").resolve() / environment / "bin" / "python"
        if not folder or not python.exists():
            pytest.skip(f"{environment} is not installed: {_JOB}")
        command = [str(python), str(HERE / "devkits" / f"{script}.py"), *map(str, arguments)]
        done = subprocess.run(
            command, check=False, input=given, capture_output=True, text=True, cwd=tmp_path, timeout=300
        )
        assert done.returncode == 0, done.stderr[-3000:]
        lines = done.stdout.splitlines()  # some packages say something on their first run
        return json.loads(lines[-1]) if lines else None

    return run


@pytest.fixture
def facts():
    """What devkits said of the made-up files when the tests were written: `devkits/NAME_reads.py` printed it."""
    return lambda name: json.loads((HERE / "facts" / f"{name}.json").read_text())
