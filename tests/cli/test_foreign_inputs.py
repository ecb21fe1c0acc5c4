"""Commands on other programs' files: the same results as on the same data in fgrecon's own layout."""

import json

import cv2
import numpy as np
import pytest

from fgrecon.batch import read_folder
from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.export import read_results
from fgrecon.io.images import write_png
from tests.command_line import run
from tests.io.formats import CATEGORY, flat, given_by, in_scheme, our_record
from tests.io.test_cameras import nuscenes, ros, waymo

from .conftest import INTRINSICS, K, car

POINTS = np.array(car()["keypoints"])
LENS = [-0.3, 0.1, 0.001, -0.001, 0.0]


def solved(*arguments):
    """Poses of the results by id."""
    done = run(*arguments, "--json", "-")
    assert done.exit_code == 0, done.output
    return {e["id"]: e["result"]["camera_T_object"] for e in json.loads(done.stdout)["instances"]}


def coco(names=CATEGORY.keypoints, points=POINTS):
    flags = [x for u, v in points for x in (float(u), float(v), 2)]
    return {
        "images": [{"id": number, "file_name": f"{name}.jpg"} for number, name in enumerate(("street", "other"))],
        "categories": [{"id": 1, "name": "car", "keypoints": list(names)}],
        "annotations": [
            {"id": 5 + number, "image_id": number, "category_id": 1, "keypoints": flags} for number in (0, 1)
        ],
    }


def test_coco_is_solved_as_our_own_layout(write):
    ours = our_record(POINTS, 1.0)
    ours["keypoints"] = {name: [*map(float, p), 1.0] for name, p in zip(CATEGORY.keypoints, POINTS, strict=True)}
    expected = solved("reconstruct", write(ours, "ours.json"), INTRINSICS)
    found = solved("reconstruct", write(coco(), "coco.json"), INTRINSICS)
    assert found == {"5": expected["0"], "6": expected["0"]}


def test_the_photograph_chooses_among_cocos_images(write, tmp_path):
    image = write_png(tmp_path / "other.png", np.zeros((375, 1242, 3), np.uint8))
    assert list(solved("reconstruct", write(coco()), INTRINSICS, "--image", image)) == ["6"]


def test_names_that_nobody_knows(write):
    file = write(coco([f"p{k}" for k in range(14)]))
    assert isinstance(run("reconstruct", file, INTRINSICS).exception, InvalidInputError)
    pairs = ",".join(f"p{k}={name}" for k, name in enumerate(CATEGORY.keypoints))
    assert solved("reconstruct", file, INTRINSICS, "--names", pairs) == solved("reconstruct", write(coco()), INTRINSICS)


def test_a_track_of_openpifpaf_predictions(write):
    predictions = [{"keypoints": flat(in_scheme(POINTS, "apollo24"), 0.5)} for _ in range(2)]
    ours = [our_record(given_by("apollo24", POINTS), 0.5) for _ in range(2)]
    assert solved("track", write(predictions, "a.json"), INTRINSICS) == solved(
        "track", write(ours, "b.json"), INTRINSICS
    )


def test_carfusion_on_the_command_line(tmp_path):
    points = in_scheme(POINTS, "carfusion")
    lines = [f"{u},{v},{k},1,1\n" for k, (u, v) in enumerate(points, start=1) if np.isfinite(u)]
    file = tmp_path / "1_0001.txt"
    file.write_text("".join(lines))
    assert list(solved("reconstruct", file, INTRINSICS)) == ["1"]


@pytest.fixture
def cameras(tmp_path):
    """Files of other programs with one camera, by format."""
    row = " ".join(map(str, np.hstack([K, np.zeros((3, 1))]).ravel()))
    (tmp_path / "kitti.txt").write_text(f"P2: {row}\n")
    storage = cv2.FileStorage(str(tmp_path / "opencv.xml"), cv2.FILE_STORAGE_WRITE)
    storage.write("camera_matrix", K)
    storage.write("distortion_coefficients", np.array([LENS]))
    storage.release()
    ros_file = ros(lens=LENS)
    ros_file["camera_matrix"]["data"] = K.ravel().tolist()
    (tmp_path / "ros.yaml").write_text(json.dumps(ros_file))  # JSON is YAML
    one = waymo() | {"intrinsic": [*(float(x) for x in K[[0, 1, 0, 1], [0, 1, 2, 2]]), *LENS]}
    (tmp_path / "waymo.json").write_text(json.dumps(one))
    (tmp_path / "tables").mkdir()
    tables = nuscenes(tmp_path / "tables")
    sensors = json.loads((tables / "calibrated_sensor.json").read_text())
    sensors[0]["camera_intrinsic"] = K.tolist()
    nuscenes(tables, calibrated_sensor=sensors)
    return {
        name.partition(".")[0]: tmp_path / name for name in ("kitti.txt", "opencv.xml", "ros.yaml", "waymo.json")
    } | {"nuscenes": f"{tables}#CAM_FRONT"}


@pytest.mark.parametrize("kind", ["kitti", "opencv", "ros", "waymo", "nuscenes"])
def test_a_camera_from_a_file_is_the_camera_of_its_numbers(write, cameras, kind):
    lens = None if kind in ("kitti", "nuscenes") else LENS
    record = car(camera=Camera(K, lens))
    size = [1242, 375] if kind in ("ros", "waymo") else None
    ours = record | {"K": K.tolist(), "distortion": lens, "image_size": size}
    found = solved("reconstruct", write(record), "--camera", cameras[kind])
    assert found == solved("reconstruct", write(ours, "ours.json"))


def test_nuscenes_says_where_the_ground_is(write, cameras):
    done = run("reconstruct", write(car()), "--camera", cameras["nuscenes"])
    assert "says where the ground is; --ground=" in done.stdout
    plane = done.stdout.partition("--ground=")[2].split()[0]
    again = run("reconstruct", write(car()), "--camera", cameras["nuscenes"], f"--ground={plane}")
    assert again.exit_code == 0
    assert "says where" not in again.stdout


def test_one_way_to_say_the_camera(write, cameras):
    done = run("reconstruct", write(car()), "--camera", cameras["ros"], INTRINSICS)
    assert isinstance(done.exception, InvalidInputError)


def test_a_fisheye_stays_one_through_results_and_tables(write, tmp_path):
    """Solved as the pinhole's points are, and written and read back with its lens."""
    lens = {"distortion": [-0.02, 0.004, -0.003, 0.0004], "distortion_model": "fisheye"}
    camera = Camera(K, **lens)
    seen = {"id": "a", "K": K.tolist(), "keypoints": POINTS.tolist()}
    bent = {**seen, **lens, "keypoints": camera.distort(POINTS).tolist()}
    plain, path = solved("reconstruct", write(seen, "pinhole.json")), write(bent, "fisheye.json")
    for command in (["reconstruct", path, "--json", tmp_path / "out.json"], ["batch", path, "--out", tmp_path / "out"]):
        done = run(*command)
        assert done.exit_code == 0, done.output
        (found,) = read_results(command[-1]) if command[0] == "reconstruct" else read_folder(command[-1])
        np.testing.assert_allclose(found.result.camera_T_object, plain["a"], atol=1e-4)
        assert found.camera.lens_fields == lens
