"""Records of what each frame of a video shows, before anything is solved; stored so that networks see a frame once.

How the camera moved is stored beside it: it depends on camera and ground, which the networks do not know.
Numbers are stored with every bit: a run that goes on from what is stored gives the results of one that was not stopped.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from fgrecon.core.arrays import Array
from fgrecon.core.evidence import VehicleClass
from fgrecon.core.observation import Observation
from fgrecon.core.text import whole_text
from fgrecon.video.egomotion import CameraMotion

FORMAT = "fgrecon.video/4"

_NUMBERS = pa.list_(pa.float64())
_ARRAYS = ("keypoints", "confidence", "covariance", "azimuth")


@dataclass(frozen=True, eq=False)
class Sighting:
    """One vehicle of a frame.

    Attributes:
        box: (4,) x1, y1, x2, y2 in pixels; around the keypoints where no other is known.
        score: Of the detection: 0 to 1 of fgrecon's own, of any scale where it is given.
        identity: Id that it came with, or None.
        observation: Its keypoints; None where there are none.
        kind: What it was said to be by what detected it, such as `Van`; None where that says nothing.
        vehicle_class: Of which class it is, where that is to tell its size; or None.
    """

    box: Array
    score: float
    identity: int | None
    observation: Observation | None
    kind: str | None = None
    vehicle_class: VehicleClass | None = None

    @property
    def classed_observation(self) -> Observation | None:
        """What a tracker takes: the keypoints with the class; None where there are none."""
        if self.observation is None or self.vehicle_class is None:
            return self.observation
        return self.observation.with_evidence([self.vehicle_class])


@dataclass(frozen=True, eq=False)
class FrameRecord:
    """What one frame shows.

    Attributes:
        number: Of the frame, within its source.
        time: Seconds, by the source's clock.
        name: Of the frame.
        problem: Why the frame could not be read, or None.
        sightings: The vehicles.
        motion: How the camera has moved since the last frame that could be read; None where nobody looked, or failed.
    """

    number: int
    time: float
    name: str
    problem: str | None
    sightings: tuple[Sighting, ...] = ()
    motion: CameraMotion | None = None


def record_schema() -> Any:
    """The columns of the stored records, a row for each frame."""
    sighting = [("box", _NUMBERS), ("score", pa.float64()), ("identity", pa.int64()), ("midpoint", pa.float64())]
    sighting += [("boxed", pa.bool_()), ("kind", pa.string()), ("classes", pa.string())]
    fields = [
        *(("row_id", pa.string()), ("frame", pa.int64()), ("time", pa.float64())),
        *(("name", pa.string()), ("problem", pa.string())),
        ("sightings", pa.list_(pa.struct([*sighting, *((name, _NUMBERS) for name in _ARRAYS)]))),
    ]
    return pa.schema(fields, metadata={"fgrecon.format": FORMAT})


def motion_schema() -> Any:
    """The columns of the stored motions, a row for each frame."""
    fields = [
        ("row_id", pa.string()),
        ("previous_T_current", _NUMBERS),
        ("covariance", _NUMBERS),
        ("points", pa.int64()),
    ]
    return pa.schema(fields, metadata={"fgrecon.format": FORMAT})


def to_table(record: FrameRecord) -> Any:
    """A record as a table of one row, without the motion."""
    row = {
        "row_id": str(record.number),
        "frame": record.number,
        "time": record.time,
        "name": whole_text(record.name),  # a file's need not be UTF-8
        "problem": None if record.problem is None else whole_text(record.problem),
        "sightings": [_plain(sighting) for sighting in record.sightings],
    }
    return pa.Table.from_pylist([row], schema=record_schema())


def motion_to_table(record: FrameRecord) -> Any:
    """A record's motion as a table of one row."""
    motion = record.motion
    row = {
        "row_id": str(record.number),
        "previous_T_current": None if motion is None else motion.previous_T_current.ravel().tolist(),
        "covariance": None if motion is None else motion.covariance.ravel().tolist(),
        "points": None if motion is None else motion.points,
    }
    return pa.Table.from_pylist([row], schema=motion_schema())


def from_row(row: Mapping[str, Any]) -> FrameRecord:
    """A record from a row of plain values, without the motion."""
    sightings = tuple(_sighting(item) for item in row["sightings"])
    return FrameRecord(row["frame"], row["time"], row["name"], row["problem"], sightings)


def motion_from_row(row: Mapping[str, Any]) -> CameraMotion | None:
    """A motion from a row of plain values; None where none was estimated."""
    if row["previous_T_current"] is None:
        return None
    pose, covariance = np.array(row["previous_T_current"]), np.array(row["covariance"])
    return CameraMotion(pose.reshape(4, 4), covariance.reshape(6, 6), row["points"])


def _plain(sighting: Sighting) -> dict[str, Any]:
    observation, vehicle_class = sighting.observation, sighting.vehicle_class
    arrays: dict[str, Any] = dict.fromkeys(_ARRAYS)
    if observation is not None:
        values = {name: getattr(observation, name) for name in _ARRAYS}
        arrays = {name: None if value is None else value.ravel().tolist() for name, value in values.items()}
    return {
        "box": sighting.box.tolist(),
        "score": sighting.score,
        "identity": sighting.identity,
        "midpoint": None if observation is None else observation.confidence_midpoint,
        "boxed": observation is not None and observation.box is not None,
        "kind": None if sighting.kind is None else whole_text(sighting.kind),
        "classes": None
        if vehicle_class is None
        else json.dumps([vehicle_class.scheme.value, dict(vehicle_class.probabilities)]),
        **arrays,
    }


def _sighting(item: Mapping[str, Any]) -> Sighting:
    box = np.array(item["box"])
    scheme, probabilities = json.loads(item.get("classes") or "[null, null]")  # runs of before have none
    known = None if scheme is None else VehicleClass(probabilities, scheme)
    if item["keypoints"] is None:
        return Sighting(box, item["score"], item["identity"], None, item["kind"], known)
    covariance, azimuth = item["covariance"], item["azimuth"]
    observation = Observation(
        np.array(item["keypoints"]).reshape(-1, 2),
        np.array(item["confidence"]),
        box if item["boxed"] else None,
        None if covariance is None else np.array(covariance).reshape(-1, 2, 2),
        item["midpoint"],
        None if azimuth is None else np.array(azimuth),
    )
    return Sighting(box, item["score"], item["identity"], observation, item["kind"], known)
