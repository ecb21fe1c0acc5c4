"""Results of a video as rows of tables, as KITTI's tracking lines, and as a JSON line for each frame."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Ground
from fgrecon.core.metrics import wrap_angle
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.serialise import plain
from fgrecon.core.vehicle_estimate import VehicleEstimate
from fgrecon.io.export.video_frames import FRAME_FORMAT
from fgrecon.io.kitti_files import UNKNOWN, Objects, TrackedObjects, format_tracking
from fgrecon.video.follow import DEFAULT_KIND, TrackedFrame

_ARRAYS = frozenset(["pose_covariance", "world_T_object"])  # of a row; None where they are not known


def rows_of(frames: Iterable[TrackedFrame]) -> list[dict[str, Any]]:
    """A row for each vehicle in each frame, in the order of frames and ids; arrays are lists, as in `to_row`."""
    return [
        {"frame": frame.number, "time": frame.time, **_row(frame, identity)}
        for frame in frames
        for identity in sorted(frame.estimates)
    ]


def flattened(rows: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The numbers and texts alone of rows that have arrays."""
    return [{k: v for k, v in row.items() if not (isinstance(v, list) or k in _ARRAYS)} for row in rows]


def _row(frame: TrackedFrame, identity: int) -> dict[str, Any]:
    estimate = frame.estimates[identity]
    result: Reconstruction = estimate.reconstruction
    row = result.to_row(str(identity), flat=False)
    box = frame.boxes[identity].tolist()
    in_world = estimate.world_T_object
    place = (None, None, None) if in_world is None else in_world[:3, 3].tolist()
    row = row | motion_of(estimate) | dict(zip(("world_x", "world_y", "world_z"), place, strict=True))
    kind = frame.kinds.get(identity, DEFAULT_KIND)
    row |= {"id": identity, "kind": kind, "score": frame.scores[identity]}
    row |= dict(zip(("x1", "y1", "x2", "y2"), box, strict=True))
    covariance = result.uncertainty.pose_covariance
    return row | {
        "pose_covariance": None if covariance is None else covariance.ravel().tolist(),
        "world_T_object": None if in_world is None else in_world.ravel().tolist(),
    }


def motion_of(estimate: VehicleEstimate) -> dict[str, float | None]:
    """Velocity and speed (m/s), its standard deviation, turn rate (rad/s), facing's probability; None where not known.

    The velocity is along the world's axes where the world is known, else relative to the camera and along its axes.
    """
    velocity, facing = estimate.velocity, estimate.facing_probability
    along = (None, None, None) if velocity is None else velocity.tolist()
    return {
        **dict(zip(("velocity_x", "velocity_y", "velocity_z"), along, strict=True)),
        "speed": estimate.speed,
        "speed_sigma": estimate.speed_sigma,
        "turn_rate": estimate.turn_rate,
        "facing_probability": facing if np.isfinite(facing) else None,
    }


def tracking_text(frames: Iterable[TrackedFrame], label_offset: Array | None = None) -> str:
    """KITTI's tracking results.

    Args:
        frames: The frames.
        label_offset: (3,) of a labelled point in the camera's frame, which is taken off; or None.
    """
    offset = np.zeros(3) if label_offset is None else label_offset
    by_frame: dict[int, TrackedObjects] = {}
    for frame in frames:
        if not (ids := sorted(frame.estimates)):
            continue
        lines = [_line(frame, identity, offset) for identity in ids]
        objects = Objects.of_rows([frame.kinds.get(i, DEFAULT_KIND) for i in ids], np.array(lines))
        by_frame[frame.number] = TrackedObjects(objects, np.array(ids, dtype=np.int64))
    return format_tracking(by_frame)


def _line(frame: TrackedFrame, identity: int, offset: Array) -> list[float]:
    result: Reconstruction = frame.estimates[identity].reconstruction
    place, yaw = result.location - offset, result.rotation_y
    alpha = float(wrap_angle(yaw - np.arctan2(place[0], place[2])))
    length, width, height = result.box_size
    size = (height, width, length)
    return [UNKNOWN, UNKNOWN, alpha, *frame.boxes[identity], *size, *place, yaw, frame.scores[identity]]


def frame_lines(frames: Iterable[TrackedFrame], ground: Ground | None = None) -> Iterator[str]:
    """A JSON line for each frame, those without a vehicle and those that could not be read included.

    Args:
        frames: The frames.
        ground: The ground plane in the camera's frame, or None.
    """
    plane = None if ground is None else {"normal": ground.normal.tolist(), "distance": ground.distance}
    for frame in frames:
        content = {
            "format": FRAME_FORMAT,
            "frame": frame.number,
            "time": frame.time,
            "name": frame.name,
            "problem": frame.problem,
            "world_T_camera": plain(frame.world_T_camera),
            "ground": plane,
            "vehicles": [_vehicle(frame, identity) for identity in sorted(frame.boxes)],
        }
        yield json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":")) + "\n"


def _vehicle(frame: TrackedFrame, identity: int) -> Mapping[str, Any]:
    detected = {
        "id": identity,
        "kind": frame.kinds.get(identity, DEFAULT_KIND),
        "box": frame.boxes[identity].tolist(),
        "score": frame.scores[identity],
    }
    estimate = frame.estimates.get(identity)
    if estimate is None:
        return detected | {"result": None, "refused": frame.refused.get(identity)}
    pose = estimate.world_T_object
    return (
        detected
        | motion_of(estimate)
        | {"world_T_object": plain(pose), "result": estimate.reconstruction.to_dict(compact=True)}
    )
