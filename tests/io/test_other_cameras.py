"""Cameras of Kalibr, ORB-SLAM, VINS, COLMAP and nerfstudio: read, and refused by name where they are not solved."""

import json
import struct

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.cameras import read_camera

FX, FY, CX, CY = 458.654, 457.296, 367.215, 248.375
LENS = [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]
MATRIX = [[FX, 0.0, CX], [0.0, FY, CY], [0.0, 0.0, 1.0]]

KALIBR = f"""
cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: {LENS}
  distortion_model: radtan
  intrinsics: [{FX}, {FY}, {CX}, {CY}]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  camera_model: omni
  distortion_coeffs: {LENS}
  distortion_model: radtan
  intrinsics: [1.5, {FX}, {FY}, {CX}, {CY}]
  resolution: [752, 480]
  rostopic: /cam1/image_raw
"""
ORB = f"""%YAML:1.0
File.version: "1.0"
Camera.type: "PinHole"
Camera1.fx: {FX}
Camera1.fy: {FY}
Camera1.cx: {CX}
Camera1.cy: {CY}
Camera1.k1: {LENS[0]}
Camera1.k2: {LENS[1]}
Camera1.p1: {LENS[2]}
Camera1.p2: {LENS[3]}
Camera.width: 752
Camera.height: 480
Camera.fps: 20
"""
VINS = f"""%YAML:1.0
---
model_type: PINHOLE
camera_name: camera
image_width: 752
image_height: 480
distortion_parameters:
   k1: {LENS[0]}
   k2: {LENS[1]}
   p1: {LENS[2]}
   p2: {LENS[3]}
projection_parameters:
   fx: {FX}
   fy: {FY}
   cx: {CX}
   cy: {CY}
"""
COLMAP = f"""# Camera list with one line of data per camera:
#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]
# Number of cameras: 4
1 OPENCV 752 480 {FX} {FY} {CX} {CY} {" ".join(map(str, LENS))}
2 SIMPLE_RADIAL 752 480 {FX} {CX} {CY} -0.1
3 OPENCV_FISHEYE 752 480 {FX} {FY} {CX} {CY} 0.1 0 0 0
4 FOV 752 480 {FX} {FY} {CX} {CY} 0.9
"""
IMAGES = """# Image list with two lines of data per image:
1 1 0 0 0 0 0 0 2 b/left.png

2 1 0 0 0 0 0 0 1 b/right.png

"""


def write(path, text):
    path.write_text(text)
    return path


def same(camera, *, half=0.0, lens=LENS):
    expected = np.array(MATRIX)
    expected[:2, 2] -= half
    assert np.abs(camera.matrix - expected).max() < 1e-9
    assert np.abs(camera.distortion[: len(lens)] - lens).max() < 1e-12
    assert not camera.distortion[len(lens) :].any()
    assert camera.image_size == (752, 480)


def test_kalibr(tmp_path):
    path = write(tmp_path / "camchain.yaml", KALIBR)
    same(read_camera(f"{path}#cam0").camera)
    with pytest.raises(InvalidInputError, match="cam0, cam1"):
        read_camera(path)
    of_sphere = read_camera(f"{path}#cam1").camera
    assert (of_sphere.distortion_model, of_sphere.distortion.tolist()) == ("mei", [1.5, *LENS])
    write(path, KALIBR.replace("radtan", "equidistant"))
    fisheye = read_camera(f"{path}#cam0").camera
    assert (fisheye.distortion_model, fisheye.distortion.tolist()) == ("fisheye", LENS)
    with pytest.raises(InvalidInputError, match=r"cam1\.distortion_model: got equidistant of omni"):
        read_camera(f"{path}#cam1")
    for field, text in (
        ("camera_model", KALIBR.replace("pinhole", "ds")),
        ("distortion_model", KALIBR.replace("radtan", "fov")),
        ("intrinsics", KALIBR.replace(f"[{FX}, {FY}", f"[{FX}")),
    ):
        with pytest.raises(InvalidInputError, match=rf"cam0\.{field}"):
            read_camera(f"{write(path, text)}#cam0")


def test_orb_slam(tmp_path):
    path = write(tmp_path / "EuRoC.yaml", ORB)
    same(read_camera(path).camera)
    same(read_camera(write(path, ORB.replace("Camera1.", "Camera."))).camera)  # ORB-SLAM 2
    rectified = read_camera(write(path, ORB.replace("PinHole", "Rectified"))).camera
    assert rectified.distortion is None
    with pytest.raises(InvalidInputError, match=r"Camera\.type: got Omni"):
        read_camera(write(path, ORB.replace("PinHole", "Omni")))
    with pytest.raises(InvalidInputError, match=r"Camera1\.k3"):
        read_camera(write(path, ORB.replace("PinHole", "KannalaBrandt8")))
    fisheye = ORB.replace("PinHole", "KannalaBrandt8").replace("p1", "k3").replace("p2", "k4")
    camera = read_camera(write(path, fisheye)).camera
    assert (camera.distortion_model, camera.distortion.tolist()) == ("fisheye", LENS)
    with pytest.raises(InvalidInputError, match=r"Camera2\.fx"):
        read_camera(f"{path}#Camera2")


def test_vins(tmp_path):
    path = write(tmp_path / "cam0_pinhole.yaml", VINS)
    same(read_camera(path).camera)
    with pytest.raises(InvalidInputError, match="model_type: got SCARAMUZZA"):
        read_camera(write(path, VINS.replace("PINHOLE", "SCARAMUZZA")))
    names = dict(zip(("fx", "fy", "cx", "cy"), ("gamma1", "gamma2", "u0", "v0"), strict=True))
    mei = VINS.replace("PINHOLE", "MEI") + "mirror_parameters:\n   xi: 2.2\n"
    for theirs, name in names.items():
        mei = mei.replace(f"{theirs}:", f"{name}:")
    camera = read_camera(write(path, mei)).camera
    assert (camera.distortion_model, camera.distortion.tolist()) == ("mei", [2.2, *LENS])
    assert camera.matrix.tolist() == MATRIX
    fisheye = VINS[: VINS.index("distortion")].replace("PINHOLE", "KANNALA_BRANDT") + "projection_parameters:\n"
    numbers = zip(("k2", "k3", "k4", "k5", "mu", "mv", "u0", "v0"), [*LENS, FX, FY, CX, CY], strict=True)
    fisheye += "".join(f"   {name}: {number}\n" for name, number in numbers)
    beside = fisheye.replace("projection_parameters", "distortion_parameters").replace(
        "   mu", "projection_parameters:\n   mu"
    )
    for text in (fisheye, beside):
        camera = read_camera(write(path, text)).camera
        assert (camera.distortion_model, camera.distortion.tolist()) == ("fisheye", LENS)
        assert camera.matrix.tolist() == MATRIX
    with pytest.raises(InvalidInputError, match=r"projection_parameters\.cy"):
        read_camera(write(path, VINS[: VINS.index("   cy")]))
    with pytest.raises(InvalidInputError, match="model_type"):
        read_camera(write(path, VINS.replace("PINHOLE", '""')))


def in_bytes():
    """The same cameras as COLMAP writes them in binary."""
    cameras = [(1, 4, [FX, FY, CX, CY, *LENS]), (2, 2, [FX, CX, CY, -0.1]), (3, 5, [FX, FY, CX, CY, 0.1, 0, 0, 0])]
    cameras.append((4, 7, [FX, FY, CX, CY, 0.9]))
    parts = [struct.pack("<Q", len(cameras))]
    for number, model, values in cameras:
        parts += [struct.pack("<iiQQ", number, model, 752, 480), struct.pack(f"<{len(values)}d", *values)]
    return b"".join(parts)


@pytest.mark.parametrize("name", ["cameras.txt", "cameras.bin"])
def test_colmap(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(COLMAP.encode() if name == "cameras.txt" else in_bytes())
    same(read_camera(f"{path}#1").camera, half=0.5)
    simple = read_camera(f"{path}#2").camera
    assert simple.matrix[1, 1] == FX
    assert simple.distortion[0] == -0.1
    fisheye = read_camera(f"{path}#3").camera
    assert (fisheye.distortion_model, fisheye.distortion.tolist()) == ("fisheye", [0.1, 0.0, 0.0, 0.0])
    with pytest.raises(InvalidInputError, match=r"FOV.*undistort"):
        read_camera(f"{path}#4")
    with pytest.raises(InvalidInputError, match="1, 2, 3, 4"):
        read_camera(path)
    write(tmp_path / "images.txt", IMAGES)
    same(read_camera(path, "right.png").camera, half=0.5)
    assert read_camera(path, "left.png").camera.matrix[1, 1] == FX


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("cameras.txt", b"1 OPENCV 752\n"),
        ("cameras.txt", b"1 OPENCV 752 480 1 2 3\n"),
        ("cameras.bin", in_bytes()[:50]),
    ],
)
def test_malformed_cameras_of_colmap_are_named(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InvalidInputError, match=name):
        read_camera(path)


def transforms():
    pose = np.eye(4)
    pose[:3, 3] = 1.0, 2.0, 3.0
    lens = dict(zip(("k1", "k2", "p1", "p2"), LENS, strict=True))
    frames = [{"file_path": f"images/{n}.png", "transform_matrix": pose.tolist()} for n in ("a", "b")]
    size = {"camera_model": "OPENCV", "w": 752, "h": 480}
    return {**size, "fl_x": FX, "fl_y": FY, "cx": CX, "cy": CY, **lens, "frames": frames}


def test_nerfstudio(tmp_path):
    path = write(tmp_path / "transforms.json", json.dumps(transforms()))
    assert read_camera(path).world_T_camera is None
    found = read_camera(path, "b.png")
    same(found.camera, half=0.5)
    assert np.allclose(found.world_T_camera[:3, :3] @ [0, 0, 1], [0, 0, -1])  # its cameras look along -z
    assert found.world_T_camera[:3, 3].tolist() == [1.0, 2.0, 3.0]
    fisheye = {**transforms(), "camera_model": "OPENCV_FISHEYE", "k3": 0.01, "k4": -0.002}
    camera = read_camera(write(path, json.dumps(fisheye))).camera
    assert (camera.distortion_model, camera.distortion.tolist()) == ("fisheye", [*LENS[:2], 0.01, -0.002])
    with pytest.raises(InvalidInputError, match=r"camera_model.*EQUIRECTANGULAR"):
        read_camera(write(path, json.dumps({**transforms(), "camera_model": "EQUIRECTANGULAR"})))
    with pytest.raises(InvalidInputError, match="camera_model"):
        read_camera(write(path, json.dumps({**transforms(), "camera_model": {}})))
    del fisheye["camera_model"]
    assert read_camera(write(path, json.dumps({**fisheye, "is_fisheye": True}))).camera.distortion_model == "fisheye"
    alone = transforms()
    del alone["fl_x"]
    with pytest.raises(InvalidInputError, match=r"fl_x.*no pixels"):  # as NeRF's made-up scenes
        read_camera(write(path, json.dumps({**alone, "camera_angle_x": 0.7})))
    alone["frames"][0]["fl_x"] = FX
    same(read_camera(write(path, json.dumps(alone)), "a.png").camera, half=0.5)
    with pytest.raises(InvalidInputError, match="fl_x"):
        read_camera(path)
