"""Vehicles of a video that others have found: boxes or keypoints by frame, with ids or without.

| file | what is in it |
|---|---|
| `.txt` | KITTI's tracking labels or results: boxes of cars and vans; the track -1 is none |
| `.json` | a keypoint file whose instances name their `frame` (or an `image` that ends in its number), and a `track` |
| `.json` | a track file: one vehicle |
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fgrecon.core.camera import Camera
from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import box_around
from fgrecon.io.json_fields import read_json
from fgrecon.io.keypoint_file import Instance, parse_keypoints
from fgrecon.io.kitti_tracking import read_tracking
from fgrecon.io.track_file import parse_track
from fgrecon.video.association import AssociationSettings
from fgrecon.video.records import Sighting

__all__ = ["KINDS", "Given", "read_given"]

KINDS = ("Car", "Van")
"""Types of KITTI's objects that are taken."""

_Rows = list[tuple[int, Sighting]]


@dataclass(frozen=True, eq=False)
class Given:
    """What others have found.

    Attributes:
        vehicles: By the number of their frame.
        camera: The camera that the file names first, or None.
        cuboids: Whether the boxes enclose projected 3D boxes, as KITTI's do; else outlines.
    """

    vehicles: Mapping[int, tuple[Sighting, ...]]
    camera: Camera | None
    cuboids: bool

    @property
    def largest_id(self) -> int:
        """The largest id; -1 where there is none."""
        ids = (s.identity for sightings in self.vehicles.values() for s in sightings)
        return max((identity for identity in ids if identity is not None), default=-1)

    @property
    def association(self) -> AssociationSettings:
        """How those without an id are followed: each begins a track, since scores of boxes are of any scale."""
        return AssociationSettings(birth=-np.inf)

    @property
    def complete(self) -> bool:
        """Whether every vehicle has its keypoints, so that no network need look."""
        return all(s.observation is not None for sightings in self.vehicles.values() for s in sightings)


def read_given(path: Path, category: Category, *, forget_ids: bool = False) -> Given:
    """The vehicles of a file.

    Args:
        path: The file.
        category: Category of its keypoints.
        forget_ids: Whether ids are left out, so that vehicles are associated anew.

    Raises:
        InvalidInputError: The file has another format, an instance names no frame, or an id is twice in one; names it.
    """
    found: dict[int, list[Sighting]] = defaultdict(list)
    is_json = path.suffix.lower() == ".json"
    rows, camera = _keypoints(path, category) if is_json else (_boxes(path), None)
    for number, sighting in rows:
        found[number].append(replace(sighting, identity=None) if forget_ids else sighting)
    for number, sightings in found.items():
        ids = [s.identity for s in sightings if s.identity is not None]
        twice = next((i for i in ids if ids.count(i) > 1), None)
        if twice is not None:
            raise InvalidInputError(f"{path}: frame {number}", f"track {twice}, twice", "Give each vehicle its own id.")
    if not found:
        raise InvalidInputError("tracks", str(path), f"Give a file with a vehicle: {' or '.join(KINDS)}.")
    vehicles = {number: tuple(sightings) for number, sightings in found.items()}
    return Given(vehicles, camera, cuboids=not is_json)


def _boxes(path: Path) -> _Rows:
    rows = []
    for number, found in read_tracking(path).items():
        for i, kind in enumerate(found.objects.kind):
            if kind in KINDS:
                score, track = float(found.objects.score[i]), int(found.tracks[i])
                identity = None if track < 0 else track
                known = 1.0 if np.isnan(score) else score
                rows.append((number, Sighting(found.objects.box[i], known, identity, None, kind)))
    return rows


def _keypoints(path: Path, category: Category) -> tuple[_Rows, Camera | None]:
    data = read_json(path)
    if isinstance(data, Mapping) and "frames" in data and "keypoints" not in data:
        track = parse_track(data, path.stem, category, where=f"{path}: ")
        seen = [(int(frame.name.rpartition(":")[2]), frame.observation) for frame in track.frames]
        rows = [(n, Sighting(o.box, 1.0, 0, o)) for n, o in seen if o is not None and o.box is not None]
        return rows, track.camera
    instances = parse_keypoints(data, category, where=f"{path}: ").instances
    camera = next((instance.camera for instance in instances if instance.camera is not None), None)
    return [_sighting(instance, path) for instance in instances], camera


def _sighting(instance: Instance, path: Path) -> tuple[int, Sighting]:
    place = f"{path}: instance {instance.name}"
    digits = re.findall(r"\d+", Path(instance.image).stem) if instance.image is not None else []
    if instance.frame is None and not digits:
        fix = "Give the number of its frame, or an image that ends in it."
        raise InvalidInputError(f"{place}: frame", instance.image, fix)
    number = instance.frame if instance.frame is not None else int(digits[-1])
    try:
        observation = instance.observation
    except InvalidInputError as error:
        raise InvalidInputError(f"{place}: {error.field}", error.value, error.fix) from error
    points = observation.keypoints[observation.measured]
    if not len(points):
        raise InvalidInputError(f"{place}: keypoints", "none", "Give at least one, or leave the instance out.")
    around = box_around(points)
    box = around if observation.box is None else observation.box
    return number, Sighting(box, 1.0, instance.track, observation, instance.kind)
