"""Shared fixtures: where the real data is, and the shipped category and prior."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy loads: the tests run on all cores already

import pytest
from hypothesis import settings

from fgrecon.calibration.labelled_frames import SceneKnowledge
from fgrecon.core.camera import Ground
from fgrecon.core.size_prior import SIZE_PRIORS
from fgrecon.io.catalogue import load_prior
from tests.made_up_track import make_track

REPOSITORY = Path(__file__).resolve().parents[1]

settings.register_profile("untimed", deadline=None, derandomize=True)  # the same examples, however busy the machine is
settings.load_profile("untimed")


def data_root() -> Path | None:
    """Folder of the real data: FGRECON_DATA, else ../shared/data beside the checkout; None where absent."""
    folder = Path(os.environ.get("FGRECON_DATA", REPOSITORY.parent / "shared" / "data"))
    return folder if folder.is_dir() else None


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of the real data; skips where it is absent."""
    folder = data_root()
    if folder is None:
        pytest.skip("the real data is absent: set FGRECON_DATA or put it at ../shared/data")
    return folder


@pytest.fixture(scope="session")
def scene():
    return SceneKnowledge(load_prior("car14"), Ground.level(1.65), SIZE_PRIORS["kitti"])


@pytest.fixture
def content(scene):
    """A fresh copy that a test may spoil."""
    return json.loads(json.dumps(make_track(scene.prior, [0.3, 1.9, -2.5])))


@pytest.fixture
def start():
    """Starts programs, and ends them with the test."""
    started = []

    def begin(arguments):
        process = subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        started.append(process)
        return process

    yield begin
    for process in started:
        process.terminate()
        process.wait(timeout=20)
