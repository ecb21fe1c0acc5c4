"""Labelled boxes with a LiDAR beside the image: crude baselines, the boxes' overlap, how many points each has."""

from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pytest

from fgrecon.calibration.labelled_boxes import BoxOutcome, VideoBox
from fgrecon.calibration.labelled_frames import score_frames
from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import yaw_rotation
from fgrecon.io.images import write_png
from fgrecon.io.kitti_files import read_drive
from fgrecon_research.evaluation.point_baselines import CUBOID, MEDIAN, by_median_depth, fit_cuboid
from fgrecon_research.evaluation.sensor_methods import OtherMethods, with_points
from fgrecon_research.evaluation.video_summary import box_overlap, group_boxes
from fgrecon_research.io.drive_sensors import Sensor, with_sensors
from tests.made_up_track import T2, K

from .test_video_images import PLACES, SIZE, YAWS, folder, setup  # noqa: F401


def surface(place, yaw, size, count=400):
    """Points (count, 3) on the sides of a cuboid that a camera at the origin sees, and inside none."""
    length, width, height = size
    rng = np.random.default_rng(1)
    local = rng.uniform(-0.5, 0.5, (count, 3)) * [length, height, width]
    axis = rng.choice([0, 2], count)
    centre = np.array(place) - [0.0, height / 2.0, 0.0]
    towards = np.sign(-centre @ yaw_rotation(yaw))
    half = np.array([length, height, width]) / 2.0
    local[np.arange(count), axis] = (towards * half)[axis]
    return local @ yaw_rotation(yaw).T + centre


@pytest.fixture
def scanned(folder):  # noqa: F811
    """The drive, with a scan of its three vehicles and the ground."""
    rng = np.random.default_rng(2)
    ground = np.column_stack([rng.uniform(-8, 8, 900), np.full(900, 1.65), rng.uniform(6, 25, 900)])
    points = np.vstack([ground, *(surface(place, yaw, SIZE) for place, yaw in zip(PLACES, YAWS, strict=True))])
    (folder / "lidar").mkdir()
    np.savez(folder / "lidar" / "000000.npz", points_cm=np.round(100.0 * points).astype(np.int16))
    return folder


def test_a_cuboid_is_fitted_to_the_sides_that_were_seen():
    place, yaw = np.array([2.0, 1.6, 14.0]), 0.9
    points = surface(place, yaw, SIZE)
    found, turned = fit_cuboid(points, place + np.array([0.4, 0.0, 0.8]), yaw + 0.05, np.array(SIZE))
    np.testing.assert_allclose(found, place, atol=0.02)
    assert turned == pytest.approx(yaw, abs=0.01)


def test_the_median_depth_is_that_of_the_near_side():
    camera = Camera(np.array([[700.0, 0, 600], [0, 700, 180], [0, 0, 1]]))
    points = np.column_stack([np.zeros(3), np.zeros(3), [9.0, 10.0, 30.0]])
    middle = by_median_depth(points, camera, np.array([590.0, 170.0, 610.0, 190.0]), np.array([4.0, 1.6, 1.5]))
    np.testing.assert_allclose(middle, [0.0, 0.0, 12.0])


@pytest.mark.filterwarnings("ignore::fgrecon.errors.ContradictoryInputWarning")
def test_baselines_stand_beside_the_picture_alone(scanned, setup, scene):  # noqa: F811
    sensors = Sensor.LIDAR, Sensor.DEPTH
    drive = with_sensors(read_drive(scanned), sensors)
    (frame,) = score_frames([drive], {"drive": setup}, rivals=partial(OtherMethods, scene, (), sensors))
    right, _, refused = with_points(frame.boxes, [drive])
    assert 100 < right.points < 400  # in centimetres some of the surface are outside
    assert right.outcomes[CUBOID].metres < 0.5
    assert right.outcomes[MEDIAN].metres < 2.0
    assert "no pose" in refused.outcomes[CUBOID].failure
    assert {"lidar", "lidar/4", "lidar/16", "lidar_turned", "depth", "depth_affine"} < set(right.outcomes)
    assert right.outcomes["depth"].metres < right.outcomes[CUBOID].metres + 0.3
    assert right.outcomes["lidar"].metres < right.outcomes[CUBOID].metres + 0.2
    assert right.outcomes["lidar"] != right.outcomes["lidar/16"]
    assert set(group_boxes([right])["points"]) <= {"100-500 points", "from 500 points on"}
    assert "points" in right.rows()[0]


def test_only_frames_with_the_sensors_files_are_scored(folder):  # noqa: F811
    with pytest.raises(InvalidInputError, match=r"lidar/FFFFFF\.npz"):
        with_sensors(read_drive(folder), [Sensor.LIDAR])


def test_3d_boxes_overlap_as_by_hand():
    box = VideoBox("d", 0, 0, 0, "Car", 0.0, 0, 50.0, 15.0, 0.0, None, {}, rotation_y=0.3, size=(4.0, 2.0, 1.5))
    off = 1.0 * np.array([np.cos(0.3), 0.0, -np.sin(0.3)])  # a metre ahead: three quarters of the length are shared
    found = BoxOutcome(0.0, 1.0, (0.0, 0.0, 0.0), None, None, (0.0, *off.tolist()))
    assert box_overlap(box, found) == pytest.approx(3.0 / 5.0)
    assert box_overlap(box, replace(found, off=(180.0, 0.0, 0.0, 0.0))) == pytest.approx(1.0)
    assert box_overlap(box, replace(found, size=None)) is None
    assert box_overlap(replace(box, size=None), found) is None


@pytest.mark.filterwarnings("ignore::fgrecon.errors.ContradictoryInputWarning")
def test_the_right_image_has_baselines_of_its_own(folder, setup, scene):  # noqa: F811
    """Both images show one texture as of a wall 12 m away, where the second vehicle is."""
    texture = np.random.default_rng(3).integers(0, 255, (360, 1200, 3)).astype(np.uint8)
    left = cv2.GaussianBlur(texture, (0, 0), 1.5)
    disparity = round(K[0, 0] * 0.5 / 12.0)
    (folder / "image_03").mkdir()
    write_png(folder / "image_02" / "000000.png", left)
    write_png(folder / "image_03" / "000000.png", np.roll(left, -disparity, axis=1))
    p3 = " ".join(map(str, np.hstack([K, (K @ (T2 - [0.5, 0.0, 0.0]))[:, None]]).ravel()))
    with (folder / "calib.txt").open("a") as file:
        file.write(f"P3: {p3}\n")
    drive = with_sensors(read_drive(folder), [Sensor.RIGHT])
    (frame,) = score_frames([drive], {"drive": setup}, rivals=partial(OtherMethods, scene, (), (Sensor.RIGHT,)))
    of_second = frame.boxes[1].outcomes
    assert of_second[f"{MEDIAN}_stereo"].off[3] == pytest.approx(2.1, abs=0.6)  # half a length
    assert of_second[f"{CUBOID}_stereo"].failure is None
    assert of_second["stereo"].failure is None
