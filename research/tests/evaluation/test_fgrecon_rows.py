"""The rows of fgrecon are given what their names say and nothing else."""

from types import SimpleNamespace

import pytest

from fgrecon.core.camera import Camera
from fgrecon.core.errors import FgreconError
from fgrecon.core.reconstruction import Status
from fgrecon_research.evaluation import methods
from fgrecon_research.evaluation.methods import METHODS
from tests.made_up_track import K, pose_of

from .test_methods import observe


@pytest.fixture
def calls(monkeypatch):
    """What `reconstruct` was called with; it returns what the test put under `result`."""
    seen = SimpleNamespace(arguments=None, result=None)

    def reconstruct(keypoints, intrinsics, **arguments):
        seen.arguments = {"keypoints": keypoints, "intrinsics": intrinsics, **arguments}
        return seen.result

    monkeypatch.setattr(methods, "reconstruct", reconstruct)
    return seen


@pytest.mark.parametrize(
    ("name", "ground", "size"),
    [("fgrecon", False, False), ("fgrecon+size", False, True), ("fgrecon+ground+size", True, True)],
)
def test_a_row_is_given_what_its_name_says(scene, calls, name, ground, size):
    camera, truth = Camera(K), pose_of(0.4, [0.0, 1.65, 8.0])
    observation = observe(scene.prior.mean, camera, truth)
    times = {"pose": 3.0, "shape": 7.0}
    calls.result = SimpleNamespace(
        status=Status.AMBIGUOUS, message="", camera_T_object=truth, diagnostics=SimpleNamespace(milliseconds=times)
    )
    estimate = METHODS[name].bind(scene)(observation, camera)
    assert estimate.camera_T_object is truth
    assert estimate.milliseconds == times
    assert calls.arguments["ground"] is (scene.ground if ground else None)
    assert calls.arguments["size_prior"] is (scene.size if size else None)
    assert [one.probabilities for one in calls.arguments["evidence"]] == ([{"car": 1.0}] if size else [])
    assert calls.arguments["prior"] is scene.prior
    assert calls.arguments["intrinsics"] is camera
    assert calls.arguments["keypoints"] is observation


def test_a_failed_reconstruction_is_a_failure(scene, calls):
    camera, truth = Camera(K), pose_of(0.4, [0.0, 1.65, 8.0])
    calls.result = SimpleNamespace(
        status=Status.FAILED, message="no start", camera_T_object=truth, diagnostics=SimpleNamespace(milliseconds={})
    )
    with pytest.raises(FgreconError, match="no start"):
        METHODS["fgrecon"].bind(scene)(observe(scene.prior.mean, camera, truth), camera)
