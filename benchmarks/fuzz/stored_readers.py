"""More readers: of what runs store, of what follows vehicles over time, and of decoders in a child process."""

from __future__ import annotations

import io
import json
import tempfile
import warnings
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fuzz.reader import Reader
from fgrecon.io.cameras import read_camera
from fgrecon.io.catalogue import load_category, load_prior
from fgrecon.io.export.image_info import read_images_file
from fgrecon.io.isolated import Isolated
from fgrecon.io.keypoints.names import parse_names
from fgrecon.io.kitti_files import read_tracking
from fgrecon.io.nuscenes import cuboid_boxes, open_nuscenes
from fgrecon.io.poses import read_poses
from fgrecon.video.given import read_given

__all__ = ["STORED"]

_CAR = load_category("car14")
_LABEL = "0 1 Car 0 0 1.50 20.00 20.00 110.00 80.00 1.50 1.60 4.00 0.10 1.60 15.00 1.50\n"
_CHILD = Isolated(10.0)
_IMAGE = "a.jpg"
_POSE = {"rotation": [1.0, 0.0, 0.0, 0.0], "translation": [0.0, 0.0, 1.5]}
_TABLES: Mapping[str, Any] = {
    "calibrated_sensor": _POSE | {"camera_intrinsic": [[700, 0, 600], [0, 700, 180], [0, 0, 1]], "sensor_token": "a"},
    "sensor": {"channel": "CAM_FRONT", "modality": "camera"},
    "sample_data": {
        "filename": _IMAGE,
        "calibrated_sensor_token": "a",
        "ego_pose_token": "a",
        "sample_token": "a",
        "width": 1200,
        "height": 400,
    },
    "ego_pose": _POSE,
    "sample_annotation": {
        "sample_token": "a",
        "instance_token": "a",
        "size": [1.7, 4.0, 1.5],
        "rotation": [1.0, 0.0, 0.0, 0.0],
        "translation": [0.0, 1.0, 20.0],
    },
    "instance": {"category_token": "a"},
    "category": {"name": "vehicle.car"},
}


def _instances() -> Mapping[str, bytes]:
    points = [[10.0 + i, 20.0 + i * i] for i in range(14)]
    one = {"id": "a", "keypoints": points, "confidence": [0.5] * 14, "box": [1, 2, 90, 280], "frame": 3, "track": 1}
    camera = {"K": [[700.0, 0.0, 600.0], [0.0, 700.0, 180.0], [0.0, 0.0, 1.0]]}
    truth = {"location": [1.0, 1.6, 12.0], "rotation_y": 0.5, "length": 4.0, "width": 1.6, "height": 1.5}
    frame = {"keypoints_uv": points, "confidence": [0.9] * 14, "box_xyxy": [1, 2, 90, 280], "gt": truth}
    frames = [frame | {"frame": i} for i in range(2)]
    P2 = [[*row, 0.0] for row in camera["K"]]
    track = camera | {"P2": P2, "keypoint_names": list(_CAR.keypoints), "frames": frames}
    contents = {"given": camera | {"instances": [one, one | {"id": "b", "frame": 4}]}, "track": track}
    found = {f"{name}.json": json.dumps(content).encode() for name, content in contents.items()}
    return found | {"given.txt": (_LABEL + _LABEL.replace("0 1 ", "1 1 ", 1)).encode()}


def _poses() -> Mapping[str, bytes]:
    kitti, tum = "1 0 0 0 0 1 0 0 0 0 1 0\n", "0.1 0 0 0 0 0 0 1\n0.2 0 0 1 0 0 0 1\n"
    eye = np.eye(4).tolist()
    return {"p.txt": kitti.encode() * 3, "tum.txt": tum.encode(), "p.json": json.dumps([eye, None, eye]).encode()}


def _tables(path: Path) -> None:
    """One table is the file, the others are whole."""
    for name, record in _TABLES.items():
        if name != path.stem:
            (path.parent / f"{name}.json").write_text(json.dumps([{"token": "a"} | record]))
    tables = open_nuscenes(path)
    read_camera(path.parent, _IMAGE)
    read_camera(f"{path.parent}#CAM_FRONT")
    list(cuboid_boxes(tables, _IMAGE))


def _coco() -> Mapping[str, bytes]:
    """As `write_coco_keypoints` writes it."""
    from fgrecon.io.coco_keypoints import COCO_KEYPOINTS_FORMAT

    size = _CAR.size
    image = {"id": 1, "file_name": _IMAGE, "width": 640, "height": 480, "drive": "d", "frame": 0}
    label = {
        "id": 1,
        "image_id": 1,
        "category_id": 1,
        "track_id": 0,
        "kind": "Car",
        "bbox": [1, 2, 30, 40],
        "keypoints": [10.0, 20.0, 2] * size,
        "keypoint_probability": [0.9] * size,
        "num_keypoints": size,
        "keypoint_covariance": [np.eye(2).tolist()] * size,
        "azimuth": 0.5,
        "agreement": 0.9,
        "cuboid": {"corners": [[1.0, 2.0]] * 8, "location": [0, 1, 9], "rotation_y": 0.5, "size": [4, 1.6, 1.5]},
        "segmentation": [[1.0, 2.0, 30.0, 2.0, 30.0, 40.0]],
    }
    content = {
        "format": COCO_KEYPOINTS_FORMAT,
        "info": {"a": "b"},
        "images": [image | {"camera_matrix": [[700, 0, 600], [0, 700, 180], [0, 0, 1]]}],
        "categories": [{"id": 1, "name": "car", "keypoints": list(_CAR.keypoints), "skeleton": [[1, 2]]}],
        "annotations": [label],
    }
    return {"labels.json": json.dumps(content).encode()}


def _read_coco(path: Path) -> None:
    from fgrecon.io.coco_keypoints import read_coco_keypoints

    read_coco_keypoints(path)


def _other_cameras() -> Mapping[str, bytes]:
    xml = "<?xml version='1.0'?><opencv_storage><image_width>640</image_width><image_height>480</image_height>"
    matrix = "<rows>3</rows><cols>3</cols><dt>d</dt><data>700. 0. 320. 0. 700. 240. 0. 0. 1.</data>"
    xml += f"<camera_matrix type_id='opencv-matrix'>{matrix}</camera_matrix></opencv_storage>"
    waymo = [{"name": 1, "intrinsic": [2000, 2000, 960, 640, 0, 0, 0, 0, 0], "width": 1920, "height": 1280}]
    ros = "image_width: 640\nimage_height: 480\ncamera_matrix: {data: [7, 0, 3, 0, 7, 2, 0, 0, 1]}\nd: [0.1, 0, 0, 0]\n"
    return {"c.xml": xml.encode(), "waymo.json": json.dumps(waymo).encode(), "ros.yaml": ros.encode()}


@cache
def _matlab() -> Mapping[str, bytes]:
    from scipy.io import savemat

    anchor = {"location": [10.0, 20.0], "status": 1}
    kinds = [("class", object), ("bbox", object), ("anchors", object)]
    objects = np.array([("car", [1.0, 2, 30, 40], {"left_front_wheel": anchor})], dtype=kinds)
    found = {}
    for packed in (False, True):
        file = io.BytesIO()
        savemat(file, {"record": {"filename": _IMAGE, "objects": objects}}, do_compression=packed)
        found["packed.mat" if packed else "plain.mat"] = file.getvalue()
    return found


def _read_matlab(path: Path) -> None:
    from fgrecon.io.keypoints.records import read_anchors

    read_anchors(path, _CHILD)


@cache
def _recordings() -> Mapping[str, bytes]:
    import fgrecon
    from fgrecon.core.observation import Observation
    from fgrecon.simulation.vehicles import yaw_pose
    from fgrecon.viz import SolvedVehicle, recording_of

    pose, matrix = yaw_pose(0.5, np.array([1.0, 1.6, 12.0])), np.array([[700.0, 0, 600], [0, 700, 180], [0, 0, 1]])
    seen = load_prior("car14").mean @ pose[:3, :3].T + pose[:3, 3]
    pixels = (seen @ matrix.T)[:, :2] / seen[:, 2:]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "r.rrd"
        observation, camera = Observation(pixels, np.ones(len(pixels))), fgrecon.Camera(matrix)
        recording_of(SolvedVehicle(fgrecon.reconstruct(observation, camera), observation, camera)).write(path)
        return {"r.rrd": path.read_bytes()}


def _read_recording(path: Path) -> None:
    from fgrecon.viz.replay import _read

    _CHILD("recording", _read, path)


@cache
def _parts() -> Mapping[str, bytes]:
    from fgrecon.batch.parts import Parts

    with tempfile.TemporaryDirectory() as folder:
        parts = Parts(Path(folder))
        for number in range(3):
            parts.add(_table(number))
        parts.flush()
        return {"part-000000.parquet": (Path(folder) / "part-000000.parquet").read_bytes()}


def _table(number: int) -> Any:
    import pyarrow as pa

    from fgrecon.batch.schema import result_schema

    texts = {"row_id": f"{number}", "id": "a car", "status": "converged", "x": 0.5 * number, "sigmas": [1.0] * 14}
    return pa.Table.from_pylist([texts], schema=result_schema())


def _read_parts(path: Path) -> None:
    """What a run does with the parts that an earlier one left."""
    from fgrecon.batch.parts import Parts, _outcomes

    parts = Parts(path.parent)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        _outcomes(path)  # what `Parts.done` calls in a child process
        list(parts.rows())
        parts.rows_in_order()


@cache
def _checkpoints() -> Mapping[str, bytes]:
    import torch

    file = io.BytesIO()
    network = torch.nn.Linear(3, 2)
    optimizer = torch.optim.AdamW(network.parameters())
    network(torch.zeros(1, 3)).sum().backward()
    optimizer.step()
    states = {"network": network.state_dict(), "average": network.state_dict(), "optimizer": optimizer.state_dict()}
    torch.save({**states, "step": 3, "settings": {"a": 1}}, file)
    return {"c.pt": file.getvalue()}


def _read_checkpoint(path: Path) -> None:
    import torch

    from fgrecon_research.training.keypoints.trainer import load_checkpoint, restore_checkpoint

    networks = torch.nn.Linear(3, 2), torch.nn.Linear(3, 2)
    restore_checkpoint(load_checkpoint(path), *networks, torch.optim.AdamW(networks[0].parameters()), {"a": 1})


def _training() -> Mapping[str, bytes]:
    return {"t.toml": (Path(__file__).parents[2] / "fgrecon/data/training/keypoints-car14.toml").read_bytes()}


def _read_training(path: Path) -> None:
    from fgrecon_research.training.keypoints.settings import read_settings

    read_settings(path)


def _names() -> Mapping[str, bytes]:
    pairs = {f"their {name}": name for name in _CAR.keypoints}
    return {"n.json": json.dumps(pairs).encode(), "l.json": json.dumps(list(_CAR.keypoints)).encode()}


def _json(name: str, content: Any) -> Callable[[], Mapping[str, bytes]]:
    return lambda: {name: json.dumps(content).encode()}


STORED: Mapping[str, Reader] = {
    "given vehicles": Reader(lambda path: read_given(path, _CAR), _instances),
    "poses": Reader(read_poses, _poses),
    "tracking labels": Reader(read_tracking, lambda: {"t.txt": _LABEL.encode() * 3}),
    "names": Reader(lambda path: parse_names(path, _CAR), _names),
    "images file": Reader(
        read_images_file,
        _json("i.json", {_IMAGE: {"image_id": 1, "timestamp": 0.5, "world_T_camera": np.eye(4).tolist()}}),
    ),
    "nuscenes tables": Reader(
        _tables, lambda: {f"{name}.json": json.dumps([{"token": "a"} | one]).encode() for name, one in _TABLES.items()}
    ),
    "vehicle labels": Reader(_read_coco, _coco),
    "other cameras": Reader(read_camera, _other_cameras),
    "training settings": Reader(_read_training, _training),
    "matlab": Reader(_read_matlab, _matlab),
    "recording": Reader(_read_recording, _recordings),
    "parts": Reader(_read_parts, _parts),
    "checkpoint": Reader(_read_checkpoint, _checkpoints),
}
"""Every reader by its name."""
