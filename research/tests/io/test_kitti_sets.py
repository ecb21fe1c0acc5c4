"""KITTI's files: what is written is read back, and every defect is named and counted."""

import numpy as np
import pytest

from fgrecon.core.choices import BoxModel
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.kitti_files import Objects, format_results, parse_detection
from fgrecon_research.io.kitti_sets import (
    Defect,
    count_defects,
    parse_objects,
    read_detections,
    read_image_set,
    read_labels,
    stated_model,
    write_results,
)

CAR = "Car 0.12 1 -1.57 100.00 120.00 180.00 170.00 1.50 1.60 3.90 -2.00 1.65 14.00 -1.7000"
AREA = "DontCare -1 -1 -10 503.89 169.71 590.61 190.13 -1 -1 -1 -1000 -1000 -1000 -10"


def test_a_label_line_is_read_column_by_column():
    objects, problems = parse_objects(f"{CAR}\n\n{AREA}\n", "a.txt")
    assert problems == []
    assert objects.kind == ("Car", "DontCare")
    assert objects.truncation.tolist() == [0.12, -1.0]
    assert objects.occlusion.tolist() == [1, -1]
    assert objects.alpha.tolist() == [-1.57, -10.0]
    assert objects.box[0].tolist() == [100.0, 120.0, 180.0, 170.0]
    assert objects.size[0].tolist() == [3.9, 1.6, 1.5]  # length, width, height
    assert objects.location[0].tolist() == [-2.0, 1.65, 14.0]
    assert objects.rotation_y[0] == -1.7
    assert np.isnan(objects.score).all()


def test_each_defect_of_a_file_is_a_problem_and_the_other_lines_are_kept():
    text = f"{CAR}\n{CAR} 0.5\n{CAR.replace('14.00', 'far')}\n{CAR.replace('14.00', 'nan')}\n{AREA}\n"
    objects, problems = parse_objects(text, "a.txt")
    assert objects.kind == ("Car", "DontCare")
    assert [problem.place for problem in problems] == ["a.txt:2", "a.txt:3", "a.txt:4"]
    assert "16 columns instead of 15" in problems[0].detail
    assert "far" in problems[1].detail
    assert "not finite" in problems[2].detail
    assert count_defects(problems) == {"malformed line": 3}


@pytest.mark.parametrize("text", ["", "\n \n"])
def test_a_file_without_lines_is_a_problem(text):
    objects, problems = parse_objects(text, "a.txt")
    assert len(objects) == 0
    assert objects.box.shape == (0, 4)
    assert count_defects(problems) == {"empty file": 1}


def test_results_written_are_read_back(tmp_path):
    objects, _ = parse_objects(f"{CAR} 0.8765\n{CAR.replace('Car', 'Van')} -1.25\n", "a", scored=True)
    write_results(tmp_path, {"000001": objects, "000002": objects.take(np.array([False, False]))})
    lines = (tmp_path / "000001.txt").read_text().splitlines()
    assert [len(line.split()) for line in lines] == [16, 16]
    back, problems = read_labels(tmp_path, ["000001", "000002"], scored=True)
    assert count_defects(problems) == {"empty file": 1}
    assert back["000001"].kind == ("Car", "Van")
    for name in ("truncation", "occlusion", "alpha", "box", "size", "location", "rotation_y", "score"):
        np.testing.assert_array_equal(getattr(back["000001"], name), getattr(objects, name))


def test_what_a_detector_does_not_know_has_kittis_marks():
    line = format_results(Objects.detections(["Car"], np.array([[1.0, 2.0, 30.0, 40.0]]), np.array([0.5])))
    words = line.split()
    assert words[:4] == ["Car", "-1", "-1", "-10.0000"]
    assert [float(word) for word in words[8:]] == [-1, -1, -1, -1000, -1000, -1000, -10, 0.5]


def test_missing_empty_and_unreadable_label_files_are_named(tmp_path):
    (tmp_path / "000001.txt").write_text(f"{CAR}\n")
    (tmp_path / "000002.txt").write_text("")
    (tmp_path / "000003.txt").write_bytes(b"\xff\xfe\x00")
    labels, problems = read_labels(tmp_path, ["000001", "000002", "000003", "000004"])
    assert sorted(labels) == ["000001", "000002"]
    assert len(labels["000002"]) == 0
    assert count_defects(problems) == {"missing frame": 1, "empty file": 1, "unreadable file": 1}
    assert {p.defect: p.place for p in problems}[Defect.MISSING_FRAME] == "000004"
    assert "000003.txt" in {p.defect: str(p) for p in problems}[Defect.UNREADABLE_FILE]


def test_labels_are_no_results(tmp_path):
    (tmp_path / "000001.txt").write_text(f"{CAR}\n")
    assert count_defects(read_labels(tmp_path, ["000001"], scored=True)[1]) == {"malformed line": 1}


def test_a_missing_folder_is_refused(tmp_path):
    with pytest.raises(InvalidInputError, match="absent"):
        read_labels(tmp_path / "absent", ["000001"])


def test_detections_by_frame_with_defects(tmp_path):
    path = tmp_path / "detections.txt"
    path.write_text(
        "x/000001.png 2 0.9 10 20 110 90\nx/000001.png 1 0.4 10 20 30 90\nx/000007.png 2 0.9 10 20 110 90\n"
        "x/000001.png 4 0.4 10 20 30 90\nx/000001.png 2 0.4 10 20 30\nx/000001.png 2 inf 1 2 3 4\n"
    )
    found, problems = read_detections(path, ["000001", "000002"])
    assert found["000001"].kind == ("Car", "Pedestrian")
    assert found["000001"].score.tolist() == [0.9, 0.4]
    assert found["000001"].box[0].tolist() == [10, 20, 110, 90]
    assert len(found["000002"]) == 0
    assert count_defects(problems) == {"missing frame": 1, "unknown frame": 1, "malformed line": 3}


def test_what_detected_boxes_enclose_stands_in_their_lines(tmp_path):
    path = tmp_path / "detections.txt"
    line = "x/my street.png 2 0.9 10 20 110 90"
    assert parse_detection(line)._replace(model=BoxModel.DETECTED) == parse_detection(f"{line} detected\n")
    for text, stated in [
        ("", None),
        (line, None),
        (f"{line} detected\n\nmalformed\n{line} detected", BoxModel.DETECTED),
    ]:
        path.write_text(text)
        assert stated_model(path) is stated
    path.write_text(f"{line} detected\n{line}\n{line} surface")
    with pytest.raises(InvalidInputError, match=r"detected, nothing, surface. Say it of all with --box-model"):
        stated_model(path)
    with pytest.raises(ValueError, match="is not"):
        parse_detection(f"{line} wide")


@pytest.mark.parametrize(("text", "match"), [("", "no frame"), ("000001\n000002\n000001\n", "000001")])
def test_image_sets_that_cannot_be_used_are_refused(tmp_path, text, match):
    path = tmp_path / "val.txt"
    path.write_text(text)
    with pytest.raises(InvalidInputError, match=match):
        read_image_set(path)


@pytest.mark.data
def test_the_real_validation_set_reads_without_a_defect_but_empty_frames(data):
    root = data / "kitti_object"
    frames = read_image_set(root / "ImageSets" / "val.txt")
    labels, problems = read_labels(root / "training" / "label_2", frames)
    detections, without = read_detections(root / "detections_2d" / "rgb_detection_val.txt", frames)
    assert len(frames) == len(labels) == len(detections) == 3769
    assert problems == []
    assert set(count_defects(without)) <= {"missing frame"}
    assert sum(kind == "Car" for objects in labels.values() for kind in objects.kind) == 14385
