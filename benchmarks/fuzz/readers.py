"""Every reader, with valid files to start from: made here, so that a fresh clone has them."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fuzz.reader import Reader
from benchmarks.fuzz.stored_readers import STORED
from fgrecon.io.boxes import boxes_in
from fgrecon.io.cameras import read_camera
from fgrecon.io.catalogue import load_category, load_prior
from fgrecon.io.export.results import read_results
from fgrecon.io.images import decode_image, exif_camera
from fgrecon.io.keypoints import read_any_keypoints
from fgrecon.io.kitti_calibration import read_calibration
from fgrecon.io.models import read_models
from fgrecon.io.track_file import read_track
from fgrecon.perception.keypoints.network_file import load_weights
from fgrecon_research.io.annotations.reader import load_annotations
from fgrecon_research.io.kitti_sets import read_detections, read_image_set, read_labels

__all__ = ["READERS"]

_DATA = Path(__file__).parents[2] / "fgrecon" / "data"
_CAR = load_category("car14")
_POINT = [10.5, 20.5, 0.9]
_K = [[700.0, 0.0, 600.0], [0.0, 700.0, 180.0], [0.0, 0.0, 1.0]]
_LABEL = "Car 0.00 0 1.50 20.00 20.00 110.00 80.00 1.50 1.60 4.00 0.10 1.60 15.00 1.50\n"
_CALIB = "P2: 700 0 600 0 0 700 180 0 0 0 1 0\nR0_rect: 1 0 0 0 1 0 0 0 1\n"
_YAML = """%YAML:1.0
---
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [700., 0., 320., 0., 700., 240., 0., 0., 1.]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [0.1, 0., 0., 0., 0.]
"""


def _plain(name: str, content: Any) -> Callable[[], Mapping[str, bytes]]:
    return lambda: {name: json.dumps(content).encode()}


def _text(name: str, content: str) -> Callable[[], Mapping[str, bytes]]:
    return lambda: {name: content.encode()}


def _keypoints() -> Mapping[str, bytes]:
    instance = {"id": "a", "keypoints": [p[:2] for p in [_POINT] * 14], "confidence": [0.5] * 14, "box": [1, 2, 90, 80]}
    flat = [number for point in [[10.5, 20.5, 2]] * 14 for number in point]
    coco = {
        "images": [{"id": 1, "file_name": "a.png", "width": 100, "height": 50}],
        "categories": [{"id": 1, "name": "car", "keypoints": list(_CAR.keypoints), "skeleton": [[1, 2]]}],
        "annotations": [{"id": 1, "image_id": 1, "category_id": 1, "keypoints": flat, "bbox": [1, 2, 30, 40]}],
    }
    pifpaf = [{"keypoints": [0.5] * 72, "bbox": [1, 2, 3, 4], "score": 0.5, "category_id": 1}]
    contents = {"own": {"K": _K, "instances": [instance]}, "coco": coco, "pifpaf": pifpaf, "detections": [instance]}
    return {f"{name}.json": json.dumps(content).encode() for name, content in contents.items()}


def _track() -> Mapping[str, bytes]:
    frame = {
        "frame": 0,
        "keypoints_uv": [_POINT[:2]] * 14,
        "confidence": [0.9] * 14,
        "box_xyxy": [1, 2, 90, 80],
        "gt": {"location": [1.0, 1.6, 12.0], "rotation_y": 0.5, "length": 4.0, "width": 1.6, "height": 1.5},
    }
    P2 = [[*row, 0.0] for row in _K]
    content = {"K": _K, "P2": P2, "keypoint_names": list(_CAR.keypoints), "frames": [frame, frame | {"frame": 1}]}
    return {"track.json": json.dumps(content).encode()}


def _annotations() -> Mapping[str, bytes]:
    file = io.BytesIO()
    np.savez(file, keypoints_uv=np.full((3, 14, 2), 5.0), vehicle_id=np.arange(3))
    return {"a.npz": file.getvalue(), **{name: c for name, c in _keypoints().items() if name == "coco.json"}}


@cache
def _pictures() -> Mapping[str, bytes]:
    from PIL import Image

    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = 28
    found = {}
    for kind in ("PNG", "JPEG", "BMP", "TIFF", "WEBP"):
        file = io.BytesIO()
        Image.new("RGB", (40, 30), (9, 99, 199)).save(file, kind, **({"exif": exif} if kind == "JPEG" else {}))
        found[f"p.{kind.lower()}"] = file.getvalue()
    return found


@cache
def _results() -> Mapping[str, bytes]:
    import fgrecon
    from fgrecon.simulation.vehicles import yaw_pose

    pose = yaw_pose(0.5, np.array([1.0, 1.6, 12.0]))
    prior = load_prior("car14")
    seen = prior.mean @ pose[:3, :3].T + pose[:3, 3]
    pixels = (seen @ np.array(_K).T)[:, :2] / seen[:, 2:]
    result = fgrecon.reconstruct(pixels, np.array(_K), options=fgrecon.Options(keep_history=False))
    return {"result.json": json.dumps(result.to_dict(compact=True)).encode()}


def _picture(path: Path) -> None:
    content = path.read_bytes()
    image = decode_image(content, str(path))
    exif_camera(content, image.shape[1], image.shape[0])


def _weights() -> Mapping[str, bytes]:
    """The start of the shipped network: its header, and too few tensors."""
    content = (_DATA / "weights" / "keypoints-car14.safetensors").read_bytes()
    return {"w.safetensors": content[: 8 + int.from_bytes(content[:8], "little") + 4096]}


@cache
def _models() -> Mapping[str, bytes]:
    """A box as large as a car."""
    import trimesh

    box = trimesh.creation.box((4.0, 1.5, 1.8))
    found = {f"car.{kind}": box.export(file_type=kind) for kind in ("obj", "ply", "glb")}
    archive = io.BytesIO()
    np.savez(archive, car_names=np.array(["a"]), vertices=box.vertices[None], faces=box.faces)
    texts = {name: content.encode() if isinstance(content, str) else content for name, content in found.items()}
    return {**texts, "cars.npz": archive.getvalue()}


READERS: Mapping[str, Reader] = {
    "keypoints": Reader(lambda path: read_any_keypoints(path, _CAR), _keypoints),
    "track": Reader(lambda path: read_track(path, _CAR), _track),
    "category": Reader(load_category, lambda: {"c.json": (_DATA / "categories" / "car14.json").read_bytes()}),
    "prior": Reader(load_prior, lambda: {"p.npz": (_DATA / "priors" / "car14.npz").read_bytes()}),
    "annotations": Reader(lambda path: load_annotations([path], _CAR), _annotations),
    "results": Reader(read_results, _results),
    "boxes": Reader(
        lambda path: boxes_in(path, "a.png", (100, 50)),
        lambda: {"b.txt": _LABEL.encode(), "a.txt": b"2 0.5 0.5 0.2 0.3 0.9\n", "c.json": _keypoints()["coco.json"]},
    ),
    "camera": Reader(
        read_camera,
        lambda: {"c.yaml": _YAML.encode(), "calib.txt": _CALIB.encode(), "k.json": json.dumps({"K": _K}).encode()},
    ),
    "kitti calibration": Reader(read_calibration, _text("calib.txt", _CALIB)),
    "kitti labels": Reader(lambda path: read_labels(path.parent, [path.stem]), _text("000000.txt", _LABEL * 3)),
    "kitti detections": Reader(
        lambda path: read_detections(path, ["000000"]), _text("d.txt", "000000.png 2 0.9 1.0 2.0 30.0 40.0\n" * 3)
    ),
    "image set": Reader(read_image_set, _text("val.txt", "000000\n000001\n")),
    "picture": Reader(_picture, _pictures),
    "weights": Reader(load_weights, _weights),
    "car models": Reader(lambda path: read_models(path, _CAR), _models),
    **STORED,
}
"""Every reader by its name."""
