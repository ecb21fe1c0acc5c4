"""Vehicles that others have found: boxes and keypoints, with ids and without; and records as they are stored."""

import json

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.evidence import VehicleClass
from fgrecon.io.catalogue import load_category
from fgrecon.io.images import write_png
from fgrecon.video import open_frames, read_given
from fgrecon.video.egomotion import CameraMotion
from fgrecon.video.records import (
    FrameRecord,
    Sighting,
    from_row,
    motion_from_row,
    motion_schema,
    motion_to_table,
    record_schema,
    to_table,
)
from tests.made_up_track import make_track
from tests.video.streets import instance, simulated

CAR14 = load_category("car14")
CAR = "Car 0.00 1 1.5 20.0 30.0 110.0 80.0 1.5 1.6 4.0 0.5 1.6 15.0 1.5"


def test_kittis_labels_are_boxes(tmp_path):
    path = tmp_path / "label_02.txt"
    path.write_text(f"2 7 {CAR}\n2 -1 {CAR.replace('Car', 'Van')} 0.75\n2 -1 {CAR.replace('Car', 'DontCare')}\n")
    given = read_given(path, CAR14)
    known, unknown = given.vehicles[2]
    assert (known.identity, known.score, known.observation) == (7, 1.0, None)
    assert (unknown.identity, unknown.score) == (None, 0.75)
    assert (known.kind, unknown.kind) == ("Car", "Van")
    assert known.box.tolist() == [20.0, 30.0, 110.0, 80.0]
    assert (given.cuboids, given.complete, given.largest_id) == (True, False, 7)
    assert given.ends == {7: 2}
    path.write_text(path.read_text() + f"2 8 {CAR.replace('Car', 'Truck')}\n2 9 {CAR.replace('Car', 'Person')}\n")
    assert read_given(path, CAR14).left_out == {"Truck": 1, "Person": 1}
    every = read_given(path, CAR14, all_classes=True)
    assert [(s.kind, *s.vehicle_class.probabilities) for s in every.vehicles[2]] == [
        ("Car", "car"),
        ("Van", "van"),
        ("Truck", "truck"),
    ]
    forgotten = read_given(path, CAR14, forget_ids=True)
    assert forgotten.ends == {}
    assert [s.identity for s in forgotten.vehicles[2]] == [None, None]
    assert forgotten.largest_id == -1


def test_keypoints_name_their_frames(tmp_path):
    (seen,) = (car[0] for car in simulated(1, seeds=(3,)))
    named = instance(seen, 12, 4) | {"kind": "Van"}
    bare = {key: value for key, value in named.items() if key not in ("frame", "track", "box", "kind")}
    bare |= {"id": "x", "image": "drive/left_000013.png"}
    path = tmp_path / "keypoints.json"
    path.write_text(json.dumps({"intrinsics": [700, 700, 600, 180], "instances": [named, bare]}))
    given = read_given(path, CAR14)
    assert (given.vehicles[12][0].identity, given.vehicles[12][0].kind) == (4, "Van")
    assert given.vehicles[12][0].observation.keypoints == pytest.approx(seen.keypoints, nan_ok=True)
    around = given.vehicles[13][0]
    points = seen.keypoints[seen.measured]
    assert around.identity is None
    assert around.box == pytest.approx([*points.min(axis=0), *points.max(axis=0)])
    assert around.observation.box is None
    assert given.camera.matrix[0, 0] == 700.0
    assert given.complete


def test_a_track_file_is_one_vehicle(tmp_path, scene):
    path = tmp_path / "TRACK.json"
    path.write_text(json.dumps(make_track(scene.prior, [0.3, 1.9])))
    given = read_given(path, CAR14)
    assert {s.identity for sightings in given.vehicles.values() for s in sightings} == {0}
    assert len(given.vehicles) == 2
    assert given.camera is not None


NUSCENES = "n015-2018-07-24-11-22-45+0800__CAM_FRONT__{}.jpg"


def keypoints(tmp_path, images):
    """A keypoint file whose instances name images."""
    (seen,) = (car[0] for car in simulated(1, seeds=(3,)))
    bare = {key: value for key, value in instance(seen, 0, 0).items() if key not in ("id", "frame", "track")}
    path = tmp_path / "keypoints.json"
    path.write_text(json.dumps([bare | {"image": image} for image in images]))
    return path


def test_images_that_are_named_by_times_are_in_order(tmp_path):
    stamps = (1532402927695460, 1532402927612460, 1532402927695460)
    given = read_given(keypoints(tmp_path, map(NUSCENES.format, stamps)), CAR14)
    assert {number: len(seen) for number, seen in given.vehicles.items()} == {0: 1, 1: 2}
    assert given.times == pytest.approx({0: 1532402927.61246, 1: 1532402927.69546}, abs=1e-6)


def test_images_are_found_among_the_frames(tmp_path):
    """By their names, where those tell no numbers; what is none of them is left out."""
    names = ["a/1532402927612460.png", "a/1532402927695460.png", "a/1532402927778460.png"]
    (tmp_path / "a").mkdir()
    for name in names:
        (tmp_path / name).touch()
    given = read_given(
        keypoints(tmp_path, ["/data/a/1532402927695460.jpg", "1532402927778460", "1532402927999999"]),
        CAR14,
        source=open_frames(tmp_path / "a"),
    )
    assert (sorted(given.vehicles), given.times) == ([1, 2], None)
    with pytest.raises(InvalidInputError, match=r"such as 1532402927612460\.png"):
        read_given(keypoints(tmp_path, ["0"]), CAR14, source=open_frames(tmp_path / "a"))
    for camera in ("left", "right"):
        (tmp_path / "b" / camera).mkdir(parents=True)
        (tmp_path / "b" / camera / "0.png").touch()
    source = open_frames(str(tmp_path / "b" / "*" / "*.png"))
    assert list(read_given(keypoints(tmp_path, ["right/0.png"]), CAR14, source=source).vehicles) == [1]


def test_numbered_images_are_known_by_their_numbers(tmp_path):
    (tmp_path / "a").mkdir()
    for number in (3, 4):
        (tmp_path / "a" / f"left_{number}.png").touch()
    source = open_frames(tmp_path / "a")
    assert list(read_given(keypoints(tmp_path, ["right_000004.jpg"]), CAR14, source=source).vehicles) == [4]
    with pytest.raises(InvalidInputError, match="instance 1: frame"):
        read_given(keypoints(tmp_path, ["3.png", NUSCENES.format(1532402927695460)]), CAR14, source=source)


def test_the_track_minus_one_is_none(tmp_path):
    (seen,) = (car[0] for car in simulated(1, seeds=(3,)))
    path = tmp_path / "keypoints.json"
    path.write_text(json.dumps([instance(seen, 1, -1), instance(seen, 2, -1)]))
    given = read_given(path, CAR14)
    assert [given.vehicles[number][0].identity for number in (1, 2)] == [None, None]
    assert given.largest_id == -1


def test_frames_with_and_without_numbers_are_not_mixed(tmp_path):
    (seen,) = (car[0] for car in simulated(1, seeds=(3,)))
    path = tmp_path / "keypoints.json"
    timed = instance(seen, None, None) | {"id": "x", "image": NUSCENES.format(1532402927695460)}
    path.write_text(json.dumps([instance(seen, 1, 1), timed]))
    with pytest.raises(InvalidInputError, match="frame: got nothing"):
        read_given(path, CAR14)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"frame": None}, "frame"),
        ({"frame": "x"}, "frame"),
        ({"frame": 10**20}, "frame: got 1000"),
        ({"frame": -3}, "frame: got -3"),
        ({"track": 10**20}, "track: got 1000"),
        ({"track": 2**63 - 1}, "got track 9223372036854775807"),
        ({"track": -2}, "track: got -2"),
        ({"keypoints": [None] * 14}, "keypoints"),
        ({"confidence": [7.0] * 14}, "confidence"),
        ({"kind": "delivery van"}, "kind"),
    ],
)
def test_an_instance_that_cannot_be_used_is_named(tmp_path, change, match):
    (seen,) = (car[0] for car in simulated(1, seeds=(3,)))
    path = tmp_path / "keypoints.json"
    path.write_text(json.dumps([instance(seen, 1, 1) | change]))
    with pytest.raises(InvalidInputError, match=match):
        read_given(path, CAR14)


def test_an_id_twice_in_a_frame_is_refused_and_so_is_nothing(tmp_path):
    path = tmp_path / "label_02.txt"
    path.write_text(f"2 7 {CAR}\n2 7 {CAR}\n")
    with pytest.raises(InvalidInputError, match="frame 2: got track 7, twice"):
        read_given(path, CAR14)
    path.write_text(f"2 7 {CAR.replace('Car', 'Tram')}\n")
    with pytest.raises(InvalidInputError, match="tracks"):
        read_given(path, CAR14)


def test_records_are_stored_with_every_bit():
    rng = np.random.default_rng(1)
    (seen,) = (car[0] for car in simulated(1, seeds=(3,)))
    motion = CameraMotion(rng.normal(size=(4, 4)), rng.normal(size=(6, 6)), 77)
    known = VehicleClass({"car": 1.0 / 3.0, "van": 0.2}, "coco")
    sightings = Sighting(seen.box, 0.1, 5, seen, "Van", known), Sighting(np.arange(4.0), 1.0, None, None)
    record = FrameRecord(3, 0.1 + 0.2, "3.png", None, sightings, motion)
    (stored,) = to_table(record).cast(record_schema()).to_pylist()
    back = from_row(stored)
    assert (back.number, back.time, back.name, back.problem) == (3, 0.1 + 0.2, "3.png", None)
    (row,) = motion_to_table(record).cast(motion_schema()).to_pylist()
    moved = motion_from_row(row)
    assert (moved.previous_T_current == motion.previous_T_current).all()
    assert (moved.covariance == motion.covariance).all()
    assert moved.points == 77
    first, second = back.sightings
    assert (first.box == sightings[0].box).all()
    assert (first.identity, second.identity, second.observation) == (5, None, None)
    assert (first.kind, second.kind, second.vehicle_class) == ("Van", None, None)
    assert (first.vehicle_class.scheme, first.vehicle_class.probabilities) == (known.scheme, known.probabilities)
    older = [{name: value for name, value in one.items() if name != "classes"} for one in stored["sightings"]]
    assert [one.vehicle_class for one in from_row({**stored, "sightings": older}).sightings] == [None, None]
    for name in ("keypoints", "confidence", "covariance", "azimuth", "confidence_midpoint"):
        kept, given = getattr(first.observation, name), getattr(seen, name)
        assert (kept is None) == (given is None)
        if given is not None:
            assert np.array_equal(kept, given, equal_nan=True)
    gap = FrameRecord(4, 0.5, "4.png", "torn")
    (row,) = to_table(gap).to_pylist()
    assert from_row(row).problem == "torn"
    (row,) = motion_to_table(gap).to_pylist()
    assert motion_from_row(row) is None


def test_mots_lines_are_boxes(tmp_path):
    """Those of its images count from 1; a video's frames count from 0."""
    path = tmp_path / "mot.txt"
    path.write_text("1,7,10,20,30,40,0.9,-1,-1,-1\n\n2,-1,10.5,20,30,40,-1,-1,-1,-1\n")
    given = read_given(path, CAR14)
    first, second = given.vehicles[1][0], given.vehicles[2][0]
    assert (first.identity, first.score, first.box.tolist()) == (7, 0.9, [10, 20, 40, 60])
    assert (second.identity, second.score, given.cuboids) == (None, 1.0, False)
    (tmp_path / "street").mkdir()
    for name in ("car", "bus", "van"):
        write_png(tmp_path / "street" / f"{name}.png", np.zeros((8, 8, 3), np.uint8))
    assert set(read_given(path, CAR14, source=open_frames(tmp_path / "street")).vehicles) == {0, 1}
    path.write_text("1,7,10,20,30,40,1,3,0.8\n1,8,10,20,30,40,1,1,0.8\n1,9,10,20,30,40,0,3,0.8\n")
    assert [s.identity for s in read_given(path, CAR14).vehicles[1]] == [7]


@pytest.mark.parametrize("line", ["2,7,10,20,30", "2,7,10,20,30,x,1", "2,7.5,10,20,30,40,1", "2,7,10,20,0,40,1"])
def test_a_malformed_line_of_mot_is_named(tmp_path, line):
    path = tmp_path / "mot.txt"
    path.write_text(f"1,7,10,20,30,40,0.9\n{line}\n")
    with pytest.raises(InvalidInputError, match=r"mot\.txt:2: got "):
        read_given(path, CAR14)


def test_scores_of_keypoints_are_kept(tmp_path):
    (seen,) = (car[0] for car in simulated(1, seeds=(3,)))
    (path := tmp_path / "a.json").write_text(json.dumps([instance(seen, 3, 1) | {"score": 0.37}]))
    assert read_given(path, CAR14).vehicles[3][0].score == 0.37


def test_types_are_taken_in_any_letters_and_others_are_counted(tmp_path):
    path = tmp_path / "label_02.txt"
    kinds = ("car", "VAN", "Truck", "DontCare", "Tram", "Truck")
    path.write_text("".join(f"2 {i} {CAR.replace('Car', kind)}\n" for i, kind in enumerate(kinds)))
    given = read_given(path, CAR14)
    assert [(s.identity, s.kind) for s in given.vehicles[2]] == [(0, "Car"), (1, "Van")]
    assert given.left_out == {"Truck": 2, "Tram": 1}
    path.write_text(f"2 1 {CAR.replace('Car', 'Truck')}\n")
    with pytest.raises(InvalidInputError, match=r"with 1 Truck\. Give a file with a vehicle: Car or Van"):
        read_given(path, CAR14)
