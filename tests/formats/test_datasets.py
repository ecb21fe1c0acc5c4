"""Every reader against what the devkit makes of the same made-up files: corners to 1e-6 m, pixels to 1e-3."""

import json
from pathlib import Path

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import transform
from fgrecon.io.cameras import read_camera
from fgrecon.io.datasets import is_data_set, open_drive, open_images, open_sequence, open_video
from fgrecon.io.export import read_images_file
from fgrecon.io.kitti_calibration import calibration_beside
from fgrecon.io.sensors.points import read_points
from fgrecon.perception.sensor_source import SensorSource

from . import made_up

WRITERS = {
    "nuscenes": made_up.write_nuscenes,
    "truckscenes": lambda root: made_up.write_nuscenes(root, trucks=True),
    "argoverse2": made_up.write_argoverse2,
    "kitti360": made_up.write_kitti360,
    "cityscapes3d": made_up.write_cityscapes3d,
    "waymo": made_up.write_waymo,
    "kitti_raw": made_up.write_kitti_raw,
    "zod": made_up.write_zod,
}
ENVIRONMENTS = {"truckscenes": "nuscenes"}
ROOTS = {"kitti_raw": "2011_09_26", "nuscenes": "v1.0-mini", "truckscenes": "v1.0-mini", "argoverse2": "val"}
SEQUENCES = {"cityscapes3d": ("#aachen", "#bochum"), "zod": ("#frames/000000", "#frames/000001")}
CAMERAS = {
    "nuscenes": "scene-0001/CAM_FRONT",
    "truckscenes": "CAM_FRONT",
    "argoverse2": "ring_front_center",
    "kitti360": "image_00",
    "cityscapes3d": "aachen",
    "waymo": "FRONT",
    "kitti_raw": "image_02",
    "zod": "frames/000000/front_blur",
}
METRES, PIXELS = 1e-6, 1e-3


@pytest.fixture(params=WRITERS)
def written(request, tmp_path, monkeypatch):
    """Name of a data set, the folder of the whole, and that which is opened."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    root = tmp_path / "data"
    WRITERS[request.param](root)
    return request.param, root, root / ROOTS.get(request.param, "")


def _ours(name, folder):
    """Corners of all boxes, and by image corners and pixels of the boxes that it shows."""
    corners, images = {}, {}
    for part in SEQUENCES.get(name, ("",)):
        found, _ = open_sequence(f"{folder}{part}")
        for moment in found.moments.values():
            corners |= {box.name: box.corners for box in moment.boxes}
        for image in found.images:
            if image.moment is None:
                continue
            seen = {}
            for box in found.moments[image.moment].boxes:
                points = transform(np.linalg.inv(image.world_T_camera), box.corners)
                seen[box.name] = points, image.pixels(box.corners)[0]
            images[image.camera, image.name] = seen
    return corners, images


def _points(name, folder):
    """The LiDAR's points by image, in the camera's frame."""
    found = (open_sequence(f"{folder}{part}")[0] for part in SEQUENCES.get(name, ("",)))
    shown = (image for one in found for image in one.images if image.sweep is not None)
    return {f"{i.camera}/{i.name}": read_points(i.sweep.path, i.camera_T_points) for i in shown}


def _check(name, folder, said):
    corners, images = _ours(name, folder)
    assert corners.keys() == said["corners"].keys()
    for box, points in corners.items():
        assert np.abs(points - said["corners"][box]).max() < METRES, box
    both = "/" in next(iter(said["images"]))
    keys = {f"{camera}/{image}" if both else image: seen for (camera, image), seen in images.items()}
    assert keys.keys() == said["images"].keys()
    for image, points in said.get("points", {}).items():
        assert np.abs(_points(name, folder)[image] - points).max() < METRES, image
    seen_pixels = 0
    for image, boxes in keys.items():
        assert boxes.keys() == said["images"][image].keys()
        for box, (points, pixels) in boxes.items():
            theirs = said["images"][image][box]
            ahead = np.array(theirs["valid"]) if "valid" in theirs else points[:, 2] > 0.1
            seen_pixels += ahead.sum()
            if "corners" in theirs:
                assert np.abs(points - theirs["corners"]).max() < METRES, (image, box)
            assert np.abs(pixels - theirs["pixels"])[ahead].max(initial=0.0) < PIXELS, (image, box)
    assert seen_pixels > 35


def test_the_reader_sees_what_the_devkit_saw(written, facts):
    name, _, folder = written
    _check(name, folder, facts(name))


@pytest.mark.formats
def test_the_reader_sees_what_the_devkit_sees(written, devkit):
    name, root, folder = written
    if name == "waymo":  # whose components want every column: they write the tables of the test below
        return
    environment = ENVIRONMENTS.get(name, name)
    arguments = [folder if name == "argoverse2" else root, *(["trucks"] if name == "truckscenes" else [])]
    said = devkit(environment, f"{environment}_reads", *arguments)
    _check(name, folder, said)


@pytest.mark.formats
def test_tables_that_waymos_own_components_wrote(tmp_path, devkit, facts):
    devkit("waymo", "waymo_writes", tmp_path / "tables", given=json.dumps(made_up.waymo_scene()))
    _check("waymo", tmp_path / "tables", facts("waymo"))
    _check("waymo", tmp_path / "tables", devkit("waymo", "waymo_reads", tmp_path / "tables"))


def test_a_drive_has_what_an_image_shows(written):
    name, _, folder = written
    drive = open_drive(f"{folder}#{CAMERAS[name]}")
    labelled = [frame for frame in drive.frames if frame.labelled]
    assert [len(frame.objects) for frame in labelled] == [4] * len(labelled)  # one is behind the camera
    assert set(labelled[0].objects.kind) == {"Car"}
    cut = labelled[0].objects.truncation
    assert cut.max() > 0.5
    assert (np.sort(cut)[:3] == 0.0).all()
    assert labelled[0].objects.size[np.argmax(cut)] == pytest.approx([5.1, 2.0, 1.8])
    assert labelled[0].boxed.all()
    assert labelled[0].calibration.camera.image_size == (1600, 900)
    if name == "cityscapes3d":
        assert [f.time for f in drive.frames] == [None]
        with pytest.raises(InvalidInputError, match="follow one another"):
            open_video(f"{folder}#{CAMERAS[name]}")
    else:
        assert np.diff([frame.seconds for frame in labelled]) == pytest.approx(0.1)
        assert drive.frames[0].world_T_camera is not None
        assert len(open_video(f"{folder}#{CAMERAS[name]}").frames) == len(drive.frames)


def test_headings_go_through_half_a_turn(written):
    name, _, folder = written
    drive = open_drive(f"{folder}#{CAMERAS[name]}")
    yaws = drive.frames[0].objects.rotation_y
    # headings in the vehicle's frame are from ahead, rotation_y is from the camera's right: a quarter turn less
    expected = [-np.pi / 2 - v.heading for v in made_up.VEHICLES if v.name != "behind"]
    order = {tuple(np.round(v.size, 6)): i for i, v in enumerate(made_up.VEHICLES)}
    for yaw, size in zip(yaws, drive.frames[0].objects.size, strict=True):
        error = yaw - expected[order[tuple(np.round(size, 6))]]
        assert abs((error + np.pi) % (2 * np.pi) - np.pi) < 0.05  # the camera is turned a little


def test_images_bring_their_cameras(written):
    name, _, folder = written
    images = open_images(f"{folder}#{CAMERAS[name]}")
    assert all(image.path.is_file() for image in images)
    found = read_camera(f"{folder}#{CAMERAS[name]}")
    assert found.camera.matrix.tolist() == images[0].lens.matrix.tolist()
    assert (found.camera.distortion is not None) == (name in ("waymo", "zod"))


def test_what_is_not_named_is_asked_for(tmp_path):
    folder = made_up.write_argoverse2(tmp_path)
    with pytest.raises(InvalidInputError, match="ring_front_center, ring_rear_left"):
        open_drive(folder)
    with pytest.raises(InvalidInputError, match="adcf7d18"):
        open_drive(f"{folder}#nowhere/ring_front_center")
    with pytest.raises(InvalidInputError, match="Name a camera: ring_front_center"):
        open_drive(f"{folder}#ring_side_left")
    with pytest.raises(InvalidInputError, match=rf"such as FOLDER#{next(folder.glob('*')).name}/ring_front_center"):
        open_drive(folder.parent)
    assert is_data_set(folder)
    assert not is_data_set(tmp_path / "none")


def test_a_malformed_table_names_file_column_and_row(tmp_path):
    import pyarrow as pa
    from pyarrow import feather

    folder = made_up.write_argoverse2(tmp_path)
    path = next(folder.glob("*")) / "annotations.feather"
    table = feather.read_table(path)
    feather.write_feather(table.drop_columns(["length_m"]), path)
    with pytest.raises(InvalidInputError, match=r"annotations.feather: length_m.*no such column"):
        open_drive(f"{folder}#ring_front_center")
    feather.write_feather(table.set_column(0, "timestamp_ns", pa.array([1] * len(table))), path)
    with pytest.raises(InvalidInputError, match=r"city_SE3_egovehicle.feather: timestamp_ns"):
        open_drive(f"{folder}#ring_front_center")
    path.write_bytes(b"nothing")
    with pytest.raises(InvalidInputError, match=r"annotations.feather.*whole"):
        open_drive(f"{folder}#ring_front_center")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace("<semanticId>13", "<semanticId>car"), r"object0\.semanticId"),
        (lambda text: text.replace("<rows>4</rows>", "<rows>5</rows>"), r"object0\.transform"),
        (lambda text: text[:300], "XML"),
    ],
)
def test_a_malformed_box_of_kitti360_is_named(tmp_path, change, message):
    made_up.write_kitti360(tmp_path)
    (path,) = tmp_path.glob("data_3d_bboxes/*/*.xml")
    path.write_text(change(path.read_text()))
    with pytest.raises(InvalidInputError, match=message):
        open_drive(f"{tmp_path}#image_00")


def test_a_malformed_box_of_cityscapes_is_named(tmp_path):
    made_up.write_cityscapes3d(tmp_path)
    path = next(tmp_path.glob("gtBbox3d/*/aachen/*.json"))
    data = json.loads(path.read_text())
    data["objects"][2]["3d"]["rotation"] = [1.0, 1.0, 0.0, 0.0]
    path.write_text(json.dumps(data))
    with pytest.raises(InvalidInputError, match=r"objects\[2\]\.3d\.rotation"):
        open_drive(f"{tmp_path}#aachen")


def test_the_sweep_of_a_sample_is_in_the_cameras_frame(tmp_path):
    from fgrecon_research.io.drive_sensors import Sensor, lidar_points, with_sensors

    folder = made_up.write_nuscenes(tmp_path)
    drive = with_sensors(open_drive(f"{folder}#CAM_FRONT"), [Sensor.LIDAR])
    assert [frame.labelled for frame in drive.frames] == [True, True]
    frame = drive.frames[0]
    world_T_lidar = made_up.world_T_vehicle(made_up.TIMES_NS[0])  # its points are at the origin of the LiDAR
    expected = np.linalg.inv(frame.world_T_camera) @ world_T_lidar[:, 3]
    assert np.abs(lidar_points(frame)[0] - expected[:3]).max() < METRES


def test_the_sweeps_of_a_data_set_are_evidence(written):
    name, _, folder = written
    given = f"{folder}#{CAMERAS[name]}"
    if name in ("waymo", "cityscapes3d"):
        with pytest.raises(InvalidInputError, match="Give the sweeps"):
            SensorSource(lidar=given)
        return
    sensors = SensorSource(lidar=given)
    images = open_images(given)
    sensors.check(image.path.name for image in images)
    for image in images:
        if image.sweep is not None:
            (points,) = sensors.evidence(image.path)
            assert np.abs(points.points - read_points(image.sweep.path, image.camera_T_points)).max() < METRES
            assert np.abs(points.origin - image.camera_T_points[:3, 3]).max() < METRES
    with pytest.raises(InvalidInputError, match="that the images are of"):
        sensors.check(["another.png"])


@pytest.mark.parametrize(
    ("name", "labels"),
    [("argoverse2", "annotations.feather"), ("waymo", "lidar_box/*.parquet"), ("zod", "objects.json")],
)
def test_images_of_a_test_set_are_of_a_moment_without_labels(tmp_path, monkeypatch, name, labels):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    root = WRITERS[name](tmp_path)
    source = f"{root if name == 'argoverse2' else tmp_path}#{CAMERAS[name]}"
    before = read_images_file(Path(source))
    for path in tmp_path.rglob(labels):
        path.unlink()
    if name == "zod":
        file = tmp_path / "trainval-frames-mini.json"
        file.write_text(file.read_text().replace('"annotations"', '"none"'))
    assert [frame.labelled for frame in open_drive(source).frames] == [False] * len(before)
    after = read_images_file(Path(source))
    assert {file: info.sample_token for file, info in after.items()} == {f: i.sample_token for f, i in before.items()}
    assert all(info.world_T_vehicle is not None for info in after.values())


def test_the_folder_of_one_frame_of_zod_is_a_data_set(tmp_path):
    made_up.write_zod(tmp_path)
    sequence, camera = open_sequence(f"{tmp_path / 'single_frames/000001'}#front_dnat")
    assert (sequence.name, camera) == ("frames/000001", "front_dnat")
    assert not is_data_set(tmp_path / "single_frames/000002")


def test_images_of_kittis_raw_data_find_the_calibration_of_their_day(tmp_path):
    day = made_up.write_kitti_raw(tmp_path)
    image = day / "2011_09_26_drive_0001_sync/image_03/data/0000000000.png"
    found = calibration_beside(image)
    assert found.camera.matrix.tolist() == open_images(f"{day}#image_03")[0].lens.matrix.tolist()
    assert found.camera_T_lidar is not None


def test_cameras_whose_images_have_the_same_names_need_one_named(tmp_path):
    made_up.write_kitti360(tmp_path)
    with pytest.raises(InvalidInputError, match=r"Name a camera, such as .*#2013_05_28_drive_0000_sync/image_00"):
        SensorSource(lidar=f"{tmp_path}#2013_05_28_drive_0000_sync")
    with pytest.raises(InvalidInputError, match="lidar_pose"):
        SensorSource(lidar=f"{tmp_path}#image_00", lidar_pose=tmp_path / "pose.txt")


@pytest.mark.parametrize(
    ("file", "change", "message"),
    [
        ("tracklet_labels.xml", lambda text: text.replace("<tx>14.0", "<tx>far"), r"item 0: tx: got far"),
        ("tracklet_labels.xml", lambda text: text.replace("<w>1.8", "<w>-1.8", 1), r"item 0: h, w, l: got"),
        ("tracklet_labels.xml", lambda text: text[:200], "XML"),
        ("oxts/timestamps.txt", lambda text: text.replace("2011", "noon", 1), r"timestamps.txt:1: got noon"),
        ("oxts/data/0000000001.txt", lambda text: text[:20], r"0000000001.txt.*6 numbers"),
        (
            "../calib_cam_to_cam.txt",
            lambda text: text.replace("S_rect_02", "S_none"),
            r"calib_cam_to_cam.txt: S_rect_02: got no such line",
        ),
        (
            "../calib_imu_to_velo.txt",
            lambda text: text.replace("T:", "S:"),
            r"calib_imu_to_velo.txt: T: got no such line",
        ),
    ],
)
def test_a_malformed_file_of_kittis_raw_data_is_named(tmp_path, file, change, message):
    path = made_up.write_kitti_raw(tmp_path) / "2011_09_26_drive_0001_sync" / file
    path.write_text(change(path.read_text()))
    with pytest.raises(InvalidInputError, match=message):
        open_drive(f"{tmp_path}#image_02")


@pytest.mark.parametrize(
    ("file", "change", "message"),
    [
        (
            "objects.json",
            ('"orientation_3d_qw": 0', '"orientation_3d_qw": 30'),
            r"\[0\]\.properties\.orientation_3d_qw",
        ),
        ("objects.json", ("size_3d_width", "width"), r"objects.json: \[0\]\.properties\.size_3d_width: got nothing"),
        ("calibration.json", ('"FC"', '"front"'), r"calibration.json: FC: got nothing"),
        ("calibration.json", ("[1600, 900]", "[1600]"), r"calibration.json: FC\.image_dimensions"),
        ("ego_motion.json", ('"timestamps": [', '"timestamps": [0, '), r"ego_motion.json: poses.*list of 15"),
        (
            "../../trainval-frames-mini.json",
            ('"camera_frames": {', '"camera_frames": {"side": true, '),
            r"train\[0\]\.camera_frames\.side: got True",
        ),
        ("../../trainval-frames-mini.json", ("2022-04-15", "noon"), r"train\[0\]\.keyframe_time: got noon"),
    ],
)
def test_a_malformed_file_of_zod_is_named(tmp_path, file, change, message):
    path = made_up.write_zod(tmp_path) / "single_frames/000000" / file
    path.write_text(path.read_text().replace(*change))
    with pytest.raises(InvalidInputError, match=message):
        open_drive(f"{tmp_path}#frames/000000/front_blur")


def test_a_frame_of_kittis_raw_data_without_a_time_of_its_pose_is_not_labelled(tmp_path):
    path = made_up.write_kitti_raw(tmp_path) / "2011_09_26_drive_0001_sync" / "oxts/timestamps.txt"
    path.write_text(path.read_text().split("\n")[0])
    assert [frame.labelled for frame in open_drive(f"{tmp_path}#image_02").frames] == [True, False]
