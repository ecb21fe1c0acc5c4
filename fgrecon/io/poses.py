"""Poses of a moving camera from files of other programs.

| format | content |
|---|---|
| KITTI | a line a frame, from frame 0: twelve numbers, the upper rows of world_T_camera |
| TUM | a line a pose: seconds, tx, ty, tz, qx, qy, qz, qw; `#` begins a comment. Between two poses it is interpolated |
| JSON | a list of matrices (4 x 4), from frame 0; or an object of them by the frame's number |

The camera's frame is OpenCV's: x right, y down, z forward.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.checks import as_finite, as_rigid
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import rigid
from fgrecon.io.files import filled_lines
from fgrecon.io.json_fields import numbers, read_json

_FIX = "Give lines of 12 numbers (KITTI) or of 8 (TUM), or JSON with matrices 4 x 4."
_KITTI, _TUM = 12, 8
_DIGITS = 19  # of a number that 64 bits hold
_LONGEST_GAP = 1.0  # seconds between which poses are interpolated
_RIGID = 1e-2  # by so much a rotation may fail to be one


@dataclass(frozen=True, eq=False)
class CameraPoses:
    """The poses of a camera in a world.

    Attributes:
        by_frame: (4, 4) world_T_camera by the number of the frame; empty where the file tells times.
        times: Seconds of each pose, growing; empty where it tells frames.
        poses: (4, 4) of each time.
    """

    by_frame: Mapping[int, Array]
    times: tuple[float, ...] = ()
    poses: tuple[Array, ...] = ()

    def __bool__(self) -> bool:
        """Whether there is a pose."""
        return bool(self.times or self.by_frame)

    @property
    def span(self) -> str:
        """The frames, or the seconds, that the poses are of; there must be one."""
        if self.times:
            return f"{self.times[0]:.10g} to {self.times[-1]:.10g} s"
        return f"frames {min(self.by_frame)} to {max(self.by_frame)}"

    def at(self, number: int, time: float) -> Array | None:
        """(4, 4) world_T_camera of a frame; None where the file has none for it.

        Args:
            number: Of the frame.
            time: Its time, seconds.
        """
        if not self.times:
            return self.by_frame.get(number)
        place = bisect_left(self.times, time)
        if place < len(self.times) and abs(self.times[place] - time) < 1e-6:
            return self.poses[place]
        if place in (0, len(self.times)) or self.times[place] - self.times[place - 1] > _LONGEST_GAP:
            return None
        return _between(time, self.times[place - 1 : place + 1], self.poses[place - 1 : place + 1])


def read_poses(path: Path) -> CameraPoses:
    """Read the poses of a file.

    Raises:
        InvalidInputError: The file cannot be read, or a pose is none; names file and line or element.
    """
    if path.suffix.lower() == ".json":
        return _of_json(path)
    by_frame: dict[int, Array] = {}
    timed: dict[float, Array] = {}
    for place, line in filled_lines(path, "poses", _FIX):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            values = np.array(words, dtype=np.float64)
        except ValueError as error:
            raise InvalidInputError(place, line, _FIX) from error
        as_finite(place, values, (None,))
        if len(values) == _KITTI and not timed:
            by_frame[len(by_frame)] = _checked(np.vstack([values.reshape(3, 4), [0, 0, 0, 1]]), place)
        elif len(values) == _TUM and not by_frame:
            timed[float(values[0])] = _checked(_of_quaternion(values[1:4], values[4:], place), place)
        else:
            raise InvalidInputError(place, f"{len(values)} numbers", _FIX)
    if not by_frame and not timed:
        raise InvalidInputError("poses", str(path), _FIX)
    times = sorted(timed)
    return CameraPoses(by_frame, tuple(times), tuple(timed[time] for time in times))


def read_pose(path: Path, field: str = "lidar_pose", motion: str = "from the LiDAR's frame to the camera's") -> Array:
    """(4, 4) the one motion of a file: 12 numbers [R | t], or JSON with a matrix, by itself or in a list.

    Args:
        motion: What it says has to be given.

    Raises:
        InvalidInputError: The file cannot be read, or has another number of motions.
    """
    poses = read_poses(path)
    if list(poses.by_frame) != [0]:
        fix = f"Give one motion {motion}: twelve numbers [R | t], or JSON with a matrix."
        raise InvalidInputError(field, str(path), fix)
    return poses.by_frame[0]


def _of_json(path: Path) -> CameraPoses:
    data = read_json(path)
    if isinstance(data, list) and data and all(isinstance(row, list) and _is_flat(row) for row in data):
        data = [data]  # a matrix by itself
    items: Any = data.items() if isinstance(data, Mapping) else enumerate(data) if isinstance(data, list) else ()
    found: dict[int, Array] = {}
    for key, value in items:
        if not str(key).isdecimal() or len(str(key)) > _DIGITS:
            raise InvalidInputError(f"{path}: {key}", key, "Let the number of a frame be the name of its pose.")
        if value is not None:
            found[int(key)] = _checked(numbers(value, (4, 4), f"{path}: [{key}]"), f"{path}: [{key}]")
    if not found:
        raise InvalidInputError("poses", str(path), _FIX)
    return CameraPoses(found)


def _is_flat(row: list[Any]) -> bool:
    return not any(isinstance(one, list) for one in row)


def _checked(pose: Array, place: str) -> Array:
    """The pose, its rotation made an exact one."""
    exact = as_rigid(place, pose, _RIGID).copy()
    left, _, right = np.linalg.svd(exact[:3, :3])
    exact[:3, :3] = left @ right
    return exact


def _of_quaternion(place: Array, quaternion: Array, where: str) -> Array:
    from scipy.spatial.transform import Rotation

    if np.linalg.norm(quaternion) < 1e-6:
        raise InvalidInputError(where, quaternion.tolist(), "Give a quaternion qx, qy, qz, qw.")
    return rigid(Rotation.from_quat(quaternion).as_matrix(), place)


def _between(time: float, times: tuple[float, ...], poses: tuple[Array, ...]) -> Array:
    """The pose at a time between two."""
    from scipy.spatial.transform import Rotation

    share = (time - times[0]) / (times[1] - times[0])
    first, second = poses
    turn = Rotation.from_matrix(first[:3, :3])
    rest = (turn.inv() * Rotation.from_matrix(second[:3, :3])).as_rotvec()
    place = (1.0 - share) * first[:3, 3] + share * second[:3, 3]
    return rigid((turn * Rotation.from_rotvec(share * rest)).as_matrix(), place)
