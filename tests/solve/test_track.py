"""A vehicle in several images: one shape, exact on exact data, better than images one by one on noisy ones."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import fgrecon
from fgrecon.core.errors import DegenerateProblemError, InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import Status
from fgrecon.io.track_file import read_track
from fgrecon.simulation.vehicles import KITTI_CAMERA, Vehicle, simulate, yaw_pose
from fgrecon.solve.track import reconstruct_track
from tests.results import value_of
from tests.settings import options as make_options

COEFFICIENTS = np.array([0.9, -0.6, 0.4, 0.2, -0.5])


@pytest.fixture(scope="module")
def car():
    return Vehicle.of_prior(fgrecon.load_prior("car14"), COEFFICIENTS)


def drive(car, rng, count=6):
    """Poses of a car that turns while it comes closer, and what a network reports of it."""
    poses = [yaw_pose(-2.3 + 0.25 * t, np.array([-4.0 + 1.2 * t, 1.65, 16.0 - 1.0 * t])) for t in range(count)]
    return poses, [simulate(car, KITTI_CAMERA, pose, rng)[0] for pose in poses]


def exact(car, pose):
    """What a perfect detector would report: every keypoint, sure of each."""
    points = car.keypoints @ pose[:3, :3].T + pose[:3, 3]
    return Observation(KITTI_CAMERA.project(points), np.ones(len(points)))


@pytest.fixture(scope="module")
def solved(car):
    poses, seen = drive(car, np.random.default_rng(5))
    seen.insert(2, None)
    return poses, seen, reconstruct_track(seen, KITTI_CAMERA, ground=1.65)


def test_all_frames_share_one_shape_and_refused_images_are_named(solved):
    poses, _, track = solved
    assert track.numbers == (0, 1, 3, 4, 5, 6)
    assert track.refused == {2: "no keypoints"}
    assert len(track.frames) == len(poses)
    for frame in track.frames:
        np.testing.assert_array_equal(frame.shape.coefficients, track.coefficients)
        np.testing.assert_array_equal(frame.box_size, track.box_size)
    assert "1 was refused" in track.message


def test_every_pose_is_near_the_truth(solved):
    poses, _, track = solved
    for pose, frame in zip(poses, track.frames, strict=True):
        turn = np.arccos(np.clip((np.trace(pose[:3, :3].T @ frame.camera_T_object[:3, :3]) - 1) / 2, -1, 1))
        assert np.degrees(turn) < 6.0
        assert np.linalg.norm(frame.location - pose[:3, 3]) < 1.0


def test_many_images_tell_the_shape_better_than_the_average_one(car):
    """Where their errors have nothing in common, as here."""
    _, seen = drive(car, np.random.default_rng(5))
    given = {"ground": 1.65, "size_prior": "apollo79"}
    track = reconstruct_track(seen, KITTI_CAMERA, **given, options=make_options(common_error=0.0))
    alone = [
        fgrecon.reconstruct(s.keypoints, KITTI_CAMERA, confidence=s.confidence, box=s.box, **given)
        for s in seen
        if s is not None
    ]
    errors = [np.linalg.norm(result.wireframe - car.keypoints, axis=1).mean() for result in alone]
    together = np.linalg.norm(track.frames[0].wireframe - car.keypoints, axis=1).mean()
    assert together < np.mean(errors)
    assert all(
        np.trace(frame.uncertainty.coefficients_covariance) < np.trace(result.uncertainty.coefficients_covariance)
        for frame, result in zip(track.frames, alone, strict=True)
    )


def test_the_history_of_the_whole_is_that_of_the_frames(solved):
    *_, track = solved
    for index, frame in enumerate(track.frames):
        joint = [step for step in frame.diagnostics.history if step.stage == "joint"]
        assert [(step.irls, step.step) for step in joint] == [(step.irls, step.step) for step in track.history]
        for mine, whole in zip(joint, track.history, strict=True):
            np.testing.assert_array_equal(mine.camera_T_object, whole.poses[index])
            np.testing.assert_array_equal(mine.coefficients, whole.coefficients)
        np.testing.assert_allclose(joint[-1].camera_T_object, frame.camera_T_object, atol=1e-6)
    last = [[step for step in frame.diagnostics.history if step.stage == "joint"][-1] for frame in track.frames]
    for term in ("reprojection", "box", "ground", "cheirality"):
        assert sum(step.energies[term] for step in last) == pytest.approx(track.history[-1].energies[term])
    assert "coefficients" in track.energies
    assert "coefficients" not in last[0].energies
    totals = [sum(step.energies.values()) for step in track.history]
    assert totals[-1] <= totals[0] + 0.1  # what a change of visibility may cost


def test_the_graph_has_one_shape_and_a_pose_per_image(solved):
    *_, track = solved
    variables = {name for factor in track.graph for name in factor.variables}
    assert {name for name in variables if name.startswith("X")} == {f"X(v=0,t={n})" for n in track.numbers}
    assert {name for name in variables if name.startswith("L")} == {"L(v=0)"}
    terms = [factor.term for factor in track.graph]
    assert terms.count("coefficients") == 1
    assert terms.count("reprojection") == len(track.frames)


def test_exact_keypoints_with_a_weak_prior_give_the_exact_car(car):
    poses = [yaw_pose(-2.0 + 0.4 * t, np.array([-2.0 + t, 1.65, 12.0])) for t in range(4)]
    options = make_options(
        strategy="huber", sigma_relative=0.002, sigma_pixels=0.01, box_model="off", free_offsets=False
    )
    track = reconstruct_track([exact(car, pose) for pose in poses], KITTI_CAMERA, options=options)
    assert track.status is Status.CONVERGED
    np.testing.assert_allclose(track.coefficients, COEFFICIENTS, atol=0.02)
    for pose, frame in zip(poses, track.frames, strict=True):
        np.testing.assert_allclose(frame.camera_T_object, pose, atol=0.02)


@pytest.mark.parametrize("strategy", ["mixture", "paper", "tukey"])
def test_one_image_gives_what_it_gives_alone(car, strategy):
    """The same loop over the same graph."""
    _, seen = drive(car, np.random.default_rng(1), count=1)
    options = fgrecon.Options(strategy=strategy)
    track = reconstruct_track(seen, [KITTI_CAMERA], ground=1.65, options=options)
    alone = fgrecon.reconstruct(seen[0], KITTI_CAMERA, ground=1.65, options=options)
    (frame,) = track.frames
    assert frame.status is alone.status
    for name in ("camera_T_object", "coefficients", "offsets", "weights", "pose_covariance"):
        np.testing.assert_allclose(value_of(frame, name), value_of(alone, name), rtol=0, atol=1e-9)
    assert track.energies == pytest.approx(alone.diagnostics.energies, abs=1e-9)
    assert frame.diagnostics.graph_iterations == alone.diagnostics.graph_iterations


def test_copies_of_an_image_count_as_their_common_error_says(car):
    """With all errors in common copies say no more than the image; with none they are so many images."""
    _, seen = drive(car, np.random.default_rng(1), count=1)
    options = [make_options(common_error=share, free_offsets=False) for share in (1.0, 0.5, 0.0)]
    alone = fgrecon.reconstruct(seen[0], KITTI_CAMERA, options=options[0])
    tracks = [reconstruct_track(seen * 3, KITTI_CAMERA, options=one) for one in options]
    for frame in tracks[0].frames:
        np.testing.assert_allclose(frame.camera_T_object, alone.camera_T_object, atol=1e-5)
        np.testing.assert_allclose(frame.shape.coefficients, alone.shape.coefficients, atol=1e-5)
        for name in ("pose_covariance", "coefficients_covariance"):
            expected = value_of(alone, name)
            np.testing.assert_allclose(value_of(frame, name), expected, atol=1e-4 * np.abs(expected).max())
    assert sum(tracks[0].energies.values()) == pytest.approx(sum(alone.diagnostics.energies.values()), abs=1e-6)
    spread = [np.trace(track.frames[0].uncertainty.coefficients_covariance) for track in tracks]
    assert spread[0] > spread[1] > spread[2]


def test_a_track_anneals(car):
    """Graduated non-convexity makes all its updates, and trusts doubtful points most at the first."""
    _, seen = drive(car, np.random.default_rng(1), count=2)
    track = reconstruct_track(seen, KITTI_CAMERA, options=fgrecon.Options(strategy="gnc"))
    updates = fgrecon.Options(strategy="gnc").strategy.updates
    assert {step.irls for step in track.history} >= set(range(updates))
    for frame in track.frames:
        joint = [step for step in frame.diagnostics.history if step.stage == "joint"]
        assert joint[0].weights.sum() > 1.05 * joint[-1].weights.sum()
        *_, alone = (step for step in frame.diagnostics.history if step.stage == "pose")  # at its annealing's end
        assert joint[0].weights.sum() > 1.05 * alone.weights.sum()


def test_without_history_nothing_is_kept(car):
    _, seen = drive(car, np.random.default_rng(2), count=2)
    track = reconstruct_track(seen, KITTI_CAMERA, options=fgrecon.Options(keep_history=False))
    kept = reconstruct_track(seen, KITTI_CAMERA)
    assert track.history == ()
    assert track.graph == ()
    assert all(frame.diagnostics.history == () for frame in track.frames)
    assert len(kept.history) > 2
    assert track.coefficients.tobytes() == kept.coefficients.tobytes()
    assert track.energies == kept.energies


@pytest.mark.parametrize(("cut", "status"), [(1, "converged"), (2, "weak"), (4, "weak")])
def test_a_track_is_weak_where_half_of_its_images_are(car, cut, status):
    """So many of four images show a half of the car's keypoints and no more, which carry too little."""
    _, seen = drive(car, np.random.default_rng(1), count=4)
    few = [replace(one, confidence=np.where(np.arange(14) < 4, one.confidence, 0.0)) for one in seen]
    track = reconstruct_track([*few[:cut], *seen[cut:]], KITTI_CAMERA, ground=1.65)
    assert [frame.status.value for frame in track.frames] == ["weak"] * cut + ["converged"] * (4 - cut)
    assert track.status.value == status
    assert f"{cut} of 4 {'is' if cut == 1 else 'are'} weak, {cut} since the detector holds" in track.message


def test_what_cannot_be_solved_is_refused(car):
    _, seen = drive(car, np.random.default_rng(3), count=2)
    with pytest.raises(DegenerateProblemError, match="no pose in any image"):
        reconstruct_track([None, None], KITTI_CAMERA)
    with pytest.raises(InvalidInputError, match="cameras"):
        reconstruct_track(seen, [KITTI_CAMERA])
    with pytest.raises(InvalidInputError, match="joint"):
        reconstruct_track(seen, KITTI_CAMERA, options=make_options(joint=False))


def test_an_image_whose_input_is_bad_is_refused_alone(car):
    _, seen = drive(car, np.random.default_rng(3), count=3)
    bad = replace(seen[1], box=seen[1].box + 10000.0)  # beside the image
    track = reconstruct_track([seen[0], bad, seen[2]], KITTI_CAMERA)
    assert (track.numbers, list(track.refused)) == ((0, 2), [1])
    assert "box" in track.refused[1]
    with pytest.raises(InvalidInputError, match="box"):
        reconstruct_track([bad, None], KITTI_CAMERA)


def test_a_solve_that_gives_up_says_so_and_keeps_the_state_before(car, monkeypatch):
    _, seen = drive(car, np.random.default_rng(4), count=2)

    def give_up(*_arguments, **_settings):
        raise DegenerateProblemError("keypoints", "a singular system", "Give more.")

    monkeypatch.setattr("fgrecon.solve.graph.newton.Descent._iterate", give_up)
    track = reconstruct_track(seen, KITTI_CAMERA)
    assert track.status is Status.FAILED
    assert "singular" in track.message
    assert track.history == ()
    for frame in track.frames:
        assert np.isfinite(frame.camera_T_object).all()
        np.testing.assert_array_equal(frame.shape.coefficients, track.coefficients)
        assert {step.stage for step in frame.diagnostics.history} == {"initialisation", "pose"}


@pytest.mark.data
def test_a_real_track_has_a_better_size_than_its_images_alone(data):
    file = data / "kitti_tracking_keypoints14" / "seq0005_track12_from182.json"
    track = read_track(file, fgrecon.load_category("car14"))
    seen = [frame.observation for frame in track.frames]
    options = make_options(box_model="cuboid", keep_history=False, common_error=0.0)
    solved = reconstruct_track(seen, track.camera, size_prior="kitti", ground=1.65, options=options)
    label = json.loads(file.read_text())["frames"][0]["gt"]
    size = np.array([label["length"], label["width"], label["height"]])
    alone = [
        fgrecon.reconstruct(
            s.keypoints,
            track.camera,
            confidence=s.confidence,
            box=s.box,
            size_prior="kitti",
            ground=1.65,
            options=options,
        ).box_size
        for s in seen
    ]
    assert np.abs(solved.box_size - size).mean() < 0.8 * np.mean([np.abs(one - size).mean() for one in alone])
