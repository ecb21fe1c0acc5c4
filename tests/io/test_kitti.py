"""KITTI's calibration files."""

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.kitti_calibration import read_calibration

P2 = "707.0493 0 604.0814 45.75831 0 707.0493 180.5066 -0.3454157 0 0 1 0.004981016"


def write(tmp_path, text):
    file = tmp_path / "calib.txt"
    file.write_text(text)
    return file


def test_the_colour_camera_and_its_offset(tmp_path):
    found = read_calibration(write(tmp_path, f"P0: 1 2\n\nP2: {P2}\nTr_velo_to_cam: 1 2 3\n"))
    assert found.camera.matrix.tolist() == [[707.0493, 0, 604.0814], [0, 707.0493, 180.5066], [0, 0, 1]]
    assert found.camera.image_size == (1224, 370)
    matrix = np.array(P2.split(), dtype=float).reshape(3, 4)
    point = np.array([1.0, 1.65, 12.0])
    projected = matrix @ [*point, 1.0]
    pixel = found.camera.project(point + found.label_offset)
    assert pixel == pytest.approx(projected[:2] / projected[2], abs=1e-9)


def test_another_projection(tmp_path):
    found = read_calibration(write(tmp_path, "P3: 700 0 600 0 0 700 180 0 0 0 1 0\n"), "P3")
    assert found.label_offset.tolist() == [0, 0, 0]
    assert found.camera.image_size is None


@pytest.mark.parametrize(
    "text",
    [
        "",
        f"P3: {P2}",
        "P2: 1 2 3",
        f"P2: {P2} 5",
        f"P2: {P2.replace('604.0814', 'nan')}",
        f"P2: {P2.replace('604.0814', 'many')}",
        f"P2: {P2.replace('707.0493', '0')}",
        f"P2: {P2}\nP2: {P2.replace('707.0493', '907.0493')}",
    ],
)
def test_a_bad_file_names_file_and_line(tmp_path, text):
    file = write(tmp_path, text)
    with pytest.raises(InvalidInputError) as error:
        read_calibration(file)
    assert error.value.field == f"{file}: P2"


def test_no_text(tmp_path):
    file = tmp_path / "calib.txt"
    with pytest.raises(InvalidInputError, match="No such file"):
        read_calibration(file)
    file.write_bytes(b"\xff\xfeP2")
    with pytest.raises(InvalidInputError, match=r"calib\.txt"):
        read_calibration(file)


@pytest.mark.data
def test_real_files(data):
    files = sorted((data / "kitti_object" / "training" / "calib").glob("*.txt"))[::500]
    assert len(files) > 10
    for file in files:
        assert read_calibration(file).camera.image_size is not None
        assert 0.05 < np.linalg.norm(read_calibration(file).label_offset) < 0.07
