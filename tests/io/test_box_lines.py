"""KITTI's lines of objects as 3D boxes: read, replaced, and everything else kept as it was written."""

import numpy as np
import pytest

from fgrecon.core.box3d import Box3D
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.box_lines import boxed_images, read_box_lines
from fgrecon.io.kitti_files import parse_object

CAR = "Car 0.00 0 -1.57 600.00 150.00 700.00 230.00 1.50 1.60 4.00 1.00 1.60 20.00 -1.52 0.91"
VAN = "Van -1 -1 -10 -1 -1 -1 -1 2.10 1.90 4.80 -3.00 1.70 30.00 0.10"
CARE = "DontCare -1 -1 -10 503.89 169.71 590.61 190.13 -1 -1 -1 -1000 -1000 -1000 -10"
OFFSET = np.array([0.06, 0.0, 0.003])


def write(path, *lines):
    path.write_text("\n".join(lines) + "\n")
    return path


def test_what_lines_say(tmp_path):
    car, empty, van, care = read_box_lines(write(tmp_path / "a.txt", CAR, "", VAN, CARE))
    assert (car.kind, car.score, car.frame, car.number) == ("Car", 0.91, None, 1)
    assert car.size.tolist() == [4.0, 1.6, 1.5]
    assert car.corners.tolist() == [600.0, 150.0, 700.0, 230.0]
    box = car.box(OFFSET)
    assert box.location == pytest.approx([1.06, 1.6, 20.003])
    assert (empty.kind, empty.box(OFFSET)) == ("", None)
    assert (van.score, van.number) == (1.0, 3)
    assert np.isnan(van.corners).all()
    assert van.box(OFFSET).rotation_y == 0.1
    assert care.box(OFFSET) is None


@pytest.mark.parametrize("front", ["", "7 3 "])
def test_a_line_with_another_box_keeps_all_else(tmp_path, front):
    (line,) = read_box_lines(write(tmp_path / "a.txt", front + CAR))
    assert line.frame == (7 if front else None)
    better = Box3D(np.array([1.56, 1.7, 22.003]), 1.2, np.array([4.2, 1.7, 1.4]))
    text = line.with_box(better, OFFSET)
    kind, numbers = parse_object(text.removeprefix(front), scored=True)
    assert (kind, numbers[0], numbers[3:7], numbers[14]) == ("Car", 0.0, [600.0, 150.0, 700.0, 230.0], 0.91)
    assert text.startswith(front)
    assert numbers[7:10] == [1.4, 1.7, 4.2]
    assert numbers[10:13] == pytest.approx([1.5, 1.7, 22.0])
    assert numbers[13] == 1.2
    assert numbers[2] == pytest.approx(1.2 - np.arctan2(1.5, 22.0), abs=1e-4)


def test_images_and_their_lines(tmp_path):
    boxes, images = tmp_path / "boxes", tmp_path / "images"
    boxes.mkdir()
    images.mkdir()
    for name in ("000001.png", "000003.jpg", "notes.md"):
        (images / name).write_bytes(b"")
    for name in ("000001", "000002"):
        write(boxes / f"{name}.txt", CAR, CARE)
    first, second = boxed_images(boxes, images)
    assert (first.name, first.image, len(first.objects)) == ("000001", images / "000001.png", 2)
    assert second.image is None
    (alone,) = boxed_images(boxes / "000001.txt", images / "000003.jpg")
    assert (alone.name, alone.source) == ("000003", boxes / "000001.txt")
    tracks = write(tmp_path / "tracks.txt", f"3 1 {CAR}", f"1 2 {VAN}", f"3 -1 {CARE}")
    one, three = boxed_images(tracks, images)
    assert (one.name, one.image) == ("000001", images / "000001.png")
    assert [line.number for line in three.objects] == [1, 3]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("Car 1 2 3", "a.txt:1"),
        (CAR.replace("20.00", "far"), "a.txt:1"),
        ("", "for each object"),
        (f"{CAR}\n3 1 {CAR}", "not of both"),
    ],
)
def test_what_is_none_is_refused(tmp_path, content, said):
    file = tmp_path / "a.txt"
    file.write_text(content)
    (tmp_path / "a.png").write_bytes(b"")
    with pytest.raises(InvalidInputError, match=said):
        boxed_images(file, tmp_path / "a.png")


def test_sources_that_do_not_go_together(tmp_path):
    file = write(tmp_path / "a.txt", CAR)
    with pytest.raises(InvalidInputError, match="images"):
        boxed_images(file, tmp_path)
    with pytest.raises(InvalidInputError, match="boxes"):
        boxed_images(tmp_path / "none.txt", tmp_path / "a.png")
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(InvalidInputError, match="text file for each image"):
        boxed_images(empty, tmp_path)
    with pytest.raises(InvalidInputError, match="images"):
        boxed_images(tmp_path, empty)
