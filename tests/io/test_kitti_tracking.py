"""KITTI's tracking files, read and written."""

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.kitti_files import format_tracking, read_tracking

CAR = "Car 0.00 1 1.5000 20.00 30.00 110.00 80.00 1.5000 1.6000 4.0000 0.5000 1.6000 15.0000 1.5000"


def test_labels_and_results_by_frame(tmp_path):
    path = tmp_path / "0000.txt"
    path.write_text(f"2 7 {CAR}\n\n2 -1 {CAR.replace('Car', 'Van')} 0.7500\n0 3 {CAR} 0.2500\n")
    found = read_tracking(path)
    assert sorted(found) == [0, 2]
    assert found[2].tracks.tolist() == [7, -1]
    assert found[2].objects.kind == ("Car", "Van")
    assert np.isnan(found[2].objects.score[0])
    assert found[2].objects.score[1] == 0.75
    text = format_tracking(found)
    assert text.splitlines()[0] == f"0 3 {CAR} 0.2500"
    path.write_text(text)
    again = read_tracking(path)
    assert again[2].objects.box.tolist() == found[2].objects.box.tolist()
    assert format_tracking(again) == text


@pytest.mark.parametrize("line", ["0 1", f"x 1 {CAR}", f"0 1 {CAR} 1 2", f"0 1 {CAR} none"])
def test_a_bad_line_is_named(tmp_path, line):
    path = tmp_path / "0000.txt"
    path.write_text(f"0 1 {CAR}\n{line}\n")
    with pytest.raises(InvalidInputError, match=r"0000\.txt:2"):
        read_tracking(path)
    with pytest.raises(InvalidInputError, match="labels"):
        read_tracking(tmp_path / "none.txt")
