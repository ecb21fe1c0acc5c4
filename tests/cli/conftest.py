"""A made-up car with exact keypoints, as a keypoint file, and a network that has learnt nothing."""

import json
import signal

import numpy as np
import pytest

from fgrecon.core.camera import Camera
from fgrecon.io.catalogue import load_prior
from fgrecon.simulation.vehicles import yaw_pose

K = np.array([[700.0, 0.0, 600.0], [0.0, 700.0, 180.0], [0.0, 0.0, 1.0]])
INTRINSICS = "--intrinsics=700,700,600,180"
YAW = -2.2
LOCATION = np.array([-2.0, 1.65, 11.0])


def car(yaw=YAW, location=LOCATION, camera=None):
    """One instance: the mean car seen exactly, with its 2D box."""
    camera, prior = camera or Camera(K), load_prior("car14")
    pose = yaw_pose(yaw, np.asarray(location))

    def pixels(points):
        return camera.distort(camera.project(points @ pose[:3, :3].T + pose[:3, 3]))

    keypoints, outline = pixels(prior.mean), pixels(prior.surface.mean)
    return {
        "keypoints": keypoints.tolist(),
        "confidence": [0.8] * len(keypoints),
        "box": [*outline.min(0), *outline.max(0)],
    }


@pytest.fixture
def instance():
    """A fresh copy that a test may spoil."""
    return car()


@pytest.fixture
def write(tmp_path):
    """Writes a JSON file and gives its path."""

    def write(content, name="cars.json"):
        file = tmp_path / name
        file.write_text(json.dumps(content))
        return file

    return write


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """File of a network that has learnt nothing; torch has one thread meanwhile."""
    torch = pytest.importorskip("torch")
    from fgrecon.perception.keypoints.decode import ConfidenceCalibration
    from fgrecon.perception.keypoints.layout import KNetSettings
    from fgrecon.perception.keypoints.network_file import save_weights
    from tests.perception.untrained import untrained

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    sizes = KNetSettings(crop=32, width=8)
    path = tmp_path_factory.mktemp("weights") / "w.safetensors"
    yield save_weights(path, untrained(sizes, calibration=ConfidenceCalibration(bias=1.0), provenance={"data": "none"}))
    torch.set_num_threads(threads)


@pytest.fixture(autouse=True)
def interruptible():
    """Ctrl-C interrupts, also where the shell that started the tests ignores it."""
    before = signal.getsignal(signal.SIGINT)
    if before is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
