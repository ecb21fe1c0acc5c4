"""Results as evaluations of data sets take them; `--images` takes what they need from the data set.

| kind | boxes in the frame of | cars are | `sample_token` of their images | also needed |
|---|---|---|---|---|
| `nuscenes`, `nuscenes_tracking`, `truckscenes` | the world | `car` | the sample | `world_T_camera` |
| `argoverse2` | the vehicle at the sweep's time | `REGULAR_VEHICLE` | the sweep's time, ns | all |
| `waymo` | the vehicle at the frame's time | `TYPE_VEHICLE` | the frame's time, us | all |
| `zod` | the vehicle at the key frame's time | `Vehicle_Car`, `Vehicle_Van` | the frame | all but `sequence` |
| `cityscapes3d` | the vehicle | `car` | - | `world_T_camera`, where the world is the vehicle |

All of it is `world_T_camera`, `world_T_vehicle` at that time, and `sequence`: the log or segment. Vehicles without a
pose are left out, and those of images of no sample, whose token is empty. What is missing of an image is refused by an
`InvalidInputError` that names it, and so is a file that would be empty where the data set's may not be.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import transform
from fgrecon.io.export.annotation_files import one_image
from fgrecon.io.export.image_info import ImageInfo, box_in, by_image, image_box, info_of, quaternion, score, track_of
from fgrecon.io.export.messages import objects_class
from fgrecon.io.export.results import NamedResult

_ON_VEHICLE = "sample_token", "sequence", "world_T_camera", "world_T_vehicle"
_VEHICLE = 1  # Waymo's `TYPE_VEHICLE`
_META = {"use_camera": True, "use_lidar": False, "use_radar": False, "use_map": False, "use_external": True}
_ABOUT = "method_name", "authors", "affiliation", "description", "code_url", "paper_url"
_TRUCKS = (
    _META | {"use_future_frames": False, "use_tta": False} | dict.fromkeys(_ABOUT, "") | {"method_name": "fgrecon"}
)


def nuscenes_text(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> str:
    """The JSON of a submission of the detection task; attributes are empty, and velocities zero where none is known.

    A sample without a vehicle has an empty list.
    """
    return _nuscenes(results, images, _detection)


def truckscenes_text(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> str:
    """The same with what TruckScenes' evaluation wants to know of a method; the text of `meta` is to be filled in."""
    return _nuscenes(results, images, _detection, _TRUCKS)


def nuscenes_tracking_text(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> str:
    """The JSON of a submission of the tracking task; see `nuscenes_text`. A vehicle's name is its track."""

    def entry(item: NamedResult) -> dict[str, Any]:
        return {"tracking_id": track_of(item), "tracking_name": "car", "tracking_score": float(score(item))}

    return _nuscenes(results, images, entry)


def _detection(item: NamedResult) -> dict[str, Any]:
    return {"detection_name": "car", "attribute_name": "", "detection_score": float(score(item))}


def _nuscenes(
    results: Sequence[NamedResult],
    images: Mapping[str, ImageInfo],
    entry: Callable[[NamedResult], dict[str, Any]],
    meta: Mapping[str, Any] = _META,
) -> str:
    found: dict[str, list[dict[str, Any]]] = {i.sample_token: [] for i in images.values() if i.sample_token}
    for box in _boxes(results, images, "sample_token", "world_T_camera"):
        velocity = [0.0, 0.0] if box.item.velocity is None else box.item.velocity[:2].tolist()
        found.setdefault(box.token, []).append(box.entry(box.token) | {"velocity": velocity} | entry(box.item))
    return json.dumps({"meta": meta, "results": found}, allow_nan=False) + "\n"


def argoverse2_bytes(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> bytes:
    """A feather file of Argoverse 2's detections: a row a box."""
    import pyarrow as pa
    from pyarrow import feather

    rows = []
    for box in _boxes(results, images, *_ON_VEHICLE):
        place = zip(("tx_m", "ty_m", "tz_m", "length_m", "width_m", "height_m"), box.numbers, strict=True)
        turn = zip(("qw", "qx", "qy", "qz"), box.rotation, strict=True)
        what = {"category": "REGULAR_VEHICLE", "track_uuid": track_of(box.item), "score": float(score(box.item))}
        times = {"timestamp_ns": int(box.token), "log_id": box.info.sequence}
        rows.append(dict(place) | dict(turn) | what | times)
    if not rows:
        raise InvalidInputError("results", "no vehicle of a sweep", "Give results of images that show sweeps.")
    sink = io.BytesIO()
    feather.write_feather(pa.Table.from_pylist(rows), sink, compression="uncompressed")
    return sink.getvalue()


def waymo_bytes(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> bytes:
    """Waymo's `Objects` (a protocol buffer), for its metrics and, inside of a `Submission`, its server."""
    found = objects_class()()
    for one in _boxes(results, images, *_ON_VEHICLE):
        names = "center_x", "center_y", "center_z", "length", "width", "height", "heading"
        heading = float(np.arctan2(one.axes[1, 0], one.axes[0, 0]))
        box = dict(zip(names, (*one.numbers, heading), strict=True))
        found.objects.add(
            object={"box": box, "type": _VEHICLE, "id": track_of(one.item)},
            score=score(one.item),
            context_name=one.info.sequence,
            frame_timestamp_micros=int(one.token),
        )
    if not found.objects:
        raise InvalidInputError("results", "no vehicle of a frame", "Give results of images that show frames.")
    content: bytes = found.SerializeToString(deterministic=True)
    return content


def zod_text(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> str:
    """Boxes by key frame for ZOD's own evaluation: its `EvalBoxes.deserialize` takes `results`."""
    found: dict[str, list[dict[str, Any]]] = {}
    for box in _boxes(results, images, "sample_token", "world_T_camera", "world_T_vehicle"):
        frame, kind = box.token.rpartition("/")[2], "Van" if (box.item.kind or "").lower() == "van" else "Car"
        about = {"detection_name": f"Vehicle_{kind}", "detection_score": float(score(box.item))}
        found.setdefault(frame, []).append(box.entry(frame) | about)
    return json.dumps({"results": found}, allow_nan=False) + "\n"


def cityscapes3d_text(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> str:
    """The JSON of the boxes of one image for Cityscapes 3D's evaluation."""
    one_image(results, "Cityscapes")
    entries = []
    for box in _boxes(results, images, "world_T_camera"):
        low, high = np.split(image_box(box.item), 2)
        outline = [*low.tolist(), *(high - low).tolist()]
        entries.append(
            {
                "2d": {"modal": outline, "amodal": outline},
                "3d": {"center": box.numbers[:3], "dimensions": box.numbers[3:], "rotation": box.rotation},
                "label": "car",
                "score": float(score(box.item)),
            }
        )
    return json.dumps({"objects": entries}, allow_nan=False) + "\n"


@dataclass(frozen=True, eq=False)
class _Box:
    """A vehicle's box in the frame of a submission."""

    item: NamedResult
    info: ImageInfo
    centre: Array  # (3,)
    axes: Array  # (3, 3) forward, left, up

    @property
    def token(self) -> str:
        """Of the image's sample."""
        return self.info.sample_token or ""

    @property
    def numbers(self) -> list[float]:
        """Its centre, and length, width and height."""
        return [*self.centre.tolist(), *self.item.result.box_size.tolist()]

    @property
    def rotation(self) -> list[float]:
        """Its quaternion w, x, y, z."""
        x, y, z, w = quaternion(self.axes)
        return [w, x, y, z]

    def entry(self, token: str) -> dict[str, Any]:
        """As nuScenes' and ZOD's evaluations have it."""
        size = self.item.result.box_size[[1, 0, 2]].tolist()
        return {"sample_token": token, "translation": self.numbers[:3], "size": size, "rotation": self.rotation}


def _boxes(results: Sequence[NamedResult], images: Mapping[str, ImageInfo], *needed: str) -> Iterator[_Box]:
    """The boxes of images that are of a sample; in the world's frame, or the vehicle's where its pose is needed."""
    for image, items in by_image(results).items():
        info = info_of(image, images)
        if info.sample_token == "":
            continue
        for name in needed:
            if getattr(info, name) is None:
                fix = "Give a file of images, or the data set (`images`, --images), that has it."
                raise InvalidInputError(f"images.{image or '*'}.{name}", "nothing", fix)
        frame_T_world = np.eye(4)
        if "world_T_vehicle" in needed and info.world_T_vehicle is not None:
            frame_T_world = np.linalg.inv(info.world_T_vehicle).astype(np.float64)
        for item in items:
            centre, axes = box_in(info, item.result.camera_T_object, item.result.box_size)
            yield _Box(item, info, transform(frame_T_world, centre), frame_T_world[:3, :3] @ axes)
