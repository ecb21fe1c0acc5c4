"""Poses of moving cameras in the formats of others."""

import json

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.poses import read_pose, read_poses

TURN = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # 90 degrees about y


def pose(turn, place):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn, place
    return matrix


def test_kittis_lines_are_frames(tmp_path):
    path = tmp_path / "00.txt"
    poses = [pose(np.eye(3), [0, 0, 0]), pose(TURN, [1, 2, 3])]
    path.write_text("".join(" ".join(f"{v:.6e}" for v in p[:3].ravel()) + "\n" for p in poses))
    found = read_poses(path)
    assert found.at(1, 99.0) == pytest.approx(poses[1], abs=1e-6)
    assert found.at(2, 0.0) is None


def test_tums_poses_are_interpolated(tmp_path):
    path = tmp_path / "tum.txt"
    half = np.sqrt(0.5)
    path.write_text(f"# time x y z q\n10.0 0 0 0 0 0 0 1\n10.5 1 0 2 0 {half} 0 {half}\n20 0 0 0 0 0 0 1\n")
    found = read_poses(path)
    assert found.at(7, 10.5) == pytest.approx(pose(TURN, [1, 0, 2]), abs=1e-9)
    between = found.at(0, 10.25)
    assert between[:3, 3] == pytest.approx([0.5, 0, 1.0])
    assert np.degrees(np.arctan2(between[0, 2], between[0, 0])) == pytest.approx(45.0)
    assert found.at(0, 9.0) is None
    assert found.at(0, 15.0) is None


def test_json(tmp_path):
    path = tmp_path / "poses.json"
    path.write_text(json.dumps([np.eye(4).tolist(), None, pose(TURN, [1, 2, 3]).tolist()]))
    assert read_poses(path).at(1, 0.0) is None
    assert read_poses(path).at(2, 0.0)[:3, 3] == pytest.approx([1, 2, 3])
    path.write_text(json.dumps({"12": np.eye(4).tolist()}))
    assert read_poses(path).at(12, 0.0) == pytest.approx(np.eye(4))
    path.write_text(json.dumps(pose(TURN, [1, 2, 3]).tolist()))
    assert read_pose(path)[:3, 3] == pytest.approx([1, 2, 3])


@pytest.mark.parametrize(
    ("name", "text", "field"),
    [
        ("a.txt", "1 2 3\n", r"a\.txt:1"),
        ("a.txt", "0 0 0 0 0 0 0 0\n", r"a\.txt:1"),
        ("a.txt", "2 0 0 0 0 2 0 0 0 0 2 0\n", r"a\.txt:1"),
        ("a.txt", "0 0 0 0 0 0 0 1\n1 0 0 0 0 1 0 0 0 0 1 0\n", r"a\.txt:2"),
        ("a.txt", "0 0 0 0 0 0 0 1\nnan 0 0 0 0 0 0 1\n", r"a\.txt:2\[0\]"),
        ("a.txt", "0 0 0 0 nan 0 0 1\n", r"a\.txt:1\[4\]"),
        ("a.json", f'{{"{"9" * 5000}": 1}}', r"a\.json: 999"),
        ("a.txt", "x\n", r"a\.txt:1"),
        ("a.txt", "# nothing\n", "poses"),
        ("a.json", "[[1, 2]]", r"a\.json"),
        ("a.json", "{}", "poses"),
        ("a.json", '{"x": 1}', r"a\.json: x"),
    ],
)
def test_what_is_no_pose_is_named(tmp_path, name, text, field):
    (tmp_path / name).write_text(text)
    with pytest.raises(InvalidInputError, match=field):
        read_poses(tmp_path / name)
    with pytest.raises(InvalidInputError, match="poses"):
        read_poses(tmp_path / "none.txt")
