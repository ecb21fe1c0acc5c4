"""The ground over time: what vehicles said of it stays known, is forgotten slowly, and follows the camera."""

import gtsam
import numpy as np
import pytest

import fgrecon
from factors.contact import GroundFrame
from factors.keys import G
from factors.marginals import Marginal
from fgrecon.core.camera import Ground
from fgrecon.solve.ground_filter import CameraFrame, GroundFilter
from fgrecon.solve.image_ground import GroundEvidence
from tests.solve.time.streets import CAMERA, PRIOR, seen, upright

GROUND = 1.65
GIVEN = Ground.level(GROUND)
LEVEL = GroundFrame.of(GIVEN.normal, GROUND)
SLOPE = np.array([0.05, 0.02, 0.0])  # the camera is 5 cm higher than given, and the road goes up
SURE = np.array([0.01, 0.001, 0.001])


class Saying:
    """Vehicles that say where the ground is."""

    def __init__(self, change, sigma=SURE, common_factor=1.0, poses=()):
        self.change, self.sigma, self.common_factor = np.asarray(change, dtype=float), sigma, common_factor
        self.seen, self.looked_at = poses, []

    def look(self, ground):
        self.looked_at.append(ground)
        return self

    def poses(self):
        return self.seen

    def ground_evidence(self, known, plane):
        del known, plane
        values = gtsam.Values()
        values.insert(G(0), self.change)
        said = Marginal((G(0),), (3,), values, np.diag(1.0 / self.sigma), np.zeros(3))
        return GroundEvidence(said, self.common_factor)


class Silent(Saying):
    """Vehicles that say nothing."""

    def __init__(self, poses=()):
        super().__init__(np.zeros(3), poses=poses)

    def ground_evidence(self, known, plane):
        del known, plane


class Video:
    """A road, frame by frame."""

    def __init__(self):
        self.road = GroundFilter()


def later(video, time, given, place, vehicles, camera=CAMERA, **more):
    frame = CameraFrame(time, camera, given, place, **more)
    video.road, known, looked = video.road.later(frame, vehicles.look)
    assert looked is vehicles
    return known


def slope_of(known):
    ground = known.ground
    return ground.normal[2] / ground.normal[1]


def test_the_first_frame_is_what_is_given_and_what_vehicles_say():
    known = later(Video(), 0.0, GIVEN, None, Saying(SLOPE))
    ground = known.ground
    prior = np.array([GIVEN.height_sigma, GIVEN.slope_sigma, GIVEN.slope_sigma])
    expected = SLOPE * prior**2 / (prior**2 + SURE**2)
    assert slope_of(known) == pytest.approx(expected[1], rel=1e-6)
    assert ground.distance == pytest.approx(GROUND + expected[0], rel=1e-6)
    assert ground.height_sigma < GIVEN.height_sigma
    assert ground.slope_sigma < 0.5 * GIVEN.slope_sigma


def test_a_vehicle_may_be_as_far_off_a_measured_plane_as_roads_are():
    """Vehicles that agree make a ground that is given sharper for all, but not the road beside the sensor's plane."""
    banked = Ground(np.array([0.05, 1.0, -0.01]), 1.7, height_sigma=0.05, slope_sigma=0.006)
    given, measured = (later(Video(), 0.0, banked, None, Saying(SLOPE), sensed=one).ground for one in (False, True))
    assert given.height_sigma_at_depth(40.0) < 0.25 * banked.height_sigma_at_depth(40.0)
    for depth in (1.0, 10.0, 40.0):
        assert measured.height_sigma_at_depth(depth) >= banked.height_sigma_at_depth(depth) * (1.0 - 1e-9)
    np.testing.assert_allclose(measured.normal, given.normal)


def test_without_vehicles_it_is_what_is_given():
    ground = later(Video(), 0.0, GIVEN, None, Silent()).ground
    np.testing.assert_allclose(ground.normal, GIVEN.normal, atol=1e-12)
    assert ground.distance == pytest.approx(GROUND)
    assert (ground.height_sigma, ground.slope_sigma) == pytest.approx((GIVEN.height_sigma, GIVEN.slope_sigma))


def test_it_stays_known_and_is_forgotten_slowly():
    road = Video()
    first = later(road, 0.0, GIVEN, None, Saying(SLOPE))
    grounds = [later(road, time, GIVEN, None, Silent()) for time in (0.5, 5.0, 300.0)]
    slopes = [slope_of(first), *map(slope_of, grounds)]
    assert slopes == sorted(slopes, reverse=True)
    assert slopes[1] > 0.9 * slopes[0]
    assert slopes[3] < 0.01 * slopes[0]
    sigmas = [known.ground.slope_sigma for known in (first, *grounds)]
    assert sigmas == sorted(sigmas)
    assert sigmas[3] == pytest.approx(GIVEN.slope_sigma, rel=1e-3)
    late = later(road, 1e7, GIVEN, None, Silent())
    assert late.ground.slope_sigma == pytest.approx(GIVEN.slope_sigma, rel=1e-3)


def test_vehicles_that_are_seen_again_count_by_the_time_that_passed():
    """Eleven frames within 0.3 s say what two do, and less than ten that are as far apart as those two."""

    def slope_after(times):
        road = Video()
        for time in times:
            ground = later(road, time, GIVEN, None, Saying(SLOPE, sigma=10.0 * SURE))
        return slope_of(ground)

    dense, two = slope_after(0.03 * np.arange(11)), slope_after([0.0, 0.3])
    assert dense == pytest.approx(two, rel=0.05)
    assert slope_after(0.3 * np.arange(10)) > 1.2 * dense


def test_it_turns_with_the_camera():
    """A camera that has nodded by the slope of the road sees it level."""
    nod = gtsam.Pose3(gtsam.Rot3.Rx(SLOPE[1]), np.zeros(3))  # its axis goes up with the road
    seen_by, slopes = [None, gtsam.Pose3()], []
    for first in seen_by:
        road = Video()
        before = later(road, 0.0, GIVEN, first, Saying(SLOPE))
        slopes.append(slope_of(later(road, 0.1, GIVEN, None if first is None else nod, Silent())))
    assert slopes[0] == pytest.approx(slope_of(before), rel=0.01)
    assert abs(slopes[1]) < 0.1 * slopes[0]


def test_where_the_ground_before_tells_nothing_it_begins_anew():
    road = Video()
    later(road, 0.0, GIVEN, gtsam.Pose3(), Saying(SLOPE))
    away = gtsam.Pose3(upright(0.3, [1e6, 0.0, 1e6]))
    known = later(road, 0.01, GIVEN, away, Silent())
    np.testing.assert_allclose(known.ground.normal, GIVEN.normal, atol=1e-12)
    assert known.ground.distance == GROUND


def test_a_motion_that_is_not_exact_leaves_the_ground_less_sure():
    sigmas = []
    for turn in (0.0, 0.01):
        road = Video()
        later(road, 0.0, GIVEN, gtsam.Pose3(), Saying(SLOPE))
        covariance = np.diag([turn**2] * 3 + [0.0] * 3)
        known = later(road, 0.1, GIVEN, gtsam.Pose3(), Silent(), motion_covariance=covariance)
        sigmas.append(known.ground.slope_sigma)
    assert sigmas[1] > 1.2 * sigmas[0]


@pytest.mark.parametrize(("axis", "matters"), [(0, False), (1, True), (2, False)])
def test_of_the_cameras_way_only_what_goes_up_and_down_matters(axis, matters):
    sigmas = []
    for way in (0.0, 0.3):
        road = Video()
        later(road, 0.0, GIVEN, gtsam.Pose3(), Saying(SLOPE))
        covariance = np.zeros((6, 6))
        covariance[3 + axis, 3 + axis] = way**2
        known = later(road, 0.1, GIVEN, gtsam.Pose3(), Silent(), motion_covariance=covariance)
        sigmas.append(known.ground.height_sigma)
    assert (sigmas[1] > 1.2 * sigmas[0]) == matters


def test_a_pose_is_as_unsure_as_the_ground_that_decides_it():
    """A pose that only the ground's height decides has the ground's variance and its own; one that is known, none."""
    known = later(Video(), 0.0, GIVEN, None, Saying(SLOPE, sigma=3.0 * SURE))
    pose = upright(0.7, [2.0, GROUND, 20.0])
    down = pose[:3, :3].T @ known.ground.normal
    used = known.ground.height_sigma_at_depth(20.0) ** 2
    decided = np.zeros((6, 6))
    decided[3:, 3:] = used * np.outer(down, down)
    found = known.considered(pose, decided)
    across = np.array([-1.0, 20.0, 2.0])
    own = (0.35 * GIVEN.height_sigma) ** 2 + (0.15 * GIVEN.slope_sigma * 20.0) ** 2
    assert down @ found[3:, 3:] @ down == pytest.approx(own + across @ known.covariance @ across, rel=0.05)
    assert down @ found[3:, 3:] @ down > 1.2 * used
    np.testing.assert_allclose(known.considered(pose, 1e-9 * np.eye(6)), 1e-9 * np.eye(6), atol=1e-12)


def test_vehicles_whose_errors_go_together_leave_the_ground_less_sure_and_in_place():
    pairs = [(Video(), 1.0), (Video(), 4.0)]
    for time in (0.0, 0.1, 0.2):
        known = [later(road, time, GIVEN, None, Saying(SLOPE, 3.0 * SURE, f)) for road, f in pairs]
    np.testing.assert_array_equal(known[0].ground.normal, known[1].ground.normal)
    assert known[0].ground.slope_sigma == known[1].ground.slope_sigma
    grown = np.diag(known[1].covariance) / np.diag(known[0].covariance)
    assert ((grown > 2.5) & (grown < 4.0)).all()  # what is given and what is forgotten count as they did


@pytest.mark.parametrize("slope", [0.03, -0.03])
def test_vehicles_tell_the_road(slope):
    """Three cars on a slope; 20 m ahead their road is 0.6 m off the one that is given."""
    rng = np.random.default_rng(0)
    places = [(-4.0, 10.0), (2.0, 20.0), (-3.0, 28.0)]
    poses = [upright(1.3, [x, GROUND + slope * z, z]) for x, z in places]
    tracker = fgrecon.Tracker(size_prior="kitti", shared_ground=True)
    for t in range(5):
        given = {i: seen(pose, rng) for i, pose in enumerate(poses)}
        tracker.update(0.1 * t, given, camera=CAMERA, ground=GROUND)
    ground = tracker._tracks[1].vehicle.past[-1].problem.ground
    assert (ground.distance - 20.0 * ground.normal[2]) / ground.normal[1] == pytest.approx(
        GROUND + 20.0 * slope, abs=0.15
    )
    assert ground.slope_sigma < 0.6 * GIVEN.slope_sigma


def test_a_vehicle_alone_is_a_single_image():
    pose = upright(1.3, [2.0, GROUND, 20.0])
    observation = seen(pose, np.random.default_rng(1))
    tracker = fgrecon.Tracker(size_prior="kitti", shared_ground=True)
    found = tracker.update(0.0, {1: observation}, camera=CAMERA, ground=GROUND)[1].reconstruction
    alone = fgrecon.reconstruct(observation, CAMERA, ground=GROUND, size_prior="kitti")
    np.testing.assert_allclose(found.camera_T_object, alone.camera_T_object, atol=1e-5)


def standing(height, *, lean=0.0):
    """Two poses on a road under a camera."""
    turn = gtsam.Rot3.Rx(lean).matrix()
    poses = [upright(yaw, [x, height, 15.0]) for yaw, x in ((0.3, -2.0), (1.2, 3.0))]
    for pose in poses:
        pose[:3] = turn @ pose[:3]
    return poses


@pytest.mark.parametrize("seen_poses", [(), standing(2.0)[:1]])
def test_where_nothing_is_given_one_vehicle_tells_no_ground(seen_poses):
    vehicles = Silent(seen_poses)
    assert later(Video(), 0.0, None, None, vehicles) is None
    assert vehicles.looked_at == [None]


def test_where_nothing_is_given_vehicles_tell_where_it_is():
    road, first = Video(), Saying([0.1, 0.0, 0.0], poses=standing(2.0))
    known = later(road, 0.0, None, None, first)
    assert first.looked_at == [None], "once"
    assert known.ground.distance == pytest.approx(2.1, abs=1e-3)
    second = Silent()
    later(road, 0.1, None, None, second)
    (ground,) = second.looked_at
    assert ground.distance == pytest.approx(2.1, abs=1e-3)
    assert ground.height_sigma > known.ground.height_sigma


def test_an_assumed_ground_may_change_fast():
    """A camera in a hand nods by three degrees; a mount whose height is given does not."""
    slopes = []
    for given in (None, GIVEN):
        road = Video()
        later(road, 0.0, given, None, Saying(np.zeros(3), poses=standing(GROUND)))
        slopes.append(slope_of(later(road, 0.1, given, None, Saying([0.0, 0.05, 0.0]))))
    assert slopes[0] == pytest.approx(0.05, rel=0.05)
    assert slopes[1] < 0.6 * 0.05


def test_what_is_given_later_counts_at_once():
    road = Video()
    later(road, 0.0, None, None, Saying(np.zeros(3), poses=standing(3.0)))
    assert later(road, 0.1, GIVEN, None, Silent()).ground.distance == pytest.approx(GROUND)
    remembered = later(road, 0.2, None, None, Silent()).ground
    assert remembered.distance == pytest.approx(GROUND), "and is remembered"


def test_another_camera_begins_anew_and_one_that_moved_sees_it_move():
    road = Video()
    later(road, 0.0, None, gtsam.Pose3(), Saying(np.zeros(3), poses=standing(2.0)))
    higher = gtsam.Pose3(gtsam.Rot3.Rx(0.2), np.array([0.0, -1.0, 0.0]))
    moved = later(road, 0.1, None, higher, Silent()).ground
    assert moved.distance == pytest.approx(3.0, abs=0.01)
    assert np.arctan2(moved.normal[2], moved.normal[1]) == pytest.approx(-0.2, abs=1e-3)
    zoomed = fgrecon.Camera(CAMERA.matrix * [[2.0], [2.0], [1.0]])
    assert later(road, 0.2, None, None, Silent(), camera=zoomed) is None
    upside_down = gtsam.Pose3(gtsam.Rot3.Rz(np.pi), np.zeros(3))
    later(road, 0.3, None, gtsam.Pose3(), Saying(np.zeros(3), poses=standing(2.0)))
    assert later(road, 0.4, None, upside_down, Silent()) is None


def test_vehicles_on_one_road_are_better_placed_together_though_nothing_is_reported():
    """A camera 2.5 m up that looks down by ten degrees, and cars of many sizes."""
    turn, errors = gtsam.Rot3.Rx(np.radians(10.0)).matrix(), {True: [], False: []}
    for seed in range(8):
        rng = np.random.default_rng(seed)
        poses = [upright(yaw, [x, 2.5, z]) for yaw, x, z in ((1.4, -4.0, 12.0), (1.7, 2.0, 20.0), (-1.5, -3.0, 30.0))]
        shapes = rng.normal(size=(3, PRIOR.dimension))
        for pose in poses:
            pose[:3] = turn @ pose[:3]
        frames = [{i: seen(p, rng, shape=shapes[i]) for i, p in enumerate(poses)} for _ in range(4)]
        for shared, off_by in errors.items():
            tracker = fgrecon.Tracker(shared_ground=shared)
            for t, given in enumerate(frames):
                found = tracker.update(0.1 * t, given, camera=CAMERA)
            off_by += [np.linalg.norm(found[i].reconstruction.location - pose[:3, 3]) for i, pose in enumerate(poses)]
    assert np.mean(errors[True]) < 0.85 * np.mean(errors[False])


@pytest.mark.parametrize("given", [None, GIVEN])
def test_what_points_said_of_it_holds_for_a_while_without_points(given):
    banked = Ground(np.array([0.05, 1.0, -0.01]), 1.7, height_sigma=0.05, slope_sigma=0.006)
    video = Video()
    later(video, 0.0, GIVEN, None, Saying(SLOPE))
    first = later(video, 0.1, banked, None, Silent(), sensed=True).ground
    np.testing.assert_allclose(first.normal, banked.normal, atol=1e-9)
    between = later(video, 0.3, given, None, Silent()).ground
    np.testing.assert_allclose(between.normal, banked.normal, atol=1e-6)
    assert between.height_sigma == pytest.approx(banked.height_sigma, rel=0.05)
    again = later(video, 0.4, Ground.level(1.6), None, Silent(), sensed=True).ground
    assert again.distance == pytest.approx(1.6, abs=0.01)
    much_later = later(video, 9.0, given, None, Silent())
    if given is not None:
        np.testing.assert_allclose(much_later.ground.normal, GIVEN.normal, atol=1e-9)
        assert much_later.ground.slope_sigma == pytest.approx(GIVEN.slope_sigma, rel=0.01)
