"""Results as evaluations of data sets take them.

| kind | boxes in the frame of | cars are |
|---|---|---|
| `nuscenes`, `nuscenes_tracking`, `truckscenes` | the world | `car` |
| `argoverse2` | the vehicle at the sweep's time | `REGULAR_VEHICLE` |
| `waymo` | the vehicle at the frame's time | `TYPE_VEHICLE` |
| `zod` | the vehicle at the key frame's time | `Vehicle_Car`; vans `Vehicle_Van` |
| `cityscapes3d` | the vehicle | `car` |
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import transform
from fgrecon.io.export.image_info import ImageInfo, box_in, by_image, image_box, info_of, quaternion, score, track_of
from fgrecon.io.export.label_files import one_image
from fgrecon.io.export.protocol_buffer import field
from fgrecon.io.export.results import NamedResult

_VEHICLE = 1  # Waymo's `TYPE_VEHICLE`
_META = {"use_camera": True, "use_lidar": False, "use_radar": False, "use_map": False, "use_external": True}
_ABOUT = "method_name", "authors", "affiliation", "description", "code_url", "paper_url"
_TRUCKS = (
    _META | {"use_future_frames": False, "use_tta": False} | dict.fromkeys(_ABOUT, "") | {"method_name": "fgrecon"}
)


def nuscenes_text(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> str:
    """The JSON of a submission of the detection task. Attributes are empty, and velocities zero where none is known.

    Args:
        results: Vehicles; those without a pose are left out.
        images: `sample_token` and `world_T_camera` of their images. A sample without a vehicle has an empty list;
            images of no sample, whose token is empty, are left out.

    Raises:
        InvalidInputError: Either is missing for an image; names it.
    """
    return _nuscenes(results, images, _detection)


def truckscenes_text(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> str:
    """The same with what TruckScenes' evaluation wants to know of a method; the text of `meta` is to be filled in.

    Raises:
        InvalidInputError: As `nuscenes_text` raises it.
    """
    return _nuscenes(results, images, _detection, _TRUCKS)


def nuscenes_tracking_text(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> str:
    """The JSON of a submission of the tracking task; see `nuscenes_text`. A vehicle's name is its track.

    Raises:
        InvalidInputError: As `nuscenes_text` raises it.
    """

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
    for item, info in _of_samples(results, images, "sample_token", "world_T_camera"):
        length, width, height = item.result.box_size.tolist()
        centre, axes = box_in(info, item.result.camera_T_object, item.result.box_size)
        x, y, z, w = quaternion(axes)
        assert info.sample_token is not None
        found.setdefault(info.sample_token, []).append(
            {
                "sample_token": info.sample_token,
                "translation": centre.tolist(),
                "size": [width, length, height],
                "rotation": [w, x, y, z],
                "velocity": [0.0, 0.0] if item.velocity is None else item.velocity[:2].tolist(),
                **entry(item),
            }
        )
    return json.dumps({"meta": meta, "results": found}, allow_nan=False) + "\n"


def argoverse2_bytes(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> bytes:
    """A feather file of Argoverse 2's detections: a row a box, in the vehicle's frame at the time of the sweep.

    Args:
        results: Vehicles; those without a pose are left out, and so are those of images that are of no sweep.
        images: `sample_token` (the sweep's time in nanoseconds), `sequence` (the log), `world_T_camera` and
            `world_T_vehicle` (of the sweep) of their images; `--images` takes them from the data set.

    Raises:
        InvalidInputError: One is missing for an image; names it.
    """
    import pyarrow as pa
    from pyarrow import feather

    rows = []
    for item, info in _of_samples(results, images, "sample_token", "sequence", "world_T_camera", "world_T_vehicle"):
        place, axes = _on_vehicle(item, info)
        x, y, z, w = quaternion(axes)
        times = {"timestamp_ns": int(info.sample_token or 0), "log_id": info.sequence}
        box = dict(zip(("tx_m", "ty_m", "tz_m"), place.tolist(), strict=True))
        box |= dict(zip(("length_m", "width_m", "height_m"), item.result.box_size.tolist(), strict=True))
        what = {"category": "REGULAR_VEHICLE", "track_uuid": track_of(item), "score": float(score(item))}
        rows.append(box | {"qw": w, "qx": x, "qy": y, "qz": z} | what | times)
    if not rows:
        raise InvalidInputError("results", "no vehicle of a sweep", "Give results of images that show labelled sweeps.")
    sink = io.BytesIO()
    feather.write_feather(pa.Table.from_pylist(rows), sink, compression="uncompressed")
    return sink.getvalue()


def waymo_bytes(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> bytes:
    """Waymo's `Objects` (a protocol buffer), for its metrics and, inside of a `Submission`, its server.

    Args:
        results: Vehicles; those without a pose are left out, and so are those of images that are of no frame.
        images: `sample_token` (the frame's time in microseconds), `sequence` (the segment), `world_T_camera` and
            `world_T_vehicle` (of the frame) of their images; `--images` takes them from the data set.

    Raises:
        InvalidInputError: One is missing for an image; names it.
    """
    content = b""
    for item, info in _of_samples(results, images, "sample_token", "sequence", "world_T_camera", "world_T_vehicle"):
        place, axes = _on_vehicle(item, info)
        length, width, height = item.result.box_size.tolist()
        heading = float(np.arctan2(axes[1, 0], axes[0, 0]))
        box = b"".join(field(n, v) for n, v in enumerate((*place.tolist(), width, length, height, heading), start=1))
        label = field(1, box) + field(3, _VEHICLE) + field(4, track_of(item))
        about = field(4, info.sequence or "") + field(5, int(info.sample_token or 0))
        content += field(1, field(1, label) + field(2, np.float32(score(item))) + about)
    if not content:
        raise InvalidInputError("results", "no vehicle of a frame", "Give results of images that show labelled frames.")
    return content


def zod_text(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> str:
    """Boxes by key frame for ZOD's own evaluation: its `EvalBoxes.deserialize` takes `results`.

    Args:
        results: Vehicles; those without a pose are left out, and so are those of images that are of no key frame.
        images: `sample_token` (the frame), `world_T_camera` and `world_T_vehicle` of their images.

    Raises:
        InvalidInputError: One is missing for an image; names it.
    """
    found: dict[str, list[dict[str, Any]]] = {}
    for item, info in _of_samples(results, images, "sample_token", "world_T_camera", "world_T_vehicle"):
        frame = (info.sample_token or "").rpartition("/")[2]
        place, axes = _on_vehicle(item, info)
        x, y, z, w = quaternion(axes)
        found.setdefault(frame, []).append(
            {
                "sample_token": frame,
                "translation": place.tolist(),
                "size": item.result.box_size[[1, 0, 2]].tolist(),
                "rotation": [w, x, y, z],
                "detection_name": "Vehicle_Van" if (item.kind or "").lower() == "van" else "Vehicle_Car",
                "detection_score": float(score(item)),
            }
        )
    return json.dumps({"results": found}, allow_nan=False) + "\n"


def cityscapes3d_text(results: Sequence[NamedResult], images: Mapping[str, ImageInfo]) -> str:
    """The JSON of an image's boxes for Cityscapes 3D's evaluation, in the vehicle's frame.

    Args:
        results: Vehicles of one image.
        images: Its `world_T_camera`, where the world is the vehicle.

    Raises:
        InvalidInputError: The pose is missing, or the vehicles are of several images, each of which has a file.
    """
    one_image(results, "Cityscapes")
    entries = []
    for item, info in _of_samples(results, images, "world_T_camera"):
        centre, axes = box_in(info, item.result.camera_T_object, item.result.box_size)
        x, y, z, w = quaternion(axes)
        low, high = np.split(image_box(item), 2)
        outline = [*low.tolist(), *(high - low).tolist()]
        entries.append(
            {
                "2d": {"modal": outline, "amodal": outline},
                "3d": {
                    "center": centre.tolist(),
                    "dimensions": item.result.box_size.tolist(),
                    "rotation": [w, x, y, z],
                },
                "label": "car",
                "score": float(score(item)),
            }
        )
    return json.dumps({"objects": entries}, allow_nan=False) + "\n"


def _on_vehicle(item: NamedResult, info: ImageInfo) -> tuple[Array, Array]:
    """Centre (3,) of a vehicle's box and its axes (3, 3) in the frame of the vehicle with the camera, at the sample."""
    centre, axes = box_in(info, item.result.camera_T_object, item.result.box_size)
    assert info.world_T_vehicle is not None
    vehicle_T_world = np.linalg.inv(info.world_T_vehicle).astype(np.float64)
    return transform(vehicle_T_world, centre), vehicle_T_world[:3, :3] @ axes


def _of_samples(
    results: Sequence[NamedResult], images: Mapping[str, ImageInfo], *needed: str
) -> Iterator[tuple[NamedResult, ImageInfo]]:
    """The vehicles of images that are of a sample, with what is known of their images."""
    for image, items in by_image(results).items():
        info = info_of(image, images)
        if info.sample_token == "":
            continue
        for name in needed:
            if getattr(info, name) is None:
                fix = "Give a file of images, or the data set (`images`, --images), that has it."
                raise InvalidInputError(f"images.{image or '*'}.{name}", "nothing", fix)
        for item in items:
            yield item, info
