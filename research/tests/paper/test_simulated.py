"""Simulated keypoints on labelled poses: geometry by hand, matching, determinism, and the run in parts."""

import numpy as np
import pytest

from fgrecon.calibration.labelled_boxes import match_detections
from fgrecon.calibration.labelled_frames import SceneKnowledge
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.options import BoxModel, Options
from fgrecon.io.kitti_calibration import KittiCalibration
from fgrecon.io.kitti_files import Objects
from fgrecon.simulation.keypoint_noise import HOURGLASS
from fgrecon.simulation.vehicles import Vehicle
from fgrecon.solve.vehicle.conditioning import of_fleet
from fgrecon.solve.vehicle.model import prepare
from fgrecon_research.io.kitti_sets import parse_objects
from fgrecon_research.paper.simulated import Fleet, KittiFrame, hidden_by_boxes, simulate_frame
from fgrecon_research.paper.simulated_run import Condition, PaperSettings, Validation, run_conditions
from fgrecon_research.paper.simulated_scores import Scores, row_solvers, score_instances
from fgrecon_research.paper.stages import AZIMUTH_GROSS, initial_state, noisy_azimuth, stages
from fgrecon_research.training.priors.apollo79 import Apollo79

K = np.array([[721.5, 0.0, 609.6], [0.0, 721.5, 172.9], [0.0, 0.0, 1.0]])
OFFSET = np.array([0.06, 0.0, 0.003])
CALIBRATION = KittiCalibration(Camera(K, image_size=(1242, 375)), OFFSET)


def label(prior, x, z, yaw, size=(3.9, 1.6, 1.5), occlusion=0):
    """A label line of a car that stands at (x, 1.65, z) with the box of its mean shape."""
    pose = np.eye(4)
    c, s = np.cos(yaw), np.sin(yaw)
    pose[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    stretch = np.array(size)[[0, 2, 1]] / prior.box_size(np.zeros(prior.dimension))[[0, 2, 1]]
    points = (prior.surface.mean * stretch) @ pose[:3, :3].T + [x, 1.65, z] + OFFSET
    pixels = CALIBRATION.camera.project(points)
    box = np.concatenate([pixels.min(0), pixels.max(0)])
    length, width, height = size
    alpha = yaw - np.arctan2(x, z)
    return f"Car 0 {occlusion} {alpha} {' '.join(map(str, box))} {height} {width} {length} {x} 1.65 {z} {yaw}"


def frame_of(*lines, name="000007", without=()):
    labels, problems = parse_objects("\n".join(lines), "test")
    assert not problems
    kept = labels.take(np.array([i for i in range(len(labels)) if i not in without], dtype=np.intp))
    found = Objects.detections(kept.kind, kept.box, np.linspace(0.9, 0.5, len(kept)))
    return KittiFrame(name, labels, found, CALIBRATION)


@pytest.fixture(scope="module")
def fleet(scene):
    prior = scene.prior
    rng = np.random.default_rng(0)
    coefficients = rng.normal(scale=0.5, size=(3, prior.dimension))
    vehicles = [Vehicle.of_prior(prior, row) for row in coefficients]
    return Fleet(vehicles, np.array([prior.box_size(row) for row in coefficients]))


def test_an_instance_has_the_labelled_pose_and_size(scene, fleet):
    frame = frame_of(label(scene.prior, 1.5, 14.0, 0.4, size=(4.4, 1.7, 1.6)))
    (instance,) = simulate_frame(frame, fleet)
    assert instance.camera_T_object[:3, 3] == pytest.approx(np.array([1.5, 1.65, 14.0]) + OFFSET)
    assert instance.rotation_y == 0.4
    assert scene.prior.category.dimension_operator.reshape(3, -1) @ instance.keypoints.ravel() == pytest.approx(
        [4.4, 1.7, 1.6]
    )
    points = instance.keypoints @ instance.camera_T_object[:3, :3].T + instance.camera_T_object[:3, 3]
    np.testing.assert_allclose(instance.projections, CALIBRATION.camera.project(points))
    assert instance.regimes.tolist() == [True, True, True]
    assert 3 <= instance.visible.sum() <= 11
    np.testing.assert_array_equal(instance.observation.box, frame.detections.box[0])


def test_an_instance_depends_on_its_own_place_alone(scene, fleet):
    lines = [label(scene.prior, x, 14.0, 0.4) for x in (-4.0, 1.5)]
    both = simulate_frame(frame_of(*lines), fleet)
    again = simulate_frame(frame_of(*lines), fleet)
    np.testing.assert_array_equal(both[1].observation.keypoints, again[1].observation.keypoints)
    without = simulate_frame(frame_of(lines[0], "DontCare -1 -1 -10 0 0 5 5 -1 -1 -1 -1000 -1000 -1000 -10"), fleet)
    np.testing.assert_array_equal(both[0].observation.keypoints, without[0].observation.keypoints)
    other = simulate_frame(frame_of(*lines, name="000008"), fleet)
    assert not np.array_equal(both[1].observation.keypoints, other[1].observation.keypoints)


def test_a_car_without_a_detection_stays_and_one_beyond_all_regimes_goes(scene, fleet):
    lines = [label(scene.prior, -4.0, 14.0, 0.4), label(scene.prior, 2.0, 14.0, 0.4, occlusion=3)]
    instances = simulate_frame(frame_of(*lines, without=(0,)), fleet)
    assert [(i.index, i.detection, i.observation) for i in instances] == [(0, -1, None)]


def test_a_car_in_front_hides_the_one_behind(scene, fleet):
    front, behind = label(scene.prior, 0.5, 9.0, 0.0), label(scene.prior, 0.5, 16.0, 0.0)
    alone = simulate_frame(frame_of(behind), fleet)[0]
    covered = simulate_frame(frame_of(behind, front), fleet)[0]
    assert alone.visible.sum() >= 4
    assert covered.visible.sum() < alone.visible.sum()
    assert not (covered.visible & ~alone.visible).any()
    assert simulate_frame(frame_of(front, behind), fleet)[0].visible.sum() >= 4


def test_lines_of_sight_through_a_box_by_hand():
    box, _ = parse_objects("Car 0 0 0 0 0 9 9 2 2 4 0 1 10 0", "test")  # x in +-2, y in -1..1, z in 9..11
    points = np.array([[0.0, 0, 20], [0, 0, 5], [5, 0, 20], [0, -4, 20], [3.0, 0, 20], [0, 0, -20]])
    hidden = hidden_by_boxes(points, box, np.zeros(3))
    assert hidden.tolist() == [True, False, False, False, True, False]


def test_each_detection_goes_to_one_label():
    labels = Objects.detections(["Car"] * 2, np.array([[0, 0, 100, 50.0], [4, 0, 104, 50]]), np.zeros(2))
    found = Objects.detections(
        ["Car", "Pedestrian", "Car"], np.array([[4, 0, 104, 50.0], [0, 0, 100, 50], [0, 0, 50, 50]]), np.ones(3)
    )
    assert match_detections(labels, found).tolist() == [-1, 0]
    assert match_detections(labels, found.take(np.zeros(3, dtype=bool))).tolist() == [-1, -1]


def test_the_initialisation_fills_the_box_at_the_azimuth(scene):
    model = prepare(scene.prior, scene.size)
    box = np.array([500.0, 160.0, 640.0, 220.0])
    state = initial_state(box, CALIBRATION.camera, model, Ground.level(1.65), 0.7)
    forward = state.camera_T_object[:3, 0]
    assert np.arctan2(-forward[2], forward[0]) == pytest.approx(0.7)
    pixels = CALIBRATION.camera.project(
        model.prior.surface.mean @ state.camera_T_object[:3, :3].T + state.camera_T_object[:3, 3]
    )
    assert (pixels.min(0) + pixels.max(0)) / 2 == pytest.approx([570.0, 190.0], abs=6.0)
    size = np.ptp(pixels, axis=0)
    assert np.sqrt(size.prod()) == pytest.approx(np.sqrt(140.0 * 60.0), rel=0.1)


def test_azimuths_have_the_stated_noise():
    rng = np.random.default_rng(1)
    error = np.degrees([noisy_azimuth(0.0, rng) for _ in range(20000)])
    within = [(np.abs(error) <= limit).mean() for limit in (5, 15, 30)]
    assert within == pytest.approx([0.412, 0.860, 0.937], abs=0.01)
    assert (np.abs(error) > 60).mean() == pytest.approx(AZIMUTH_GROSS * 2 / 3, abs=0.01)


def test_stages_of_an_exact_observation_end_at_the_truth(scene, fleet):
    noise = HOURGLASS
    frame = frame_of(label(scene.prior, 1.5, 12.0, 0.4, size=tuple(scene.size.mean)))
    instance = simulate_frame(frame, Fleet(fleet.vehicles, fleet.sizes, noise))[0]
    given = {"ground": scene.ground, "size_prior": scene.size}
    found = stages(instance.observation, instance.camera, scene.prior, Options(box=BoxModel.CUBOID), **given)
    assert list(found) == ["pose", "shape", "joint"]
    # In the shape stage the pose is a constant.
    np.testing.assert_allclose(found["shape"].camera_T_object, found["pose"].camera_T_object, atol=1e-12)
    assert found["joint"].in_camera()[:, 2] == pytest.approx(12.0, abs=4.0)
    with pytest.raises(ValueError, match="history"):
        stages(instance.observation, instance.camera, scene.prior, Options(keep_history=False))


ROWS = ("initialisation", "sqpnp_confident+size", "pose", "sequential", "joint")


def test_scores_by_hand_for_a_row_that_knows_the_truth_and_one_that_fails(scene, fleet):
    frame = frame_of(label(scene.prior, 1.5, 14.0, 0.4), label(scene.prior, -4.0, 14.0, 0.4), without=(1,))
    instances = simulate_frame(frame, fleet)

    def truth(instance):
        from fgrecon_research.paper.stages import StageEstimate

        return {"truth": StageEstimate(instance.camera_T_object, instance.keypoints, np.ones(3))}

    def broken(instance):
        raise RuntimeError("no luck")

    scores = score_instances(instances, ("truth", "broken"), (truth, broken), scene.prior.mean)
    assert scores.orientation == pytest.approx(np.array([[0.0, 180.0], [180.0, 180.0]]))
    assert scores.translation[0, 0] == pytest.approx(0.0)
    assert np.isinf(scores.translation[[0, 1, 1], [1, 0, 1]]).all()
    assert scores.reprojection[0, 0] == pytest.approx(0.0)
    assert np.isinf(scores.reprojection[0, 1]).all()
    assert scores.shape[0, 0] == 0.0
    assert scores.location[0, 0] == pytest.approx([1.5, 1.65, 14.0])
    assert scores.detection.tolist() == [0, -1]
    assert scores.failures.tolist() == ["000007:0: RuntimeError: no luck"]


def test_a_run_can_be_taken_up_again_and_does_not_depend_on_processes(scene, fleet, tmp_path):
    lines = [label(scene.prior, x, 14.0, yaw) for x, yaw in ((-4.0, 0.4), (2.0, -1.5))]
    frames = tuple(frame_of(*lines, name=f"{number:06d}") for number in range(30))
    keypoints = np.array([v.keypoints for v in fleet.vehicles])
    vertices = np.array([v.vertices for v in fleet.vehicles])
    faces = fleet.vehicles[0].faces
    models = Apollo79(("a", "b", "c"), keypoints, keypoints, vertices, vertices, faces, fleet.sizes, np.ones(3))
    validation, condition = Validation(frames, ()), Condition("few", 0.0, 1, ("initialisation", "sqpnp_confident+size"))
    known = SceneKnowledge(scene.prior, scene.ground, scene.size)
    calls = []

    def run(folder, workers, fresh=False):
        tell = lambda *what: calls.append(what)  # noqa: E731
        settings = PaperSettings(tmp_path, folder, known, workers, fresh=fresh)
        return run_conditions(validation, (condition,), models, settings, tell)["few"]

    first = run(tmp_path / "a", 1)
    assert (len(first.scores), first.solved) == (60, 60)
    assert calls == [("few", 0, 2), ("few", 1, 2), ("few", 2, 2)]
    parts = sorted((tmp_path / "a").rglob("*.npz"))
    parts[0].unlink()
    again = run(tmp_path / "a", 1)
    assert again.solved == 48  # 24 frames of two cars
    other = run(tmp_path / "b", 2)
    assert run(tmp_path / "b", 1, fresh=True).solved == 60
    half = PaperSettings(tmp_path, tmp_path / "a", known, every=2, seed=1)
    other_seed = run_conditions(validation, (condition,), models, half)["few"]
    assert other_seed.solved == len(other_seed.scores) == 48
    assert not np.array_equal(other_seed.scores.yaw, first.scores.yaw[:48])
    for name in ("frame", "index", "yaw", "location", "reprojection", "measured", "from_start"):
        np.testing.assert_array_equal(getattr(first.scores, name), getattr(again.scores, name))
        np.testing.assert_array_equal(getattr(first.scores, name), getattr(other.scores, name))


def test_rows_of_the_stages_come_from_one_solve(scene, fleet):
    instances = simulate_frame(frame_of(label(scene.prior, 1.5, 14.0, 0.4)), fleet)
    scores = score_instances(instances, ROWS, row_solvers(ROWS, scene, 0), of_fleet(scene.prior, scene.size).mean)
    pose, sequential, joint = (ROWS.index(name) for name in ROWS[2:])
    assert np.isfinite(scores.yaw).all()
    assert scores.yaw[0, pose] == pytest.approx(scores.yaw[0, sequential], abs=1e-9)
    assert scores.from_start[0, 0] == 0.0
    assert scores.from_mean[0, :2] == pytest.approx(0.0)
    assert np.isfinite(scores.from_before[0, [sequential, joint]]).all()
    assert np.isinf(scores.from_before[0, [0, 1, pose]]).all()


def test_scores_are_read_back_to_the_last_bit(scene, fleet, tmp_path):
    instances = simulate_frame(frame_of(label(scene.prior, 1.5, 14.0, 0.4)), fleet)
    rows = ("initialisation",)
    scores = score_instances(instances, rows, row_solvers(rows, scene, 0), scene.prior.mean)
    scores.write(tmp_path / "part.npz")
    back = Scores.read(tmp_path / "part.npz")
    np.testing.assert_array_equal(back.reprojection, scores.reprojection)
    joined = Scores.join([back, score_instances([], rows, (), scene.prior.mean), back])
    assert len(joined) == 2
