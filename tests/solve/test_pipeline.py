"""End to end: real frames, exact repetition, equivalent inputs and every field of the result."""

import json
from dataclasses import replace

import numpy as np
import pytest

from fgrecon.core.box3d import Box3D
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import BoxOptions, KeypointOptions, Options
from fgrecon.core.reconstruction import Reconstruction, Status
from fgrecon.core.size_prior import SIZE_PRIORS
from fgrecon.io.catalogue import save_prior
from fgrecon.io.track_file import read_track
from fgrecon.solve.pipeline import reconstruct
from fgrecon.solve.vehicle.visibility import clearance, probability
from tests.cars import CAMERA, MATRIX, observe, rotation_angle, yaw_pose
from tests.core.test_reconstruction import assert_same
from tests.results import changed
from tests.settings import options as make_options
from tests.solve.conftest import solve

TRACKS = "kitti_tracking_keypoints14/*.json"


def untimed(result):
    """The result without its clock."""
    return changed(result, milliseconds={})


@pytest.mark.data
def test_the_real_frames(data, prior):
    """76 frames with network keypoints, ground and fleet known: the numbers that the project promises."""
    turns, moves, statuses = [], [], []
    options = Options(box="cuboid", keep_history=False)  # KITTI's boxes enclose the projected 3D box
    for path in sorted(data.glob(TRACKS)):
        track = read_track(path, prior.category)
        for frame in track.frames:
            result = solve(frame.observation, track.camera, ground=1.65, size_prior="kitti", options=options)
            turn = result.rotation_y - frame.truth.rotation_y
            turns.append(np.degrees(abs((turn + np.pi) % (2 * np.pi) - np.pi)))
            moves.append(np.linalg.norm(result.location - track.label_offset - frame.truth.location))
            statuses.append(result.status)
    turns = np.array(turns)
    assert len(turns) == 76
    assert (turns <= 5).sum() >= 75
    assert (turns <= 15).sum() == (turns <= 30).sum() == 76
    assert turns.mean() < 1.5
    assert np.median(moves) <= 0.5
    assert Status.FAILED not in statuses
    assert Status.DEGENERATE not in statuses


@pytest.mark.parametrize("more", [{}, {"ground": 1.65, "size_prior": "apollo79"}])
@pytest.mark.parametrize("degrees", range(-150, 181, 55))
def test_exact_cars(prior, degrees, more):
    """The mean car without noise, with and without what is known about the scene."""
    truth = yaw_pose(np.radians(degrees))
    result = solve(observe(prior, truth), **more)
    assert result.status is Status.CONVERGED
    assert np.degrees(rotation_angle(result.camera_T_object, truth)) < 3
    assert np.linalg.norm(result.location - truth[:3, 3]) < 0.03 * truth[2, 3]


def test_the_parts_of_a_result_fit_together(prior, seen):
    observation, _ = seen
    result = solve(observation, ground=1.65, options=make_options(free_offsets=True))
    pose = result.camera_T_object
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(result.wireframe, prior.keypoints(result.shape.coefficients, result.shape.offsets))
    in_camera = result.wireframe @ pose[:3, :3].T + pose[:3, 3]
    np.testing.assert_allclose(result.pose.wireframe_uv, CAMERA.project(in_camera))
    np.testing.assert_allclose(result.shape.surface_vertices, prior.surface.vertices(result.shape.coefficients))
    np.testing.assert_allclose(result.box_size, prior.box_size(result.shape.coefficients, result.shape.offsets))
    sigma0 = np.hypot(KeypointOptions().sigma_relative * observation.extent, KeypointOptions().sigma_pixels)
    np.testing.assert_allclose(result.diagnostics.sigmas * np.sqrt(result.diagnostics.weights), sigma0)
    camera = np.linalg.inv(pose)[:3, 3]
    behind = clearance(result.shape.surface_vertices, result.shape.surface_faces, result.wireframe, camera)
    np.testing.assert_allclose(result.diagnostics.visibility, probability(behind), atol=1e-9)
    assert (result.diagnostics.visibility[observation.confidence > 0.5] > 0.5).all()
    stages = list(dict.fromkeys(iteration.stage for iteration in result.diagnostics.history))
    assert stages == ["initialisation", "pose", "joint"]
    np.testing.assert_allclose(result.diagnostics.history[-1].camera_T_object, pose, atol=1e-6)
    for covariance in (
        result.uncertainty.pose_covariance,
        result.uncertainty.coefficients_covariance,
        *result.uncertainty.keypoint_covariance,
    ):
        assert np.linalg.eigvalsh(covariance).min() > 0
    assert result.shape.category == "car14"
    assert set(result.diagnostics.milliseconds) >= {"pose", "shape"}


def test_a_result_holds_nothing_that_it_does_not_show(prior, seen):
    """A video has thousands of them: what is common to all is there once, and no array keeps a larger one alive."""
    one, other = solve(seen[0]), solve(observe(prior, yaw_pose(0.4)))
    assert one.shape.surface_faces is other.shape.surface_faces
    shown = {name: value for name, value in vars(one).items() if isinstance(value, np.ndarray)}
    held = {name: whole.nbytes for name, array in shown.items() if isinstance(whole := array.base, np.ndarray)}
    assert {name: size for name, size in held.items() if size > shown[name].nbytes} == {}


def test_the_size_of_one_car_tells_its_shape(prior):
    """A long, tall car from few points: with its size given it comes out in shape, size and place."""
    coefficients = np.array([1.5, -0.8, 0.6, 0.4, 0.0])
    pose, size = yaw_pose(0.6), prior.box_size(coefficients)
    observation = observe(prior, pose, coefficients, noise=1.0)
    sized = solve(observation, prior=prior, size_prior=",".join(f"{length:.3f}" for length in size))
    unsized = solve(observation, prior=prior)
    assert sized.shape.prior.startswith("car14 given ")
    assert "dimensions" not in sized.diagnostics.energies
    assert sized.box_size == pytest.approx(size, rel=0.03)
    shape = prior.keypoints(coefficients)
    away = [np.linalg.norm(result.wireframe - shape, axis=1).mean() for result in (sized, unsized)]
    assert away[0] < 0.04
    assert away[0] < away[1]
    assert np.linalg.norm(sized.camera_T_object[:3, 3] - pose[:3, 3]) < 0.3


def test_json_keeps_every_bit(seen):
    result = solve(seen[0], ground=1.65, size_prior="kitti")
    assert_same(result, Reconstruction.from_dict(json.loads(json.dumps(result.to_dict(), allow_nan=False))))


def test_what_the_graph_did_is_reported(seen):
    """The iterations of the graph and what they took off; documents of the first release, without either, are read."""
    result = solve(seen[0], ground=1.65)
    steps = [iteration for iteration in result.diagnostics.history if iteration.stage == "joint"]
    assert 0 < result.diagnostics.graph_iterations <= len(steps)
    assert result.diagnostics.graph_gain > 0.0
    rewritten = result.to_dict()
    back = Reconstruction.from_dict(json.loads(json.dumps(rewritten)))
    assert (back.diagnostics.graph_iterations, back.diagnostics.graph_gain) == (
        result.diagnostics.graph_iterations,
        result.diagnostics.graph_gain,
    )
    old = {name: value for name, value in rewritten.items() if not name.startswith("graph_")}
    back = Reconstruction.from_dict(json.loads(json.dumps(old)))
    assert back.diagnostics.graph_iterations == 0
    assert np.isnan(back.diagnostics.graph_gain)
    assert_same(
        changed(back, graph_iterations=result.diagnostics.graph_iterations, graph_gain=result.diagnostics.graph_gain),
        result,
    )
    paper = solve(seen[0], ground=1.65, options=Options(strategy="paper"))  # whose weights belong to no energy
    assert np.isnan(paper.diagnostics.graph_gain)
    assert np.isnan(Reconstruction.from_dict(json.loads(json.dumps(paper.to_dict()))).diagnostics.graph_gain)
    with pytest.raises(InvalidInputError, match="no field weights"):
        Reconstruction.from_dict({name: value for name, value in old.items() if name != "weights"})


@pytest.mark.parametrize("strategy", ["mixture", "paper", "gnc"])
def test_the_same_input_gives_the_same_bits(seen, strategy):
    options = make_options(strategy=strategy, free_offsets=True)
    first, second = (untimed(solve(seen[0], options=options)) for _ in range(2))
    assert_same(first, second)


def assert_alike(a, b, tolerance=1e-6):
    np.testing.assert_allclose(a.camera_T_object, b.camera_T_object, atol=tolerance)
    np.testing.assert_allclose(a.shape.coefficients, b.shape.coefficients, atol=10 * tolerance)
    np.testing.assert_allclose(a.diagnostics.weights, b.diagnostics.weights, atol=10 * tolerance)


def test_a_lens_changes_nothing_but_the_pixels(seen):
    """Through a distorting lens that is given, the same car comes out; its wireframe is drawn through the lens."""
    observation, _ = seen
    lens = [-0.3, 0.1, 0.001, -0.0005, -0.02]
    camera = Camera(MATRIX, np.array(lens))
    points = camera.distort(observation.keypoints)
    box = observation.box
    for _ in range(30):  # until its sides, undone at their middles, are those of the ideal box
        undone = replace(observation, keypoints=points, box=box).undistorted(camera, ()).box
        box = box + observation.box - undone
    assert np.abs(points - observation.keypoints).max() > 1
    ideal = solve(observation)
    bent = reconstruct(points, MATRIX, confidence=observation.confidence, box=box, distortion=lens)
    assert_alike(ideal, bent, 1e-5)
    np.testing.assert_allclose(bent.pose.wireframe_uv, camera.distort(ideal.pose.wireframe_uv), atol=1e-3)
    assert_alike(bent, reconstruct(points, camera, confidence=observation.confidence, box=box), 1e-12)
    assert_alike(bent, reconstruct(points, CAMERA, confidence=observation.confidence, box=box, distortion=lens), 1e-12)


def test_ways_to_say_the_same(prior, seen, tmp_path):
    observation, _ = seen
    fx, _, cx, _, fy, cy = MATRIX[:2].ravel()
    whole = untimed(solve(observation, ground=1.65, size_prior="kitti", prior="car14"))
    four = solve(observation, (fx, fy, cx, cy), ground=np.float32(1.65), size_prior=SIZE_PRIORS["kitti"], prior=prior)
    assert_alike(whole, four, 1e-4)  # 1.65 in single precision
    lists = reconstruct(
        observation.keypoints.tolist(),
        MATRIX.tolist(),
        confidence=observation.confidence.tolist(),
        box=tuple(observation.box),
        ground=Ground.level(1.65),
        size_prior="kitti",
        prior=save_prior(prior, tmp_path / "mine.npz"),
    )
    assert_same(whole, untimed(lists))


def test_keypoints_by_name_and_as_an_observation(prior, seen):
    observation, names = seen[0], prior.category.keypoints
    rows = np.column_stack([observation.keypoints, observation.confidence])
    named = {name: tuple(row) for name, row in zip(names, rows, strict=True) if np.isfinite(row).all()}
    expected = solve(observation)
    assert_alike(expected, reconstruct(named, CAMERA, box=observation.box), 0.0)
    assert_alike(expected, reconstruct(observation, CAMERA), 0.0)
    pixels = {name: row[:2] for name, row in named.items()}
    assert_alike(
        untimed(solve(observation, confidence=None)), untimed(reconstruct(pixels, CAMERA, box=observation.box)), 0.0
    )


def test_a_confidence_means_what_its_observation_says(seen):
    observation = seen[0]
    strict = replace(observation, confidence_midpoint=0.9)
    assert reconstruct(strict, CAMERA).diagnostics.weights.sum() < solve(observation).diagnostics.weights.sum() - 0.02


def test_an_image_of_twice_the_size(seen):
    """Twice the resolution, in camera, pixels and noise: the same car, bit for bit nearly."""
    observation, _ = seen
    double = np.diag([2.0, 2.0, 1.0]) @ MATRIX
    options = make_options(
        sigma_pixels=2 * KeypointOptions().sigma_pixels, box_sigma_pixels=2 * BoxOptions().sigma_pixels
    )
    big = reconstruct(
        2 * observation.keypoints, double, confidence=observation.confidence, box=2 * observation.box, options=options
    )
    assert_alike(solve(observation), big)


def test_a_car_of_another_scale(prior):
    """Nothing tells the size: a toy car of a tenth the size comes out at a tenth the distance."""
    metric = {"laplacian", "planarity", "rectangularity"}  # these have sigmas in metres
    observation = observe(prior, yaw_pose(0.5), noise=2.0)
    for scale in (0.8, 1.3):
        toy = prior.scaled(scale)
        a, b = (solve(observation, prior=p, options=Options(disabled_terms=metric)) for p in (prior, toy))
        np.testing.assert_allclose(b.location / scale, a.location, rtol=0.02, atol=0.02)
        assert np.degrees(rotation_angle(a.camera_T_object, b.camera_T_object)) < 1
        np.testing.assert_allclose(a.pose.wireframe_uv, b.pose.wireframe_uv, atol=1.5)


def test_missing_keypoints_are_filled_in(seen):
    observation, truth = seen
    pixels = observation.keypoints.copy()
    gone = [1, 6, 9, 12]
    pixels[gone] = np.nan
    result = reconstruct(pixels, CAMERA, confidence=observation.confidence, box=observation.box, ground=1.65)
    assert (result.diagnostics.weights[gone] == 0).all()
    assert np.isinf(result.diagnostics.sigmas[gone]).all()
    assert np.isfinite(result.pose.wireframe_uv).all()
    off = np.linalg.norm(result.pose.wireframe_uv[gone] - observation.keypoints[gone], axis=1)
    assert off.max() < 0.1 * observation.extent
    assert np.degrees(rotation_angle(result.camera_T_object, truth)) < 5


def test_without_confidences_and_box(seen):
    observation, truth = seen
    result = reconstruct(observation.keypoints, CAMERA)
    assert np.degrees(rotation_angle(result.camera_T_object, truth)) < 6


def test_a_prior_without_surface(prior, seen):
    observation, truth = seen
    bare = replace(prior, surface=None)
    result = solve(observation, prior=bare, ground=1.65)
    assert result.shape.surface_vertices is None
    assert result.shape.surface_faces is None
    assert np.degrees(rotation_angle(result.camera_T_object, truth)) < 5
    assert_same(untimed(result), Reconstruction.from_dict(json.loads(json.dumps(untimed(result).to_dict()))))


@pytest.mark.parametrize("count", [0, 1])
@pytest.mark.parametrize("more", [{}, {"joint": False}, {"free_offsets": True}])
def test_few_basis_vectors(seen, count, more):
    result = solve(seen[0], options=make_options(basis_vectors=count, **more))
    assert result.status is Status.CONVERGED
    assert result.shape.coefficients.shape == (count,)
    assert result.uncertainty.coefficients_covariance.shape == (count, count)
    assert np.degrees(rotation_angle(result.camera_T_object, seen[1])) < 6
    assert_same(result, Reconstruction.from_dict(json.loads(json.dumps(result.to_dict()))))


@pytest.mark.parametrize("initial", [0.9, np.float32(0.5), Box3D(np.array([1.5, 1.65, 12.5]), 0.6)])
def test_starts_from_elsewhere(seen, initial):
    result = solve(seen[0], initial=initial)
    assert np.degrees(rotation_angle(result.camera_T_object, seen[1])) < 5


@pytest.mark.filterwarnings("ignore::fgrecon.errors.ContradictoryInputWarning")
def test_a_wrong_guess_is_trusted(seen):
    result = solve(seen[0], initial=0.7 + np.pi)
    assert np.degrees(rotation_angle(result.camera_T_object, seen[1])) > 60


@pytest.mark.filterwarnings("ignore::fgrecon.errors.ContradictoryInputWarning")
def test_a_3d_box_is_a_start(prior, monkeypatch):
    """Points that are too unsure for ASPnP and one azimuth far off: only the box leads to the first search's car."""
    monkeypatch.setattr("fgrecon.solve.graph.multi_start.lower_poses", lambda *_: [])
    truth = yaw_pose(np.radians(170))
    unsure = replace(observe(prior, truth, noise=2.0), confidence=np.full(14, 0.1))
    box = Box3D(np.array(truth[:3, 3]), np.radians(165))
    for initial, found in ((box, True), (None, False)):
        result = reconstruct(unsure, CAMERA, initial=initial, options=make_options(azimuths=1))
        assert (np.degrees(rotation_angle(result.camera_T_object, truth)) < 6) == found


def test_a_level_camera_is_a_height(seen):
    a, b = (solve(seen[0], ground=ground) for ground in (1.65, Ground(np.array([0.0, 1.0, 0.0]), 1.65)))
    assert_same(untimed(a), untimed(b))
    high, unknown = solve(seen[0], ground=1.95), solve(seen[0])
    assert "ground" in a.diagnostics.energies
    assert "ground" not in unknown.diagnostics.energies
    assert high.location[1] > a.location[1] + 0.05


def test_a_detectors_covariance_counts(seen):
    """A point that its detector is unsure of along u moves the result less."""
    observation, _ = seen
    sure = int(np.argmax(observation.confidence))
    shifted = observation.keypoints.copy()
    shifted[sure, 0] += 8.0
    plain = np.array([4.0 * np.eye(2)] * 14)
    vague = plain.copy()
    vague[sure, 0, 0] = 900.0
    moves = []
    for covariance in (plain, vague):
        before = solve(observation, covariance=covariance).pose.wireframe_uv
        after = solve(replace(observation, keypoints=shifted), covariance=covariance).pose.wireframe_uv
        moves.append(np.abs(after - before).max())
    assert moves[1] < 0.5 * moves[0]


@pytest.mark.filterwarnings("ignore::fgrecon.errors.ContradictoryInputWarning")
def test_a_box_outside_of_the_image_is_refused(seen):
    """A car that is cut off has edges outside; one of which nothing is in the image is in another."""
    observation, _ = seen
    width, height = 1242, 375
    sized = replace(CAMERA, image_size=(width, height))
    inside = solve(observation, sized)
    assert_same(untimed(inside), untimed(solve(observation)))
    x, y, right, bottom = observation.box
    for box in ([-300, y, 5, bottom], [x, y, right, 500], [width - 5, y, width + 200, bottom]):
        solve(observation, sized, box=np.array(box))
    for box in ([-300, y, -5, bottom], [x, 400, right, 500], [width + 5, y, width + 200, bottom], [x, -90, right, -9]):
        with pytest.raises(InvalidInputError, match="image of 1242 x 375 pixels") as error:
            solve(observation, sized, box=np.array(box))
        assert error.value.field == "box"
        solve(observation, box=np.array(box))  # nobody knows how large the image is
