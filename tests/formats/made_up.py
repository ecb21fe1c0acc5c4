"""A made-up scene of five vehicles and two cameras, and its files as data sets have them.

Nothing here uses fgrecon: the files are made from the numbers by numpy and scipy alone.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

AHEAD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""From a camera's axes right, down, forward to axes forward, left, up."""
WIDTH, HEIGHT = 1600, 900
TIMES_NS = 315968867_000_000_000, 315968867_100_000_000  # of the two sweeps
SHIFT_NS = 5_000_000  # the images are so much later


def pose(turn, place):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = Rotation.from_euler("ZYX", turn).as_matrix(), place
    return matrix


def wxyz(matrix):
    x, y, z, w = Rotation.from_matrix(matrix[:3, :3]).as_quat().tolist()
    return [w, x, y, z]


@dataclass(frozen=True)
class Vehicle:
    """Where its centre is from the vehicle with the cameras at the first time, heading, and length, width, height."""

    name: str
    place: tuple[float, float, float]
    heading: float
    size: tuple[float, float, float]

    def vehicle_T_box(self):
        return pose([self.heading, 0.0, 0.0], self.place)


VEHICLES = (
    Vehicle("ahead", (14.0, 1.5, 0.75), 0.1, (4.2, 1.8, 1.5)),
    Vehicle("oncoming", (25.0, 5.0, 0.8), np.pi - 1e-3, (4.6, 1.9, 1.6)),
    Vehicle("crossing", (18.0, -4.0, 0.7), -np.pi + 1e-3, (3.9, 1.7, 1.4)),
    Vehicle("cut-off", (4.5, 3.0, 0.9), 1.7, (5.1, 2.0, 1.8)),
    Vehicle("behind", (-12.0, -2.0, 0.75), -2.4, (4.4, 1.8, 1.5)),
)


@dataclass(frozen=True)
class Mounted:
    name: str
    matrix: np.ndarray
    vehicle_T_camera: np.ndarray


def _camera(name, focal, centre, turn, place):
    matrix = np.array([[focal, 0.0, centre[0]], [0.0, focal + 1.5, centre[1]], [0.0, 0.0, 1.0]])
    mount = pose(turn, place)
    mount[:3, :3] = mount[:3, :3] @ AHEAD
    return Mounted(name, matrix, mount)


CAMERAS = (
    _camera("front", 1266.4, (816.3, 491.5), [0.01, 0.02, -0.005], [1.7, 0.02, 1.51]),
    _camera("back", 809.2, (829.2, 481.8), [np.pi - 0.02, -0.01, 0.01], [0.03, -0.01, 1.56]),
)


def world_T_vehicle(time_ns):
    """Pose of the vehicle with the cameras: it drives round a bend, and leans a little."""
    seconds = (time_ns - TIMES_NS[0]) * 1e-9
    return pose([0.7 + 0.2 * seconds, 0.004, -0.006], [411.3 + 8.0 * seconds, 1180.8 + 5.0 * seconds, 0.2])


def world_T_box(vehicle, time_ns):
    """Pose of a vehicle's centre; each drives on at 3 m/s."""
    seconds = (time_ns - TIMES_NS[0]) * 1e-9
    here = vehicle.vehicle_T_box()
    here[:3, 3] += here[:3, 0] * 3.0 * seconds
    return world_T_vehicle(TIMES_NS[0]) @ here


def write_image(path: Path):
    """An image of the cameras' size, in stripes."""
    import cv2

    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.tile(np.arange(WIDTH, dtype=np.uint8), (HEIGHT, 1)))


POINTS = np.array([[6.0, 0.5, 0.25], [12.5, -3.0, 1.0], [-8.0, 4.0, 0.5]])
"""What a LiDAR measured, in the frame that a data set gives them in; half precision holds them."""


def _write_tables(folder: Path, tables: dict[str, list]):
    folder.mkdir(parents=True)
    for name, content in tables.items():
        (folder / f"{name}.json").write_text(json.dumps(content))


def _nuscenes_sensors():
    """Name, channel, place on the vehicle and matrix of each."""
    return [
        ("lidar", "LIDAR_TOP", np.eye(4), []),
        *((c.name, f"CAM_{c.name.upper()}", c.vehicle_T_camera, c.matrix.tolist()) for c in CAMERAS),
    ]


def _nuscenes_shots(root: Path) -> tuple[list, list]:
    """Rows of `sample_data` and `ego_pose`, whose files are written."""
    shots = [(TIMES_NS[0], "s0", True), (TIMES_NS[0] + 50_000_000, "s1", False), (TIMES_NS[1], "s1", True)]
    data, poses = [], []
    for number, (time, sample, key) in enumerate(shots):
        for name, channel, _, matrix in _nuscenes_sensors():
            taken = time + (SHIFT_NS if matrix else 0)
            token, ending = f"d{number}{name}", "jpg" if matrix else "pcd.bin"
            file = f"{'samples' if key else 'sweeps'}/{channel}/{token}.{ending}"
            poses.append(
                {
                    "token": f"e{token}",
                    "timestamp": taken // 1000,
                    "rotation": wxyz(world_T_vehicle(taken)),
                    "translation": world_T_vehicle(taken)[:3, 3].tolist(),
                }
            )
            data.append(
                {
                    "token": token,
                    "sample_token": sample,
                    "ego_pose_token": f"e{token}",
                    "calibrated_sensor_token": f"c{name}",
                    "timestamp": taken // 1000,
                    "fileformat": ending,
                    "is_key_frame": key,
                    "height": HEIGHT if matrix else 0,
                    "width": WIDTH if matrix else 0,
                    "filename": file,
                    "prev": "",
                    "next": "",
                }
            )
            if matrix:
                write_image(root / file)
            else:
                (root / file).parent.mkdir(parents=True, exist_ok=True)
                np.zeros((3, 5), dtype=np.float32).tofile(root / file)
    return data, poses


def _nuscenes_labels(samples: list[str]) -> list:
    """Rows of `sample_annotation`."""
    return [
        {
            "token": f"a{i}{v.name}",
            "sample_token": samples[i],
            "instance_token": f"i{v.name}",
            "visibility_token": "4",
            "attribute_tokens": [],
            "translation": world_T_box(v, time)[:3, 3].tolist(),
            "size": [v.size[1], v.size[0], v.size[2]],
            "rotation": wxyz(world_T_box(v, time)),
            "prev": "" if i == 0 else f"a{i - 1}{v.name}",
            "next": f"a{i + 1}{v.name}" if i + 1 < len(TIMES_NS) else "",
            "num_lidar_pts": 1,
            "num_radar_pts": 0,
        }
        for i, time in enumerate(TIMES_NS)
        for v in VEHICLES
    ]


def _nuscenes_instances() -> list:
    """Rows of `instance`."""
    return [
        {
            "token": f"i{v.name}",
            "category_token": "car",
            "nbr_annotations": 2,
            "first_annotation_token": f"a0{v.name}",
            "last_annotation_token": f"a1{v.name}",
        }
        for v in VEHICLES
    ]


def _nuscenes_samples(samples: list[str]) -> list:
    """Rows of `sample`."""
    return [
        {
            "token": t,
            "timestamp": time // 1000,
            "scene_token": "scene",
            "prev": "" if i == 0 else samples[i - 1],
            "next": samples[i + 1] if i + 1 < len(samples) else "",
        }
        for i, (t, time) in enumerate(zip(samples, TIMES_NS, strict=True))
    ]


def write_nuscenes(root: Path, *, trucks: bool = False) -> Path:
    """Tables of one scene: two key frames and a sweep between them; as TruckScenes has them on request."""
    samples = [f"s{i}" for i in range(len(TIMES_NS))]
    sensors = _nuscenes_sensors()
    data, poses = _nuscenes_shots(root)
    tables = {
        "sensor": [{"token": f"s{n}", "channel": c, "modality": "camera" if m else "lidar"} for n, c, _, m in sensors],
        "calibrated_sensor": [
            {
                "token": f"c{n}",
                "sensor_token": f"s{n}",
                "translation": p[:3, 3].tolist(),
                "rotation": wxyz(p),
                "camera_intrinsic": m,
            }
            for n, _, p, m in sensors
        ],
        "ego_pose": poses,
        "sample_data": data,
        "sample": _nuscenes_samples(samples),
        "sample_annotation": _nuscenes_labels(samples),
        "instance": _nuscenes_instances(),
        "category": [{"token": "car", "name": "vehicle.car", "description": "", "index": 1}],
        "attribute": [],
        "visibility": [{"token": str(i), "level": "", "description": ""} for i in range(1, 5)],
        "scene": [
            {
                "token": "scene",
                "log_token": "log",
                "nbr_samples": 2,
                "first_sample_token": "s0",
                "last_sample_token": "s1",
                "name": "scene-0001",
                "description": "",
            }
        ],
        "log": [{"token": "log", "logfile": "", "vehicle": "", "date_captured": "", "location": "nowhere"}],
        "map": [{"token": "map", "log_tokens": ["log"], "category": "semantic_prior", "filename": ""}],
    }
    if trucks:
        del tables["map"]
        tables |= {"ego_motion_cabin": [], "ego_motion_chassis": []}
    folder = root / "v1.0-mini"
    _write_tables(folder, tables)
    return folder


def _argoverse2_intrinsics(names: dict[str, str]):
    """Columns of the cameras' matrices and lenses."""
    import pyarrow as pa

    places = ("fx", (0, 0)), ("fy", (1, 1)), ("cx", (0, 2)), ("cy", (1, 2))
    return {
        "sensor_name": [names[c.name] for c in CAMERAS],
        **{f"{name}_px": [float(c.matrix[at]) for c in CAMERAS] for name, at in places},
        **{k: [0.01 * (i + 1) for _ in CAMERAS] for i, k in enumerate(("k1", "k2", "k3"))},
        "height_px": pa.array([HEIGHT] * 2, pa.int64()),
        "width_px": pa.array([WIDTH] * 2, pa.int64()),
    }


def _argoverse2_sweep():
    """Columns of a sweep."""
    import pyarrow as pa

    columns = {n: pa.array(POINTS[:, i].astype(np.float16), pa.float16()) for i, n in enumerate("xyz")}
    return columns | {n: pa.array([0] * len(POINTS), pa.int32()) for n in ("intensity", "laser_number", "offset_ns")}


def write_argoverse2(root: Path, log: str = "adcf7d18-0510-35b0-a2fa-b4cea13a6d76") -> Path:
    """A log of two labelled sweeps."""
    import pyarrow as pa
    from pyarrow import feather

    folder = root / "val" / log
    names = {"front": "ring_front_center", "back": "ring_rear_left"}

    def poses(items, key):
        rows = [(k, *wxyz(p), *p[:3, 3]) for k, p in items]
        columns = (key, "qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")
        return dict(zip(columns, map(list, zip(*rows, strict=True)), strict=True))

    def write(path, columns):
        path.parent.mkdir(parents=True, exist_ok=True)
        feather.write_feather(pa.table(columns), path, compression="uncompressed")

    taken = [time + SHIFT_NS for time in TIMES_NS]
    write(
        folder / "city_SE3_egovehicle.feather",
        poses([(t, world_T_vehicle(t)) for t in sorted([*TIMES_NS, *taken])], "timestamp_ns"),
    )
    write(
        folder / "calibration/egovehicle_SE3_sensor.feather",
        poses(
            [
                ("up_lidar", np.eye(4)),
                ("down_lidar", np.eye(4)),
                *((names[c.name], c.vehicle_T_camera) for c in CAMERAS),
            ],
            "sensor_name",
        ),
    )
    write(folder / "calibration/intrinsics.feather", _argoverse2_intrinsics(names))
    rows = [(t, v, np.linalg.inv(world_T_vehicle(t)) @ world_T_box(v, t)) for t in TIMES_NS for v in VEHICLES]
    places = poses([(t, p) for t, _, p in rows], "timestamp_ns")
    write(
        folder / "annotations.feather",
        {
            **places,
            "track_uuid": [v.name for _, v, _ in rows],
            "category": ["REGULAR_VEHICLE"] * len(rows),
            **{f"{n}_m": [v.size[i] for _, v, _ in rows] for i, n in enumerate(("length", "width", "height"))},
            "num_interior_pts": pa.array([1] * len(rows), pa.int64()),
        },
    )
    for time in taken:
        for name in names.values():
            write_image(folder / "sensors/cameras" / name / f"{time}.jpg")
    for time in TIMES_NS:
        write(folder / "sensors/lidar" / f"{time}.feather", _argoverse2_sweep())
    return folder.parent


def write_kitti360(root: Path, name: str = "2013_05_28_drive_0000_sync") -> Path:
    """A sequence of two frames; one vehicle stands still."""
    for folder in ("calibration", f"data_poses/{name}", "data_3d_bboxes/train"):
        (root / folder).mkdir(parents=True)
    turn = Rotation.from_euler("xyz", [0.003, -0.002, 0.004]).as_matrix()
    text, mounts = [], []
    for i, camera in enumerate(CAMERAS):
        fx, fy, cx, cy = camera.matrix[[0, 1, 0, 1], [0, 1, 2, 2]]
        text += [
            f"P_rect_{i:02d}: {fx} 0 {cx} {-300.0 * i} 0 {fy} {cy} 0 0 0 1 0",
            f"R_rect_{i:02d}: {' '.join(map(repr, turn.ravel().tolist()))}",
            f"S_rect_{i:02d}: {WIDTH}.0 {HEIGHT}.0",
        ]
        mounts.append(f"image_{i:02d}: {' '.join(map(repr, camera.vehicle_T_camera[:3].ravel().tolist()))}")
    mounts += [
        f"image_{i + 2:02d}: {' '.join(map(repr, c.vehicle_T_camera[:3].ravel().tolist()))}"
        for i, c in enumerate(CAMERAS)
    ]
    for name_of, camera in zip(("image_02", "image_03"), CAMERAS, strict=True):
        (root / f"calibration/{name_of}.yaml").write_text(_mei(name_of, camera))
    velo_T_camera = pose([0.02, -0.01, 0.03], [0.77, 0.3, -0.08])
    velo_T_camera[:3, :3] = velo_T_camera[:3, :3] @ AHEAD
    numbers = " ".join(map(repr, velo_T_camera[:3].ravel().tolist()))
    (root / "calibration/calib_cam_to_velo.txt").write_text(numbers)
    scans = root / "data_3d_raw" / name / "velodyne_points/data"
    scans.mkdir(parents=True)
    for frame in (7, 8):
        np.column_stack([POINTS, np.zeros(len(POINTS))]).astype(np.float32).tofile(scans / f"{frame:010d}.bin")
    (root / "calibration/perspective.txt").write_text("\n".join(["calib_time: 09-Jan-2012", *text]) + "\n")
    (root / "calibration/calib_cam_to_pose.txt").write_text("\n".join(mounts) + "\n")
    rows = [f"{i + 7} {' '.join(map(repr, world_T_vehicle(t)[:3].ravel().tolist()))}" for i, t in enumerate(TIMES_NS)]
    (root / f"data_poses/{name}/poses.txt").write_text("\n".join(rows) + "\n")
    items = []
    for number, v in enumerate(VEHICLES):
        static = v.name == "ahead"
        for i, time in enumerate(TIMES_NS[: 1 if static else 2]):
            matrix = world_T_box(v, time)
            matrix[:3, :3] = matrix[:3, :3] * v.size
            items.append(_kitti360_object(len(items), number, matrix, -1 if static else i + 7))
    (root / f"data_3d_bboxes/train/{name}.xml").write_text(
        f'<?xml version="1.0"?>\n<opencv_storage>{"".join(items)}</opencv_storage>\n'
    )
    for i in range(4):
        for frame in (7, 8):
            folder = root / f"data_2d_raw/{name}/image_{i:02d}" / ("data_rect" if i < 2 else "data_rgb")
            write_image(folder / f"{frame:010d}.png")
    return root


def _mei(name: str, camera: Mounted) -> str:
    """A fisheye of KITTI-360 as camodocal writes it; no p1 and p2, which the devkit leaves out."""
    fx, fy, cx, cy = camera.matrix[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()
    parts = {
        "mirror_parameters": {"xi": 2.2134},
        "distortion_parameters": {"k1": 0.0169, "k2": 1.6549, "p1": 0.0, "p2": 0.0},
        "projection_parameters": {"gamma1": fx, "gamma2": fy, "u0": cx, "v0": cy},
    }
    lines = [
        "%YAML:1.0",
        "---",
        "model_type: MEI",
        f"camera_name: {name}",
        f"image_width: {WIDTH}",
        f"image_height: {HEIGHT}",
    ]
    for part, values in parts.items():
        lines += [f"{part}:", *(f"   {key}: {value!r}" for key, value in values.items())]
    return "\n".join(lines) + "\n"


def _kitti360_object(index: int, instance: int, matrix: np.ndarray, time: int) -> str:
    vertices = np.array([[x, y, z] for x in (0.5, -0.5) for y in (0.5, -0.5) for z in (-0.5, 0.5)])

    def opencv(tag, values):
        data = " ".join(map(repr, np.asarray(values, dtype=float).ravel().tolist()))
        inside = {"rows": len(values), "cols": len(values[0]), "dt": "f", "data": data}
        return f'<{tag} type_id="opencv-matrix">{_tags(inside)}</{tag}>'

    faces = [[0, 1, 2], [1, 2, 3]]
    plain = {
        "index": index,
        "label": "car",
        "semanticId": 13,
        "instanceId": instance,
        "start_frame": 7,
        "end_frame": 8,
        "timestamp": time,
        "dynamic": int(time >= 0),
    }
    parts = f"{opencv('transform', matrix)}{opencv('vertices', vertices)}{opencv('faces', faces)}"
    return f"<object{index}>{parts}{_tags(plain)}</object{index}>"


def _tags(values: dict) -> str:
    return "".join(f"<{name}>{value}</{name}>" for name, value in values.items())


def write_cityscapes3d(root: Path) -> Path:
    """An image a camera, of a city each."""
    for camera, city in zip(CAMERAS, ("aachen", "bochum"), strict=True):
        stem = f"{city}_000000_000019"
        there = np.linalg.inv(
            camera.vehicle_T_camera @ np.block([[AHEAD.T, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]])
        )
        fx, fy, cx, cy = camera.matrix[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()
        objects = [
            {
                "2d": {"modal": [0, 0, 10, 10], "amodal": [0, 0, 10, 10]},
                "3d": {
                    "center": v.vehicle_T_box()[:3, 3].tolist(),
                    "dimensions": list(v.size),
                    "rotation": wxyz(v.vehicle_T_box()),
                    "type": "",
                    "format": "CRS_ISO8855",
                },
                "occlusion": 0.0,
                "truncation": 0.0,
                "instanceId": 26000 + i,
                "label": "car",
                "score": 1.0,
            }
            for i, v in enumerate(VEHICLES)
        ]
        path = root / "gtBbox3d/val" / city / f"{stem}_gtBbox3d.json"
        path.parent.mkdir(parents=True)
        path.write_text(
            json.dumps(
                {
                    "imgWidth": WIDTH,
                    "imgHeight": HEIGHT,
                    "sensor": {
                        "sensor_T_ISO_8855": there[:3].tolist(),
                        "fx": fx,
                        "fy": fy,
                        "u0": cx,
                        "v0": cy,
                        "baseline": 0.2,
                    },
                    "objects": objects,
                    "ignore": [],
                }
            )
        )
        write_image(root / "leftImg8bit/val" / city / f"{stem}_leftImg8bit.png")
    return root


def waymo_scene() -> dict:
    """The scene as `devkits/waymo_writes.py` takes it: two frames, two of the cameras, which have a lens."""
    import cv2

    frames = []
    for time in TIMES_NS:
        boxes = []
        for v in VEHICLES:
            here = np.linalg.inv(world_T_vehicle(TIMES_NS[0])) @ world_T_box(v, time)
            heading = float(np.arctan2(here[1, 0], here[0, 0]))
            boxes.append({"name": v.name, "place": here[:3, 3].tolist(), "size": list(v.size), "heading": heading})
        start, taken = world_T_vehicle(TIMES_NS[0]).tolist(), world_T_vehicle(TIMES_NS[0] + SHIFT_NS).tolist()
        frames.append({"micros": time // 1000, "pose": start, "image_pose": taken, "boxes": boxes})
    undone = np.vstack([np.hstack([AHEAD.T, np.zeros((3, 1))]), [0.0, 0.0, 0.0, 1.0]])
    cameras = [
        {
            "number": number,
            "matrix": camera.matrix[[0, 1, 0, 1], [0, 1, 2, 2]].tolist(),
            "lens": [0.04, -0.02, 0.001, -0.002, 0.0],
            "pose": (camera.vehicle_T_camera @ undone).tolist(),
        }
        for number, camera in zip((1, 4), CAMERAS, strict=True)
    ]
    image = cv2.imencode(".jpg", np.zeros((HEIGHT, WIDTH), np.uint8))[1].tobytes().hex()
    return {"width": WIDTH, "height": HEIGHT, "image": image, "frames": frames, "cameras": cameras}


def _write_waymo_rows(root: Path, name: str, folder: str, rows: list[dict]):
    import pyarrow as pa
    import pyarrow.parquet as pq

    kinds = {"key.frame_timestamp_micros": pa.int64(), "num": pa.int64(), "key.camera_name": pa.int8()}
    kinds["[LiDARBoxComponent].type"] = pa.int8()
    columns = {}
    for key in rows[0]:
        kind = pa.list_(pa.float64(), 16) if key.endswith("transform") else kinds.get(key)
        columns[key] = pa.array([row[key] for row in rows], kind)
    (root / folder).mkdir(parents=True)
    pq.write_table(pa.table(columns), root / folder / f"{name}.parquet")


def write_waymo(root: Path, name: str = "1005081002024129653_5313_150_5333_150") -> Path:
    """The tables of `devkits/waymo_writes.py`, as far as they are read."""
    scene = waymo_scene()
    time, camera = "key.frame_timestamp_micros", "key.camera_name"
    lenses, boxes, images = (f"[{part}Component]" for part in ("CameraCalibration", "LiDARBox", "CameraImage"))
    write = partial(_write_waymo_rows, root, name)

    def flat(values):
        return np.ravel(values).tolist()

    frames, cameras = scene["frames"], scene["cameras"]
    poses = "[VehiclePoseComponent].world_from_vehicle.transform"
    write("vehicle_pose", [{time: f["micros"], poses: flat(f["pose"])} for f in frames])
    intrinsics = ("f_u", "f_v", "c_u", "c_v", "k1", "k2", "p1", "p2", "k3")
    write(
        "camera_calibration",
        [
            {
                camera: c["number"],
                **{f"{lenses}.intrinsic.{n}": v for n, v in zip(intrinsics, c["matrix"] + c["lens"], strict=True)},
                f"{lenses}.extrinsic.transform": flat(c["pose"]),
                f"{lenses}.width": WIDTH,
                f"{lenses}.height": HEIGHT,
            }
            for c in cameras
        ],
    )
    write(
        "lidar_box",
        [
            {
                time: f["micros"],
                "key.laser_object_id": b["name"],
                **{f"{boxes}.box.center.{a}": v for a, v in zip("xyz", b["place"], strict=True)},
                **{f"{boxes}.box.size.{a}": v for a, v in zip("xyz", b["size"], strict=True)},
                f"{boxes}.box.heading": b["heading"],
                f"{boxes}.type": 1,
            }
            for f in frames
            for b in f["boxes"]
        ],
    )
    write(
        "camera_image",
        [
            {
                time: f["micros"],
                camera: c["number"],
                f"{images}.image": bytes.fromhex(scene["image"]),
                f"{images}.pose.transform": flat(f["image_pose"]),
                f"{images}.pose_timestamp": f["micros"] * 1e-6,
            }
            for f in frames
            for c in cameras
        ],
    )
    return root


def write_kitti_raw(root: Path) -> Path:
    """A drive of a day: two frames, poses by latitude and longitude, tracklets."""
    day = root / "2011_09_26"
    drive = day / "2011_09_26_drive_0001_sync"
    drive.mkdir(parents=True)
    numbers = lambda values: " ".join(map(repr, np.asarray(values, float).ravel().tolist()))  # noqa: E731
    turn = Rotation.from_euler("xyz", [0.003, -0.002, 0.004]).as_matrix()
    velo = pose([0.01, -0.005, 0.003], [0.27, 0.0, 0.08])
    velo[:3, :3] = AHEAD.T @ velo[:3, :3]
    imu = pose([0.002, 0.001, 0.014], [-0.81, 0.32, -0.8])
    lines = []
    for i, camera in enumerate((*CAMERAS, *CAMERAS)):
        matrix = np.column_stack([CAMERAS[0].matrix, [-300.0 * i, 0.0, 0.0]])
        lines += [
            f"S_{i:02d}: 1.392e+03 5.12e+02",
            f"K_{i:02d}: {numbers(camera.matrix)}",
            f"D_{i:02d}: -0.3 0.2 0.0 0.0 0.0",
        ]
        lines += [f"R_{i:02d}: {numbers(np.eye(3))}", f"T_{i:02d}: 0 0 0", f"S_rect_{i:02d}: {WIDTH} {HEIGHT}"]
        lines += [f"R_rect_{i:02d}: {numbers(turn)}", f"P_rect_{i:02d}: {numbers(matrix)}"]
    (day / "calib_cam_to_cam.txt").write_text("\n".join(["calib_time: 09-Jan-2012 13:57:47", *lines]) + "\n")
    for name, motion in (("velo_to_cam", velo), ("imu_to_velo", imu)):
        text = f"calib_time: 15-Mar-2012\nR: {numbers(motion[:3, :3])}\nT: {numbers(motion[:3, 3])}\n"
        (day / f"calib_{name}.txt").write_text(text)
    stamps = "2011-09-26 13:02:25.900000123\n2011-09-26 13:02:26.000000123\n"
    for folder in ("image_02", "image_03", "oxts", "velodyne_points"):
        (drive / folder / "data").mkdir(parents=True)
        (drive / folder / "timestamps.txt").write_text(stamps)
    for frame in range(2):
        numbers_of = [49.0 + 8e-6 * frame, 8.4 + 5e-6 * frame, 112.8, 0.02, -0.01, 3.1 + 0.1 * frame, *([0.0] * 24)]
        (drive / f"oxts/data/{frame:010d}.txt").write_text(numbers(numbers_of))
        np.zeros((3, 4), np.float32).tofile(drive / f"velodyne_points/data/{frame:010d}.bin")
        for camera in ("image_02", "image_03"):
            write_image(drive / camera / "data" / f"{frame:010d}.png")
    (drive / "tracklet_labels.xml").write_text(_tracklets())
    return day


def _tracklets() -> str:
    items = []
    for v in VEHICLES:
        rows = ""
        for frame in range(2):
            x, y, z = v.place[0] + 0.3 * frame, v.place[1], v.place[2] - v.size[2] / 2.0 - 1.7
            fields = {"tx": x, "ty": y, "tz": z, "rx": 0, "ry": 0, "rz": float(v.heading), "state": 2, "occlusion": 0}
            rows += f"<item>{''.join(f'<{k}>{n!r}</{k}>' for k, n in fields.items())}</item>"
        length, width, height = v.size
        items.append(
            f"<item><objectType>Car</objectType><h>{height}</h><w>{width}</w><l>{length}</l><first_frame>0</first_frame>"
            f"<poses><count>2</count>{rows}</poses></item>"
        )
    return (
        f"<boost_serialization><tracklets><count>{len(items)}</count>{''.join(items)}</tracklets></boost_serialization>"
    )


def write_zod(root: Path) -> Path:
    """The two sweeps as frames, of the first camera as a fisheye; names of the second as a program writes them."""
    frames = []
    lidar = pose([-np.pi / 2 + 0.01, 0.004, -0.002], [1.1, 0.01, 2.05])
    camera = CAMERAS[0]
    near = [TIMES_NS[0] - 40_000_000 + 20_000_000 * i for i in range(12)]
    seconds = [1_650_000_000 + (time - TIMES_NS[0]) * 1e-9 for time in (*near, *TIMES_NS)]
    for number, time in enumerate(TIMES_NS):
        stamp = datetime.fromtimestamp(1_650_000_000, UTC) + timedelta(milliseconds=100 * number)
        key, folder = f"{number:06d}", f"single_frames/{number:06d}"
        files = {
            camera: f"{folder}/camera_{camera}/{key}_{stamp:%Y-%m-%dT%H%M%S.%fZ}.jpg"
            for camera in ("front_blur", "front_dnat")
        }
        for file in files.values():
            write_image(root / file)
        here = world_T_vehicle(time)
        mounted = np.linalg.inv(here @ lidar)
        labels = [_zod_label(v, mounted @ world_T_box(v, time), number) for v in VEHICLES]
        labels.append({"geometry": {"coordinates": [[1, 2], [3, 4]]}, "properties": _zod_plain("far", "Van", number)})
        calibration = {
            "extrinsics": camera.vehicle_T_camera.tolist(),
            "lidar_extrinsics": lidar.tolist(),
            "intrinsics": np.column_stack([camera.matrix, np.zeros(3)]).tolist(),
            "distortion": [0.04, -0.02, 0.006, -0.001],
            "undistortion": [0.0] * 4,
            "image_dimensions": [WIDTH, HEIGHT],
            "field_of_view": [120.0, 67.0],
        }
        order = np.argsort(seconds)
        motion = {
            "timestamps": [seconds[i] for i in order],
            "poses": [world_T_vehicle((*near, *TIMES_NS)[i]).tolist() for i in order],
            **{name: [[0.0] * 3] * len(seconds) for name in ("velocities", "accelerations", "angular_rates")},
            "origin_lat_lon": [57.7, 11.9],
        }
        for name, content in (("calibration", {"FC": calibration}), ("ego_motion", motion), ("objects", labels)):
            (root / folder / f"{name}.json").write_text(json.dumps(content))
        shot = {"time": stamp.isoformat(), "height": HEIGHT, "width": WIDTH}
        file = f"{folder}/{key}_velodyne_{stamp:%Y-%m-%dT%H:%M:%S.%fZ}.npy"
        np.save(root / file, _zod_scan())
        lidars = [{"filepath": file, "time": stamp.isoformat(), "is_compensated": True}]
        frames.append(
            {
                "id": key,
                **dict.fromkeys(("start_time", "end_time", "keyframe_time"), stamp.isoformat()),
                "calibration_path": f"{folder}/calibration.json",
                "ego_motion_path": f"{folder}/ego_motion.json",
                **dict.fromkeys(("metadata_path", "oxts_path", "vehicle_data_path"), f"{folder}/none"),
                "annotations": {
                    "object_detection": {"filepath": f"{folder}/objects.json", "project": "object_detection"}
                },
                "camera_frames": {name: [{"filepath": file, **shot}] for name, file in files.items()},
                "lidar_frames": {"velodyne": lidars},
            }
        )
    words = {key: key.split("_")[0] + "".join(part.title() for part in key.split("_")[1:]) for key in frames[1]}
    frames[1] = {words[key]: value for key, value in frames[1].items()}
    (root / "trainval-frames-mini.json").write_text(json.dumps({"train": frames[:1], "val": frames[1:]}))
    return root


def _zod_scan():
    """A scan's points as they lie in a file."""
    kinds = [*((n, "<f4") for n in "xyz"), ("timestamp", "<i8"), ("intensity", "u1"), ("diode_index", "u1")]
    scan = np.zeros(len(POINTS), kinds)
    for i, axis in enumerate("xyz"):
        scan[axis] = POINTS[:, i]
    return scan


def _zod_plain(name, kind, number):
    return {"annotation_uuid": f"{name}-{number}", "class": "Vehicle", "type": kind, "unclear": False}


def _zod_label(vehicle, lidar_T_box, number):
    turn = dict(zip("wxyz", wxyz(lidar_T_box), strict=True))
    length, width, height = vehicle.size
    more = {"size_3d_length": length, "size_3d_width": width, "size_3d_height": height, "occlusion_ratio": "Light"}
    more |= {f"orientation_3d_q{part}": value for part, value in turn.items()}
    more["location_3d"] = {"coordinates": lidar_T_box[:3, 3].tolist(), "type": "Point"}
    drawn = {"coordinates": [[10.0, 40.0], [30.0, 20.0], [50.0, 60.0], [30.0, 80.0]], "type": "MultiPoint"}
    return {"geometry": drawn, "properties": _zod_plain(vehicle.name, "Car", number) | more}
