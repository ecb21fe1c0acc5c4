"""Frames of drives whose vehicles are detected: which label each is of, and how they are followed without ids."""

import json
import pickle
import shutil
from dataclasses import replace

import numpy as np
import pytest

from fgrecon.calibration.labelled_boxes import SYSTEM
from fgrecon.calibration.labelled_frames import frames_to_score, reconstruct_frame, score_frames
from fgrecon.io.kitti_files import read_drive
from fgrecon.perception.vehicles import Vehicles
from fgrecon_research.evaluation.video_tracks import BATCH, ONLINE, follow_boxes
from research.tests.evaluation.test_video_images import BOXES, folder, setup  # noqa: F401  # fixtures

NEAR_FIRST = BOXES[0] + [4.0, -3.0, 5.0, 2.0]
NOBODY = np.array([950.0, 100.0, 1100.0, 200.0])
TOO_SMALL = np.array([10.0, 10.0, 15.0, 17.0])


class Found:
    """Finds the first two cars, the second of them twice, what is no car, and what no network can vehicle into."""

    def __call__(self, image):
        boxes = np.array([NOBODY, BOXES[1] + [0.0, 8.0, 20.0, 0.0], NEAR_FIRST, BOXES[1], TOO_SMALL])
        return Vehicles(boxes, np.array([0.9, 0.8, 0.7, 0.6, 0.5]))


@pytest.fixture
def detecting(setup):  # noqa: F811
    return replace(setup, vehicles=Found(), together=False)


def test_a_label_has_the_box_that_overlaps_it_most(folder, detecting):  # noqa: F811
    (frame,) = read_drive(folder).frames
    _, vehicles = reconstruct_frame(replace(frame, usable=np.arange(8) < 4), detecting)
    assert [(vehicle.label, vehicle.score) for vehicle in vehicles] == [(1, 0.7), (2, 0.6), (None, 0.9), (None, 0.8)]
    np.testing.assert_array_equal(vehicles[0].found.detection.observation.box, NEAR_FIRST)
    hidden = replace(frame.objects, occlusion=np.full(8, 3.0))
    _, vehicles = reconstruct_frame(replace(frame, objects=hidden), detecting)
    assert [vehicle.label for vehicle in vehicles] == [None] * 4  # of cars that do not count: no other label has them


def test_labels_without_a_box_are_counted_and_not_scored(folder, detecting, scene):  # noqa: F811
    drive = read_drive(folder)
    (frame,) = score_frames([drive], {"drive": detecting}, jobs=2)
    assert [box.track for box in frame.boxes] == [0, 1]
    assert frame.missed == 1
    assert [one.identity for one in frame.sightings] == [0, 1, None, None]
    assert [one.score for one in frame.sightings] == [0.7, 0.6, 0.9, 0.8]


def test_frames_without_a_label_are_looked_at_where_vehicles_are_detected(folder, setup, detecting):  # noqa: F811
    shutil.copy(folder / "image_02" / "000000.png", folder / "image_02" / "000001.png")
    drive = read_drive(folder)
    assert [frame.number for frame in frames_to_score(drive, setup)] == [0]
    assert [frame.number for frame in frames_to_score(drive, detecting)] == [0, 1]


@pytest.mark.parametrize("detected", [False, True])
def test_vehicles_are_followed_without_ids(folder, setup, detecting, scene, detected):  # noqa: F811
    lines = (folder / "label_02.txt").read_text().splitlines()
    for number in (1, 2):
        shutil.copy(folder / "image_02" / "000000.png", folder / "image_02" / f"{number:06d}.png")
    (folder / "label_02.txt").write_text(
        "".join(f"{number} {line.split(maxsplit=1)[1]}\n" for number in (0, 1, 2) for line in lines)
    )
    clean = json.loads((folder / "clean_tracks.json").read_text())
    (folder / "clean_tracks.json").write_text(json.dumps({name: [0, 1, 2] for name in clean}))
    drives, setups = [read_drive(folder)], {"drive": detecting if detected else replace(setup, together=False)}
    frames = score_frames(drives, setups)
    boxes = follow_boxes(frames, drives, setups, forget_ids=True)
    known = follow_boxes(frames, drives, setups) if not detected else boxes
    for box, other in zip(boxes, known, strict=True):
        if box.track == 2:  # two points alone: nobody has an estimate
            assert box.outcomes[ONLINE].failure == "no estimate"
            continue
        for method in (ONLINE, BATCH):
            assert box.outcomes[method].degrees == pytest.approx(other.outcomes[method].degrees)
            assert box.outcomes[method].degrees == pytest.approx(box.outcomes[SYSTEM].degrees, abs=1.5)
            assert box.outcomes[method].metres == pytest.approx(box.outcomes[SYSTEM].metres, abs=0.2)
    assert {box.frame for box in boxes} == {0, 1, 2}


def test_a_detector_can_be_given_to_another_process():
    pytest.importorskip("cv2")
    from fgrecon.perception.vehicles import NanodetVehicleDetector

    image = np.random.default_rng(0).integers(0, 255, (120, 240, 3)).astype(np.uint8)
    detector = NanodetVehicleDetector()
    copy = pickle.loads(pickle.dumps(detector))
    np.testing.assert_array_equal(copy(image, least_score=0.01).boxes, detector(image, least_score=0.01).boxes)
