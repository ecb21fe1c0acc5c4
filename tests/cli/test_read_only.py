"""Folders that may not be written to, as an ordinary user: every command that writes ends with one clear line."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import REPOSITORY

NOBODY = 65534
PROGRAM = """
import contextlib, io, json, sys, traceback
from fgrecon.cli.main import main

for arguments in json.loads(sys.stdin.read()):
    said, complained, code = io.StringIO(), io.StringIO(), 0
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(complained):
        sys.argv = ["fgrecon", *arguments]
        try:
            main()
        except SystemExit as end:
            code = end.code
        except BaseException:
            code = traceback.format_exc()
    print(json.dumps([code or 0, complained.getvalue()]), flush=True)
"""


@pytest.fixture(scope="module")
def given():
    """Inputs and a folder that cannot be written to, where an ordinary user comes to."""
    from typer.testing import CliRunner

    from fgrecon.cli.main import app

    place = Path(tempfile.mkdtemp())
    try:
        place.chmod(0o755)
        done = CliRunner().invoke(app, ["sample", "--out", str(place / "sample"), "-q"])
        assert done.exit_code == 0, done.output
        sample = place / "sample"
        arguments = [str(sample / "cars.json"), "--json", str(sample / "result.json"), "-q"]
        assert CliRunner().invoke(app, ["reconstruct", *arguments]).exit_code == 0
        rng = np.random.default_rng(0)
        np.savez(sample / "a.npz", keypoints_uv=rng.uniform(0, 100, (9, 14, 2)))
        (place / "closed").mkdir()
        (place / "closed").chmod(0o555)
        yield sample, place / "closed"
    finally:
        (place / "closed").chmod(0o755)
        shutil.rmtree(place)


def commands(sample, out):
    """Every command that writes, by what it writes."""
    cars, image, result, calib = (sample / name for name in ("cars.json", "street.png", "result.json", "calib.txt"))
    detections = sample / "detections.txt"
    made = {
        "sample": ["sample", "--out", out / "s"],
        "demo": ["demo", "--out", out / "d"],
        "results": ["reconstruct", cars, "--json", out / "r.json"],
        "results of images": ["reconstruct", image, "--boxes", sample / "boxes.txt", "--calib", calib, "--out", out],
        "picture": ["reconstruct", cars, "--picture", out / "r.png"],
        "recording": ["reconstruct", cars, "--save", out / "r.rrd"],
        "batch": ["batch", cars, "--out", out / "b"],
        "batch in the folder": ["batch", cars, "--out", out],
        "refine": ["refine", detections, image, "--calib", calib, "--out", out / "refined.txt"],
        "run": ["run", sample / "drive", "--camera-height", 1.65, "--out", out / "tracked"],
        "export": ["export", result, out / "cars.glb"],
        "csv": ["export", result, out / "cars.csv"],
        "prior learn": ["prior", "learn", sample / "a.npz", "--out", out / "p.npz"],
        "prior picture": ["prior", "show", "car14", "--picture", out / "p.png"],
        "prior recording": ["prior", "show", "car14", "--save", out / "p.rrd"],
        "prior compare": ["prior", "compare", "car14", "car14", "--json", out / "c.json"],
        "keypoints detect": ["keypoints", "detect", image, "--box", "10,10,90,90", "--json", out / "k.json"],
        "keypoints train": [
            "keypoints",
            "train",
            "--data",
            sample,
            "--work",
            out / "w",
            "--out",
            out / "w.safetensors",
        ],
        "vehicles detect": ["vehicles", "detect", image, "--out", out / "v.txt"],
    }
    return {name: [*map(str, arguments)] for name, arguments in made.items()}


def as_ordinary_user(arguments):
    """What each command line ends with: exit code and what it complained of."""
    other = []
    if os.geteuid() == 0:
        if shutil.which("setpriv") is None:
            pytest.skip("root may write everywhere, and there is no setpriv to become an ordinary user")
        other = ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups"]
    home = {"HOME": "/nonexistent", "MPLCONFIGDIR": tempfile.gettempdir(), "PYTHONDONTWRITEBYTECODE": "1"}
    environment = os.environ | home | {"PYTHONPATH": str(REPOSITORY)}
    started = {"capture_output": True, "text": True, "env": environment, "cwd": "/"}
    tried = subprocess.run([*other, sys.executable, "-c", "import fgrecon"], check=False, **started)
    if tried.returncode != 0:
        pytest.skip(f"an ordinary user cannot run this Python: {tried.stderr[-200:]}")
    done = subprocess.run([*other, sys.executable, "-c", PROGRAM], input=json.dumps(arguments), check=False, **started)
    lines = done.stdout.splitlines()
    assert len(lines) == len(arguments), done.stderr
    return [json.loads(line) for line in lines]


def test_read_only_folders_are_one_clear_line(given):
    sample, closed = given
    named = commands(sample, closed)
    ended = dict(zip(named, as_ordinary_user(list(named.values())), strict=True))
    for name, (code, complaint) in ended.items():
        assert code == 2, (name, code, complaint)
        lines = [line for line in complaint.splitlines() if not line.startswith("Warning: ")]
        assert len(lines) == 1, (name, complaint)
        assert lines[0].startswith("fgrecon: "), (name, complaint)
        assert lines == complaint.splitlines() or name != "run", complaint  # it said so before it looked for the camera
    assert list(closed.iterdir()) == []
