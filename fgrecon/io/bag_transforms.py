"""Where the frames of a bag are to one another at any time: its TF tree, and odometry.

    map --- odom --- base_link --- camera --- camera_optical
             (moves)           (stands still)

A pose between two is interpolated, as tf2 does; there is none before the first and after the last.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import quaternion_pose
from fgrecon.io.bag import NANO
from fgrecon.io.poses import CameraPoses

_UNIT = 1e-2  # by so much the length of a quaternion may be off
_SAME = 1e-9  # metres, and elements of rotations: transforms that are repeated stand still


def stamp_of(header: Any) -> float:
    """Seconds of a header."""
    stamp = header.stamp
    return float(getattr(stamp, "sec", 0)) + float(getattr(stamp, "nanosec", 0)) / NANO


def frame_name(text: str) -> str:
    """A frame's name without the slash that ROS 1 had before it."""
    return text.removeprefix("/")


def pose_of_message(place: Any, turn: Any, where: str) -> Array:
    """(4, 4) of a translation and a quaternion."""
    try:
        quaternion = np.array([turn.w, turn.x, turn.y, turn.z], dtype=np.float64)
        numbers = np.array([place.x, place.y, place.z], dtype=np.float64)
    except (AttributeError, TypeError, ValueError) as error:  # of JSON, which may lack anything
        raise InvalidInputError(where, str(error), "Give x, y, z, and x, y, z, w.") from error
    if not (np.isfinite(numbers).all() and abs(float(np.linalg.norm(quaternion)) - 1.0) < _UNIT):
        value = [*numbers.tolist(), *quaternion.tolist()]
        raise InvalidInputError(where, value, "Give finite numbers and a unit quaternion.")
    return quaternion_pose(quaternion, numbers)


class Transforms:
    """The tree of a bag's frames."""

    def __init__(self) -> None:
        """There is no frame yet."""
        self._still: dict[tuple[str, str], Array] = {}
        self._moving: dict[tuple[str, str], dict[float, Array]] = defaultdict(dict)
        self._parents: dict[str, Counter[str]] = defaultdict(Counter)
        self._series: dict[tuple[str, str], CameraPoses] = {}

    def add(self, transforms: Iterable[Any], where: str, *, still: bool) -> None:
        """Take a message's transforms.

        Args:
            transforms: Of `TFMessage`.
            still: Whether they hold for all times.
        """
        for one in transforms:
            parent, child = frame_name(one.header.frame_id), frame_name(one.child_frame_id)
            name = f"{where}{parent} to {child}"
            pose = pose_of_message(one.transform.translation, one.transform.rotation, name)
            self._parents[child][parent] += 1
            if still:
                self._still[parent, child] = pose
            else:
                self._moving[parent, child][stamp_of(one.header)] = pose

    @property
    def frames(self) -> tuple[str, ...]:
        """The names of the frames."""
        return tuple(dict.fromkeys([*self._parents, *(p for found in self._parents.values() for p in found)]))

    def above(self, frame: str) -> list[str]:
        """A frame and those above it, its parent first; a frame of several parents has the most frequent."""
        chain = [frame]
        while chain[-1] in self._parents:
            parent = self._parents[chain[-1]].most_common(1)[0][0]
            if parent in chain:
                raise InvalidInputError("tf", " to ".join([*chain, parent]), "Give a tree of frames, without a loop.")
            chain.append(parent)
        return chain

    def moves(self, frame: str) -> bool:
        """Whether a frame moves within the highest one above it."""
        chain = self.above(frame)
        steps = (self._moving.get((parent, child), {}).values() for child, parent in pairwise(chain))
        return any(len(found) > 1 and not _stands_still(found) for found in steps)

    def pose(self, target: str, source: str, time: float) -> Array | None:
        """(4, 4) from the frame `source` to `target` at a time; None where the tree does not tell."""
        up, down = self.above(source), self.above(target)
        common = next((frame for frame in up if frame in down), None)
        if common is None:
            return None
        here, there = (self._up(chain[: chain.index(common) + 1], time) for chain in (up, down))
        return None if here is None or there is None else np.linalg.inv(there) @ here

    def _up(self, chain: list[str], time: float) -> Array | None:
        """(4, 4) from the first of a chain of frames to the last."""
        pose: Array = np.eye(4)
        for child, parent in pairwise(chain):
            step = self._step(parent, child, time)
            if step is None:
                return None
            pose = step @ pose
        return pose

    def _step(self, parent: str, child: str, time: float) -> Array | None:
        if (known := self._still.get((parent, child))) is not None:
            return known
        if (parent, child) not in self._series:
            found = self._moving[parent, child]
            if _stands_still(found.values()):
                return self._still.setdefault((parent, child), next(iter(found.values())))
            self._series[parent, child] = series(found)
        return self._series[parent, child].at(0, time)


def series(poses: Mapping[float, Array]) -> CameraPoses:
    """Poses by their times, to be interpolated."""
    times = sorted(poses)
    return CameraPoses({}, tuple(times), tuple(poses[time] for time in times))


def _stands_still(poses: Collection[Array]) -> bool:
    """Whether they are one pose, which is published again and again."""
    return bool(poses) and float(np.ptp(np.array(list(poses)), axis=0).max()) < _SAME
