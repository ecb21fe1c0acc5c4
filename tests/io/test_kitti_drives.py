"""Drives and folders of single images, read with every fault named."""

import json

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.kitti_files import read_drive, read_images, read_object_folder

P2 = "P2: 721.5377 0 609.5593 44.85728 0 721.5377 172.854 0.2163791 0 0 1 0.002745884\n"
CAR = "Car 0.00 1 1.5 20.0 30.0 110.0 80.0 1.5 1.6 4.0 0.5 1.6 15.0 1.5"
UNKNOWN = "Van -1 -1 -10 20.0 30.0 110.0 80.0 -1 -1 -1 -1000 -1000 -1000 -10"


@pytest.fixture
def drive(tmp_path):
    folder = tmp_path / "drive"
    (folder / "image_02").mkdir(parents=True)
    for name in ("000002.png", "000000.jpg", "000003.jpg"):
        (folder / "image_02" / name).write_bytes(b"")
    (folder / "calib.txt").write_text(P2)
    (folder / "label_02.txt").write_text(f"0 7 {CAR}\n\n2 7 {CAR}\n2 9 {UNKNOWN}\n5 1 {CAR}\n")
    return folder


@pytest.fixture
def single(tmp_path):
    folder = tmp_path / "training"
    for name in ("image_2", "label_2", "calib"):
        (folder / name).mkdir(parents=True)
    for stem, lines in (("000004", [CAR, UNKNOWN]), ("000010", []), ("000012", [CAR])):
        (folder / "image_2" / f"{stem}.png").write_bytes(b"")
        (folder / "label_2" / f"{stem}.txt").write_text("".join(f"{line}\n" for line in lines))
        (folder / "calib" / f"{stem}.txt").write_text(P2)
    return folder


def test_a_drive(drive):
    found = read_drive(drive)
    assert found.name == "drive"
    assert [(f.number, f.image.name) for f in found.frames] == [
        *((0, "000000.jpg"), (2, "000002.png"), (3, "000003.jpg"))
    ]
    assert [f.tracks.tolist() for f in found.frames] == [[7], [7, 9], []]
    assert found.frames[1].objects.kind == ("Car", "Van")
    assert found.frames[0].objects.size.tolist() == [[4.0, 1.6, 1.5]]
    assert found.frames[1].boxed.tolist() == [True, False]
    assert all(f.labelled for f in found.frames)
    assert all(f.usable.all() for f in found.frames)
    assert found.calibration.label_offset[0] == pytest.approx(0.0598, abs=1e-3)
    assert found.calibration is found.frames[0].calibration


def test_a_box_behind_the_camera_is_none(drive):
    (drive / "label_02.txt").write_text(f"0 1 {CAR.replace(' 15.0 ', ' -15.0 ')}\n")
    assert read_drive(drive).frames[0].boxed.tolist() == [False]


def test_frames_that_can_be_used_and_frames_that_are_labelled(drive):
    (drive / "clean_tracks.json").write_text(json.dumps({"7 Car": [2]}))
    (drive / "object_frames.json").write_text(json.dumps({"0": "000123", "2": "000124"}))
    found = read_drive(drive)
    assert [f.usable.tolist() for f in found.frames] == [[False], [True, False], []]
    assert [f.labelled for f in found.frames] == [True, True, False]


def test_single_images_have_a_track_for_each_object(single):
    found = read_object_folder(single)
    assert [f.number for f in found.frames] == [4, 10, 12]
    assert [f.tracks.tolist() for f in found.frames] == [[0, 1], [], [2]]
    assert found.frames[0].boxed.tolist() == [True, False]
    assert found.frames[0].objects.location.tolist()[0] == [0.5, 1.6, 15.0]


def test_the_layout_is_found(drive, single, tmp_path):
    assert read_images(drive).frames[1].tracks.tolist() == [7, 9]
    assert read_images(single).frames[2].tracks.tolist() == [2]
    with pytest.raises(InvalidInputError, match=r"label_02\.txt"):
        read_images(tmp_path)


@pytest.mark.parametrize("line", ["x 7 " + CAR, "0 seven " + CAR, "0 7", f"0 7 {CAR} 9", f"0 7 {CAR[:-3]}nan"])
def test_a_malformed_line_names_file_and_line(drive, single, line):
    path = drive / "label_02.txt"
    path.write_text(f"0 7 {CAR}\n\n{line}\n")
    with pytest.raises(InvalidInputError) as error:
        read_drive(drive)
    assert error.value.field == f"{path}:3"
    path = single / "label_2" / "000004.txt"
    path.write_text(f"{CAR}\n{line}\n")
    with pytest.raises(InvalidInputError) as error:
        read_object_folder(single)
    assert error.value.field == f"{path}:2"


def test_missing_files_are_named(drive, single):
    (single / "calib" / "000010.txt").unlink()
    with pytest.raises(InvalidInputError, match=r"000010\.txt"):
        read_object_folder(single)
    (single / "label_2" / "000004.txt").unlink()
    with pytest.raises(InvalidInputError, match=r"000004\.txt"):
        read_object_folder(single)
    (drive / "label_02.txt").write_bytes(b"\xff\xfe")
    with pytest.raises(InvalidInputError, match=r"label_02\.txt"):
        read_drive(drive)


@pytest.mark.parametrize(
    ("name", "match"), [("first.png", "frame's number"), ("0000.png", "twice")], ids=["no number", "twice"]
)
def test_images_that_are_no_frames_are_named(drive, name, match):
    (drive / "image_02" / name).write_bytes(b"")
    with pytest.raises(InvalidInputError, match=match):
        read_drive(drive)


def test_a_folder_without_images_is_refused(drive):
    for path in (drive / "image_02").iterdir():
        path.unlink()
    with pytest.raises(InvalidInputError, match="image_02"):
        read_drive(drive)


def test_a_list_where_an_object_should_be(drive):
    (drive / "clean_tracks.json").write_text("[1]")
    with pytest.raises(InvalidInputError, match=r"clean_tracks\.json"):
        read_drive(drive)


@pytest.mark.data
def test_real_drives(data):
    drives = {folder.name: read_drive(folder) for folder in sorted((data / "kitti_video").iterdir())}
    assert {name: len(drive.frames) for name, drive in drives.items()}["drive_0095"] == 134
    assert not drives["drive_0095"].frames[0].labelled
    for drive in drives.values():
        assert np.linalg.norm(drive.calibration.label_offset) < 0.5  # the right camera is 47 cm away
        for frame in drive.frames:
            assert frame.labelled or not len(frame.objects)
            cars = np.array([kind == "Car" for kind in frame.objects.kind], dtype=bool)
            assert frame.boxed[cars].mean() > 0.5 if cars.any() else True
