"""Scoring: the label's frame, and failures that count as 180 degrees and are never left out."""

import numpy as np
import pytest

from fgrecon.core.errors import FgreconError
from fgrecon.io.track_file import parse_track
from fgrecon_research.evaluation.methods import Estimate, Method, select
from fgrecon_research.evaluation.run import score_tracks
from tests.made_up_track import T2, pose_of


def method(solve):
    return Method("made_up", "for the tests", lambda scene: solve, lambda scene: scene.prior.name)


def test_poses_are_scored_in_the_labels_frame(content, scene):
    track = parse_track(content, "t", scene.prior.category)
    (scores,) = score_tracks([track], select(["sqpnp"]), scene)
    assert scores.orientation_errors == pytest.approx(0.0, abs=1e-4)
    assert scores.translation_errors == pytest.approx(0.0, abs=1e-4)
    assert [frame.location for frame in scores.frames] == [pytest.approx([1.5, 1.65, 10.0], abs=1e-4)] * 3
    assert scores.failures == ()
    assert scores.milliseconds("pose") > 0
    assert scores.milliseconds("shape") is None


@pytest.mark.parametrize("error", [FgreconError("no"), RuntimeError("crash"), None], ids=["refusal", "crash", "nan"])
def test_a_failure_counts_as_180_degrees_and_stays(content, scene, error):
    track = parse_track(content, "t", scene.prior.category)
    spoilt = track.frames[1].observation

    def solve(observation, camera):
        if observation is not spoilt:
            return Estimate(pose_of(0.3, np.add(T2, [1.5, 1.65, 13.0])), {"pose": 2.0, "shape": 4.0})
        if error:
            raise error
        return Estimate(np.full((4, 4), np.nan), {"pose": 1.0})

    seen = []
    (scores,) = score_tracks([track], [method(solve)], scene, seen.append)
    assert scores.orientation_errors == pytest.approx([0.0, 180.0, np.degrees(2.8)])
    assert scores.translation_errors == pytest.approx([3.0, np.inf, 3.0])
    assert [frame.frame for frame in scores.failures] == ["t:41"]
    assert (scores.milliseconds("pose"), scores.milliseconds("shape")) == (2.0, 4.0)
    assert seen == ["made_up"] * 3


def test_a_frame_without_keypoints_is_a_named_failure_of_every_method(content, scene):
    content["frames"][0]["keypoints_uv"] = [[None, None]] * 14
    track = parse_track(content, "t", scene.prior.category)
    for scores in score_tracks([track], select(["sqpnp", "epnp"]), scene):
        assert len(scores.frames) == 3
        assert [(f.frame, f.failure) for f in scores.failures] == [("t:40", "the frame has no measured keypoint")]
        assert scores.orientation_errors[0] == 180.0


def test_an_interruption_is_no_failure_of_the_method(content, scene):
    def solve(observation, camera):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        score_tracks([parse_track(content, "t", scene.prior.category)], [method(solve)], scene)
