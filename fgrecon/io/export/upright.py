"""An upright frame over the world's or the camera's: z up, x ahead, y to the left, as ROS' REP 103 and 105 have it.

::

    map --+-- world     where the poses of the camera are known
          +-- camera    x right, y down, z forward

The world of a video's run is the frame of its first camera, whose y axis points down: a viewer that takes z for up
shows it lying on its side. A world that is upright as it is (nuScenes') stays as it is.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Ground
from fgrecon.core.geometry import UPRIGHT

MAP, WORLD, CAMERA = "map", "world", "camera"
"""Names of the frames."""


@dataclass(frozen=True, eq=False)
class FrameTransform:
    """Where a frame is."""

    child: str  # name of the frame; its parent is `map`
    map_T_child: Array  # (4, 4) its pose


def map_T_camera(ground: Ground | None) -> Array:
    """(4, 4) pose of a camera in an upright frame whose origin lies on the ground below it.

    Args:
        ground: The ground in its frame; None for a level camera of unknown height, which is at the origin.
    """
    up = np.array([0.0, -1.0, 0.0]) if ground is None else -ground.normal
    left = up[0] * up - [1.0, 0.0, 0.0]
    left /= np.linalg.norm(left)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([np.cross(left, up), left, up])
    pose[2, 3] = 0.0 if ground is None else ground.distance
    return pose


def transforms(moments: Iterable[tuple[Array | None, Ground | None]]) -> Iterator[list[FrameTransform]]:
    """Where `world`, if there is one, and `camera` are at each of some moments.

    Args:
        moments: The pose `world_T_camera` (4, 4) and the ground in the camera's frame, as far as they are known, in
            order of time. A camera whose pose is not known, while others are, is where it was last.
    """
    known = list(moments)
    first = next(((pose, ground) for pose, ground in known if pose is not None), None)
    world = None if first is None else _map_T_world(*first)
    last: Array | None = None
    for pose, ground in known:
        if world is None or (pose is None and last is None):
            here = map_T_camera(ground)
        elif pose is None:
            assert last is not None
            here = last
        else:
            here = last = world @ pose
        yield [*([] if world is None else [FrameTransform(WORLD, world)]), FrameTransform(CAMERA, here)]


def _map_T_world(world_T_camera: Array, ground: Ground | None) -> Array:
    """(4, 4) the world's pose, by a camera in it."""
    upright = map_T_camera(ground)
    up = world_T_camera[:3, :3] @ upright[2, :3]
    if up[2] > UPRIGHT:
        return np.eye(4)
    return upright @ np.linalg.inv(world_T_camera)
