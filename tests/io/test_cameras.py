"""Cameras from other programs' calibration files: the same camera as the numbers that were written."""

import contextlib
import json

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fgrecon.core.camera import Camera
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.io.cameras import read_camera
from fgrecon.io.cameras.camera_source import CameraSource

from .formats import spoilt, write

K = np.array([[721.5, 0.0, 609.5], [0.0, 722.25, 172.75], [0.0, 0.0, 1.0]])
LENS = np.array([-0.35, 0.12, 1e-4, -2e-4, 0.01])
SIZE = 1242, 375


def check(camera, distortion=LENS, size=SIZE, matrix=K):
    expected = Camera(matrix, distortion, size)
    assert np.array_equal(camera.matrix, expected.matrix)
    assert (camera.distortion is None) == (distortion is None)
    assert distortion is None or np.array_equal(camera.distortion, expected.distortion)
    assert camera.image_size == size


def ros(model="plumb_bob", lens=LENS):
    """As `camera_calibration_parsers` writes it."""

    def matrix(array):
        return {"rows": len(array), "cols": len(array[0]), "data": [float(x) for x in np.ravel(array)]}

    return {
        "image_width": SIZE[0],
        "image_height": SIZE[1],
        "camera_name": "front",
        "camera_matrix": matrix(K),
        "distortion_model": model,
        "distortion_coefficients": matrix([lens]),
        "rectification_matrix": matrix(np.eye(3)),
        "projection_matrix": matrix(np.hstack([K - np.diag([20.0, 20.0, 0.0]), np.zeros((3, 1))])),
    }


@pytest.mark.parametrize("ending", ["yml", "yaml", "xml", "json"])
@pytest.mark.parametrize(
    "names",
    [("camera_matrix", "distortion_coefficients", "image_width", "image_height"), ("K", "D", "width", "height")],
)
def test_opencv_as_it_writes_itself(tmp_path, ending, names):
    path = tmp_path / f"c.{ending}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in zip(names, (K, LENS[None], *SIZE), strict=True):
        storage.write(name, value)
    storage.write("avg_reprojection_error", 0.25)
    storage.release()
    check(read_camera(path).camera)


def test_ros(tmp_path):
    check(read_camera(write(tmp_path / "c.yaml", yaml.safe_dump(ros()))).camera)
    eight = np.concatenate([LENS, [0.2, 0.3, 0.4]])
    rational = write(tmp_path / "r.yaml", yaml.safe_dump(ros("rational_polynomial", eight)))
    check(read_camera(rational).camera, eight)
    rectified = read_camera(f"{rational}#projection_matrix").camera
    check(rectified, None, matrix=K - np.diag([20.0, 20.0, 0.0]))
    plain = write(tmp_path / "p.yaml", yaml.safe_dump(ros("none", [0.0] * 5)))
    check(read_camera(plain).camera, None)


def test_a_message_of_ros_and_numbers_without_a_dot(tmp_path):
    values = ", ".join(map(str, K.ravel()))
    text = (
        f"width: 1242\nheight: 375\ndistortion_model: plumb_bob\nd: [-0.35, 0.12, 1e-04, -2e-04, 0.01]\nk: [{values}]\n"
    )
    check(read_camera(write(tmp_path / "m.yaml", text)).camera)


@pytest.mark.parametrize("model", ["equidistant", "fisheye", "kannala_brandt"])
def test_fisheyes_of_ros(tmp_path, model):
    camera = read_camera(write(tmp_path / "c.yaml", yaml.safe_dump(ros(model, LENS[:4])))).camera
    assert (camera.distortion_model, camera.distortion.tolist()) == ("fisheye", LENS[:4].tolist())


def test_lenses_that_are_not_solved_are_refused(tmp_path):
    with pytest.raises(InvalidInputError, match=r"distortion_model: got double_sphere\. .*Undistort"):
        read_camera(write(tmp_path / "c.yaml", yaml.safe_dump(ros("double_sphere", LENS[:4]))))


def test_opencvs_fisheye(tmp_path):
    path = tmp_path / "c.yml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("fisheye_model", 1)
    storage.write("camera_matrix", K)
    storage.release()
    with pytest.raises(InvalidInputError, match="distortion: got nothing"):
        read_camera(path)
    lens = f"distortion_coefficients: {LENS[:4].tolist()}\n"
    write(path, path.read_text() + lens)
    assert read_camera(path).camera.distortion_model == "fisheye"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"camera_matrix": None}, "camera_matrix: got nothing"),
        ({"camera_matrix": {"data": [1, 2]}}, r"camera_matrix\.data: got 2 elements"),
        ({"camera_matrix": {"data": ["a"] * 9}}, r'camera_matrix\.data\[0\]: got the text "a"'),
        ({"camera_matrix": {"data": [0] * 9}}, "intrinsics"),
        ({"distortion_coefficients": {"data": [1] * 7}}, "7 coefficients"),
        ({"image_width": 0.5}, "image_width"),
        ({"binning_x": 2}, "binning_x: got 2"),
        ({"roi": {"x_offset": 7}}, r"roi\.x_offset: got 7"),
    ],
)
def test_malformed_calibrations_are_one_line(tmp_path, change, message):
    path = write(tmp_path / "c.yaml", yaml.safe_dump(ros() | change))
    with pytest.raises(InvalidInputError, match=message) as caught:
        read_camera(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "text"),
    [("a.yaml", "a: [1"), ("a.yaml", "3"), ("a.xml", "<a>"), ("a.json", "{"), ("a.json", "[]"), ("a.txt", "P2: 1 2")],
)
def test_files_of_another_kind(tmp_path, name, text):
    with pytest.raises(InvalidInputError, match=name):
        read_camera(write(tmp_path / name, text))
    for missing in ("n.yaml", "n.xml", "n.json", "n.txt"):
        with pytest.raises(InvalidInputError, match=missing):
            read_camera(tmp_path / missing)
    with pytest.raises(InvalidInputError, match="folder of a data set"):
        read_camera(tmp_path)
    with pytest.raises(InvalidInputError, match="too long"):
        read_camera("x" * 5000)


def test_kitti(tmp_path):
    row = " ".join(map(str, np.hstack([K, K @ [[0.06], [0.0], [0.003]]]).ravel()))
    other = " ".join(map(str, np.hstack([2 * K - np.diag([0, 0, 1]), np.zeros((3, 1))]).ravel()))
    short = write(tmp_path / "000007.txt", f"P0: {other}\nP2: {row}\nR0_rect: 1 0 0 0 1 0 0 0 1\n")
    mounted = read_camera(short)
    check(mounted.camera, None, None)
    assert mounted.label_offset == pytest.approx([0.06, 0, 0.003], abs=1e-9)
    raw = f"calib_time: 09-Jan-2012\nS_rect_02: 1.242e+03 3.75e+02\nP_rect_02: {row}\nP_rect_03: {other}\n"
    path = write(tmp_path / "calib_cam_to_cam.txt", raw)
    check(read_camera(path).camera, None)
    check(read_camera(f"{path}#P3").camera, None, None, 2 * K - np.diag([0, 0, 1]))
    with pytest.raises(InvalidInputError, match="P7"):
        read_camera(f"{path}#P7")
    with pytest.raises(InvalidInputError, match="S_rect_02"):
        read_camera(write(tmp_path / "bad.txt", raw.replace("3.75e+02", "")))


def test_fields_of_a_keypoint_file(tmp_path):
    content = {"K": K.tolist(), "distortion": LENS.tolist(), "image_size": SIZE, "instances": []}
    check(read_camera(write(tmp_path / "k.json", content)).camera)


def waymo(name="FRONT"):
    """An entry of Waymo's `camera_calibrations`, as protobuf gives JSON."""
    fx, fy, cx, cy = K[[0, 1, 0, 1], [0, 1, 2, 2]]
    turn = [[1, 0, 0, 1.5], [0, 1, 0, 0], [0, 0, 1, 2.1], [0, 0, 0, 1]]
    return {
        "name": name,
        "intrinsic": [float(x) for x in (fx, fy, cx, cy, *LENS)],
        "extrinsic": {"transform": np.ravel(turn).tolist()},
        "width": SIZE[0],
        "height": SIZE[1],
    }


def test_waymo(tmp_path):
    check(read_camera(write(tmp_path / "one.json", waymo())).camera)
    whole = {"context": {"name": "x", "cameraCalibrations": [waymo(2), waymo("FRONT")]}}
    path = write(tmp_path / "all.json", whole)
    check(read_camera(f"{path}#FRONT_LEFT").camera)
    for name in ("", "#REAR"):
        with pytest.raises(InvalidInputError, match="FILE#NAME: FRONT_LEFT, FRONT"):
            read_camera(f"{path}{name}")


def nuscenes(folder, **changes):
    """Tables in the documented schema, with the numbers of a real front camera."""
    tables = {
        "sensor": [
            {"token": "s1", "channel": "CAM_FRONT", "modality": "camera"},
            {"token": "s2", "channel": "LIDAR_TOP", "modality": "lidar"},
        ],
        "calibrated_sensor": [
            {
                "token": "c1",
                "sensor_token": "s1",
                "translation": [1.70079118954, 0.0159456324149, 1.51095763913],
                "rotation": [0.4998015430569128, -0.5030316162024876, 0.4997798114386805, -0.49737083824542755],
                "camera_intrinsic": K.tolist(),
            }
        ],
        "ego_pose": [
            {"token": "e1", "timestamp": 1, "rotation": [1.0, 0.0, 0.0, 0.0], "translation": [411.3, 1180.8, 0.0]}
        ],
        "sample_data": [
            {
                "token": "d1",
                "ego_pose_token": "e1",
                "calibrated_sensor_token": "c1",
                "filename": "samples/CAM_FRONT/n015-2018__CAM_FRONT__15.jpg",
                "width": 1600,
                "height": 900,
                "is_key_frame": True,
            }
        ],
    }
    for name, content in {**tables, **changes}.items():
        write(folder / f"{name}.json", content)
    return folder


def test_nuscenes(tmp_path):
    folder = nuscenes(tmp_path)
    mounted = read_camera(folder, "n015-2018__CAM_FRONT__15.jpg")
    check(mounted.camera, None, (1600, 900))
    assert mounted.ground.distance == pytest.approx(1.51095763913)
    assert mounted.ground.normal == pytest.approx([0, 1, 0], abs=0.02)
    # x right, y down, z forward on a vehicle that looks along the world's x axis
    pose = mounted.world_T_camera
    assert pose[:3, :3] == pytest.approx(np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]), abs=0.02)
    assert pose[:3, 3] == pytest.approx([413.00079118954, 1180.8159456324149, 1.51095763913])
    check(read_camera(f"{folder}#CAM_FRONT").camera, None, None)
    check(read_camera(folder / "calibrated_sensor.json", "n015-2018__CAM_FRONT__15.png").camera, None, (1600, 900))


def test_nuscenes_as_its_own_library_reads_it(tmp_path):
    pytest.importorskip("nuscenes.utils.geometry_utils", exc_type=ImportError)
    from nuscenes.utils.geometry_utils import transform_matrix
    from pyquaternion import Quaternion

    folder = nuscenes(tmp_path)
    sensor = json.loads((folder / "calibrated_sensor.json").read_text())[0]
    pose = json.loads((folder / "ego_pose.json").read_text())[0]
    theirs = [transform_matrix(r["translation"], Quaternion(r["rotation"])) for r in (pose, sensor)]
    ours = read_camera(folder, "n015-2018__CAM_FRONT__15.jpg").world_T_camera
    assert ours == pytest.approx(theirs[0] @ theirs[1], abs=1e-9)


def test_nuscenes_that_does_not_say(tmp_path):
    folder = nuscenes(tmp_path)
    with pytest.raises(InvalidInputError, match=r"CAM_FRONT \(CAM_FRONT\)"):
        read_camera(folder)
    with pytest.raises(InvalidInputError, match="image: got other"):
        read_camera(folder, "other.jpg")
    bad = json.loads((folder / "calibrated_sensor.json").read_text())
    bad[0]["rotation"] = [1, 1, 0, 0]
    nuscenes(tmp_path, calibrated_sensor=bad)
    with pytest.raises(InvalidInputError, match="unit quaternion w, x, y, z"):
        read_camera(folder, "n015-2018__CAM_FRONT__15.jpg")
    nuscenes(tmp_path, calibrated_sensor=[])
    with pytest.raises(InvalidInputError, match=r"calibrated_sensor_token: got c1"):
        read_camera(folder, "n015-2018__CAM_FRONT__15.jpg")


FUZZ = settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.too_slow])


@FUZZ
@given(spoilt(ros()) | spoilt(waymo()) | spoilt([waymo(1), waymo(2)]), st.sampled_from(["", "#FRONT", "#P"]))
def test_no_content_ends_in_another_exception(tmp_path_factory, content, name):
    folder = tmp_path_factory.getbasetemp()
    for path in (write(folder / "f.yaml", yaml.safe_dump(content)), write(folder / "f.json", json.dumps(content))):
        with contextlib.suppress(FgreconError):
            read_camera(f"{path}{name}")


@FUZZ
@given(st.text("P_rect2:- .e10\n%YAML[]{}<a/>&*!", max_size=40), st.sampled_from(["yaml", "xml", "txt", "json"]))
def test_no_text_ends_in_another_exception(tmp_path_factory, text, ending):
    with contextlib.suppress(FgreconError):
        read_camera(write(tmp_path_factory.getbasetemp() / f"g.{ending}", text))


COEFFICIENTS = [-0.31, 0.09, 0.001, -0.0005, 0.0]
NESTED = [[610.0, 0, 478.0], [0, 612.0, 305.0], [0, 0, 1]]


@pytest.mark.parametrize(
    "name", ["dist_coeff", "dist_coefs", "distCoef", "distCoeffs", "distortion", "D", "distortion_coefficients"]
)
@pytest.mark.parametrize(
    "size", [{"width": 960, "height": 600}, {"image_width": 960, "image_height": 600}, {"image_size": [960, 600]}]
)
def test_the_lens_by_any_usual_name_beside_a_nested_matrix(tmp_path, name, size):
    (tmp_path / "c.json").write_text(json.dumps({"K": NESTED, name: COEFFICIENTS, **size}))
    camera = read_camera(tmp_path / "c.json").camera
    assert camera.distortion.tolist() == COEFFICIENTS
    assert camera.image_size == (960, 600)


def test_focal_length_and_principal_point_by_name(tmp_path):
    parts = {"fx": 700.0, "fy": 701, "cx": 600.5, "cy": 180.0}
    (tmp_path / "c.json").write_text(json.dumps({**parts, "distortion": COEFFICIENTS, "width": 1242, "height": 375}))
    camera = read_camera(tmp_path / "c.json").camera
    assert camera.matrix.tolist() == [[700.0, 0.0, 600.5], [0.0, 701.0, 180.0], [0.0, 0.0, 1.0]]
    assert (camera.distortion.tolist(), camera.image_size) == (COEFFICIENTS, (1242, 375))
    del parts["cy"]
    (tmp_path / "c.json").write_text(json.dumps(parts))
    with pytest.raises(InvalidInputError, match=r"c\.json: cy: got None"):
        read_camera(tmp_path / "c.json")


@pytest.mark.parametrize(("model", "lens"), [("equidistant", "fisheye"), ("pinhole", "opencv"), ("yolov8n", "opencv")])
def test_a_model_beside_the_numbers_is_that_of_the_lens_where_it_is_one(tmp_path, model, lens):
    (tmp_path / "front.json").write_text(json.dumps({"model": model, "K": NESTED, "D": COEFFICIENTS[:4], "rms": 0.3}))
    camera = read_camera(tmp_path / "front.json").camera
    assert (camera.distortion_model, camera.distortion.tolist()) == (lens, COEFFICIENTS[:4])


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("distortion_coefficents", COEFFICIENTS),
        ("distorsion", COEFFICIENTS),
        ("camera_model", "double_sphere"),
        ("model_distortion", "equidistant"),
        ("lens", {"k1": -0.31}),
        ("k1", -0.31),
        ("img_resolution", [960, 600]),
        ("image_widht", 960),
    ],
)
def test_a_field_that_looks_like_a_lens_or_a_size_and_is_not_read_is_refused_by_name(tmp_path, field, value):
    for matrix in ("camera_matrix", "intrinsics"):
        (tmp_path / "c.json").write_text(json.dumps({matrix: NESTED, field: value}))
        with pytest.raises(InvalidInputError) as error:
            read_camera(tmp_path / "c.json")
        assert error.value.field == f"{tmp_path / 'c.json'}: {field}"


def test_messages_as_ros2_topic_echo_ends_them(tmp_path):
    matrix = np.ravel(NESTED).tolist()
    message = f"header: {{stamp: {{sec: 1}}}}\nheight: 600\nwidth: 960\nd: {COEFFICIENTS}\nk: {matrix}\n---\n"
    (tmp_path / "c.yaml").write_text(message + message.replace("sec: 1", "sec: 2"))
    camera = read_camera(tmp_path / "c.yaml").camera
    assert (camera.image_size, camera.distortion.tolist()) == ((960, 600), COEFFICIENTS)
    (tmp_path / "c.yaml").write_text(message + message.replace("610.0", "611.0"))
    with pytest.raises(InvalidInputError, match="2 messages that differ"):
        read_camera(tmp_path / "c.yaml")


def test_a_folder_of_kittis_calibrations_has_one_for_each_image(tmp_path):
    for number, focal in enumerate((700.0, 800.0)):
        row = f"{focal} 0 600 0 0 {focal} 180 0 0 0 1 0"
        (tmp_path / f"{number:06d}.txt").write_text(f"P2: {row}\n")
    source = CameraSource(calib=tmp_path)
    assert [source.camera(f"{n:06d}.png")[0].matrix[0, 0] for n in (0, 1)] == [700, 800]
    with pytest.raises(InvalidInputError, match=r"000002\.txt"):
        source.camera("000002.png")
