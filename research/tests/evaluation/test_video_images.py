"""Boxes of video drives as single images: which count, how they are scored, on a made-up drive with exact keypoints."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from fgrecon.calibration.labelled_boxes import (
    SYSTEM,
    View,
    view_of,
    wanted,
)
from fgrecon.calibration.labelled_frames import Setup, score_frames
from fgrecon.core.camera import Ground
from fgrecon.core.detection import Detection, facing_probability
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import view_azimuth, yaw_rotation
from fgrecon.core.observation import Observation
from fgrecon.core.options import Options
from fgrecon.io.catalogue import load_prior
from fgrecon.io.images import write_png
from fgrecon.io.kitti_files import read_drive
from fgrecon_research.evaluation.run import ScoredRivals
from tests.made_up_track import T2, K, pose_of

FRONT, REAR = np.pi / 2, -np.pi / 2  # rotation_y of a car straight ahead of the camera that shows this
SIZE = (4.5, 1.8, 1.4)
PLACES = [(-3.0, 1.65, 14.0), (0.0, 1.65, 12.0), (4.0, 1.65, 15.0)]
YAWS = [FRONT + 0.4, REAR, 0.1]
TURNS = [0.0, np.pi, 0.0]  # by which the detector is wrong
SHIFTS = [(0.0, 0.0, 0.0), (0.0, 0.0, 0.5), (0.0, 0.0, 0.0)]
BOXES = np.array([[300.0, 120.0, 440.0, 270.0], [500.0, 110.0, 700.0, 290.0], [720.0, 120.0, 900.0, 275.0]])
BINS = 2 * np.pi * np.arange(36) / 36


def label(track, kind, place, yaw, box, occlusion=0, truncation=0.0):
    length, width, height = SIZE
    numbers = (truncation, occlusion, 0.0, *box, height, width, length, *place, yaw)
    return f"0 {track} {kind} {' '.join(map(str, numbers))}\n"


class ExactDetector:
    """Keypoints of the mean car, seen exactly in a pose of its own for each box; of the last box two points alone."""

    category = "car14"

    def __call__(self, image, boxes):
        return [self._see(box) for box in boxes]

    def _see(self, box):
        number = int(np.argmin(np.abs(BOXES - box).sum(axis=1)))
        place = np.add(PLACES[number], T2)
        yaw = YAWS[number] + TURNS[number]
        pose = pose_of(yaw, place + SHIFTS[number])
        points = load_prior("car14").mean @ pose[:3, :3].T + pose[:3, 3]
        pixels = (points @ K.T)[:, :2] / points[:, 2:]
        if number == 2:
            pixels[2:] = np.nan
        x, _, z = -pose[:3, :3].T @ pose[:3, 3]
        directions = np.exp((np.cos(BINS - np.arctan2(z, x)) - 1.0) / 0.02)
        return Detection(Observation(pixels, np.full(14, 0.9), box), directions / directions.sum())


@pytest.fixture
def folder(tmp_path):
    """A drive of one image with three boxes that count and many that do not."""
    drive = tmp_path / "drive"
    (drive / "image_02").mkdir(parents=True)
    write_png(drive / "image_02" / "000000.png", np.zeros((360, 1200, 3), np.uint8))
    p2 = " ".join(map(str, np.hstack([K, (K @ T2)[:, None]]).ravel()))
    (drive / "calib.txt").write_text(f"P2: {p2}\n")
    small, far = [10.0, 100.0, 60.0, 124.9], (9.0, 1.6, 40.0)
    kinds = ("Car", "Van", "Car")
    lines = [label(9, "Pedestrian", far, 0.0, BOXES[0])]
    lines += [label(i, kinds[i], PLACES[i], YAWS[i], BOXES[i], i, 0.1 * i) for i in range(3)]
    lines += [
        label(3, "Car", far, 0.0, small),
        label(4, "Car", far, 0.0, BOXES[0], occlusion=3),
        label(5, "Car", far, 0.0, BOXES[0], truncation=0.51),
        label(6, "Car", far, 0.0, BOXES[0]),
    ]
    (drive / "label_02.txt").write_text("".join(lines))
    clean = {f"{track} {kind}": [0] for track, kind in ((0, "Car"), (1, "Van"), (2, "Car"), (3, "Car"), (4, "Car"))}
    (drive / "clean_tracks.json").write_text(json.dumps(clean | {"5 Car": [0], "6 Car": [1]}))
    return drive


def score_drives(drives, setups, scene=None, rivals=(), **named):
    """The boxes of all frames, and what methods of these names make of their keypoints."""
    others = partial(ScoredRivals, scene, tuple(rivals)) if rivals else None
    return [box for frame in score_frames(drives, setups, rivals=others, **named) for box in frame.boxes]


@pytest.fixture
def setup(scene):
    return Setup(ExactDetector(), scene.prior, Ground.level(1.65), None, Options(box="off", keep_history=False))


def test_labels_count_that_are_large_visible_and_not_drawn_over(folder):
    (frame,) = read_drive(folder).frames
    assert wanted(frame).tolist() == [1, 2, 3]
    whole = replace(frame, usable=np.ones(8, dtype=bool))
    assert wanted(whole).tolist() == [1, 2, 3, 7]


def test_a_box_is_scored_in_the_labels_frame_on_the_full_circle(folder, setup, scene):
    seen = []
    (frame,) = score_frames(
        [read_drive(folder)],
        {"drive": setup},
        rivals=partial(ScoredRivals, scene, ("sqpnp_confident",)),
        advance=seen.append,
    )
    right, turned, refused = frame.boxes
    assert seen == ["drive"]
    assert [box.track for box in (right, turned, refused)] == [0, 1, 2]
    assert (turned.drive, turned.frame, turned.index, turned.kind) == ("drive", 0, 2, "Van")
    assert (turned.occlusion, turned.truncation, turned.height) == (1, 0.1, 180.0)
    assert turned.distance == pytest.approx(np.hypot(1.65, 12.0))
    assert [box.view for box in (right, turned, refused)] == [View.FRONT, View.REAR, View.SIDE]

    rivals = [box.outcomes["sqpnp_confident"] for box in (right, turned, refused)]
    assert [found.degrees for found in rivals] == pytest.approx([0.0, 180.0, 180.0], abs=1e-3)
    assert [found.metres for found in rivals] == pytest.approx([0.0, 0.5, np.inf], abs=1e-3)
    assert all(found.size is None and found.status is None for found in rivals)
    assert [found.failure is None for found in rivals] == [True, True, False]

    found = [box.outcomes[SYSTEM] for box in (right, turned, refused)]
    assert [one.degrees for one in found] == pytest.approx([0.0, 180.0, 180.0], abs=1.0)
    assert [one.metres for one in found] == pytest.approx([0.0, 0.5, np.inf], abs=0.1)
    assert [one.status for one in found] == ["converged", "converged", None]
    assert found[2].failure
    mean = np.ptp(load_prior("car14").surface.mean, axis=0)[[0, 2, 1]]
    assert found[0].size == pytest.approx(mean - SIZE, abs=0.15)  # signed: the mean car is not the labelled one
    assert np.abs(mean - SIZE).min() > 0.0

    assert [box.facing for box in (right, turned)] == pytest.approx([1.0, 0.0], abs=1e-6)
    assert refused.facing == pytest.approx(1.0, abs=1e-6)


def test_rows_are_plain_and_one_for_each_method(folder, setup, scene):
    boxes = score_drives([read_drive(folder)], {"drive": setup}, scene, rivals=["sqpnp_confident"])
    rows = [row for box in boxes for row in box.rows()]
    assert [row["method"] for row in rows] == [SYSTEM, "sqpnp_confident"] * 3
    assert len({tuple(row) for row in rows}) == 1
    json.dumps(rows, allow_nan=False)
    assert rows[4]["metres"] is None
    assert rows[4]["degrees"] == 180.0


def test_processes_change_nothing(folder, setup, scene):
    drives = [read_drive(folder)]
    alone = score_drives(drives, {"drive": setup}, scene, rivals=["sqpnp_confident"])
    assert score_drives(drives, {"drive": setup}, scene, rivals=["sqpnp_confident"], jobs=2) == alone


@pytest.mark.filterwarnings("ignore::fgrecon.errors.ContradictoryInputWarning")
def test_each_drive_has_a_setup_of_its_own(folder, setup, scene):
    other = replace(read_drive(folder), name="other")
    refusing = replace(setup, detector=Refusing())
    boxes = score_drives([read_drive(folder), other], {"drive": setup, "other": refusing}, scene)
    assert [box.drive for box in boxes] == ["drive"] * 3 + ["other"] * 3
    assert [box.outcomes[SYSTEM].failure is None for box in boxes] == [True, True, False, False, False, False]
    assert [box.facing is None for box in boxes] == [False] * 3 + [True] * 3
    assert list(boxes[0].outcomes) == [SYSTEM]


class Refusing:
    """Sees two keypoints and no direction."""

    category = "car14"

    def __call__(self, image, boxes):
        pixels = np.vstack([[[10.0, 10.0], [20.0, 10.0]], np.full((12, 2), np.nan)])
        return [Observation(pixels, np.full(14, 0.9), box) for box in boxes]


def test_an_unknown_rival_is_refused(scene):
    with pytest.raises(InvalidInputError, match="method"):
        ScoredRivals(scene, ["nobody"])


def test_what_cannot_be_read_is_named(folder, setup, scene):
    (folder / "image_02" / "000000.png").write_bytes(b"text")
    with pytest.raises(InvalidInputError, match=r"000000\.png"):
        score_drives([read_drive(folder)], {"drive": setup}, scene)


@pytest.mark.parametrize(
    ("yaw", "azimuth", "view"),
    [(FRONT, 0.0, "front"), (REAR, np.pi, "rear"), (0.0, -np.pi / 2, "side"), (np.pi, np.pi / 2, "side")],
)
def test_the_direction_to_the_camera(yaw, azimuth, view):
    found = float(view_azimuth(yaw_rotation(yaw), np.array([0.0, 1.5, 9.0])))
    assert np.cos(found - azimuth) == pytest.approx(1.0)
    assert view_of(found) == view


@pytest.mark.parametrize("yaw", [-2.5, -0.3, 1.0, 3.0])
def test_the_direction_to_the_camera_is_the_poses(yaw):
    pose = pose_of(yaw, [5.0, 1.6, 8.0])
    x, _, z = -pose[:3, :3].T @ pose[:3, 3]
    assert view_azimuth(yaw_rotation(yaw), pose[:3, 3]) == pytest.approx(np.arctan2(z, x))


def test_views_are_parted_at_45_degrees():
    degrees = [0, 44, 46, 134, 136, 180, -44, -46, -134, -136, 350]
    views = [view_of(np.radians(value)).value for value in degrees]
    assert views == ["front"] * 2 + ["side"] * 2 + ["rear"] * 2 + ["front", "side", "side", "rear", "front"]


def test_the_probability_of_the_labelled_half():
    ahead = np.eye(36)[0]
    assert facing_probability(ahead, 0.0) == 1.0
    assert facing_probability(ahead, np.pi) == 0.0
    assert facing_probability(ahead, np.pi / 2) == pytest.approx(0.5)
    assert facing_probability(ahead, np.radians(92.5)) == pytest.approx(0.25)
    random = np.random.default_rng(0).dirichlet(np.ones(36))
    for azimuth in np.linspace(-4.0, 4.0, 9):
        halves = facing_probability(random, azimuth) + facing_probability(random, azimuth + np.pi)
        assert halves == pytest.approx(1.0)
