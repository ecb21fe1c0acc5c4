"""`--lidar` and `--depth`: vehicles come nearer to where they are, and what cannot be used is refused."""

import json

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from tests.command_line import run

pytest.importorskip("torch")


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sensors") / "sample"
    done = run("sample", "--out", folder)
    assert done.exit_code == 0, done.output
    return folder


def test_points_take_most_of_the_error_off(sample, tmp_path):
    from fgrecon.core.size_prior import size_prior
    from fgrecon.io.catalogue import load_prior
    from fgrecon.simulation.sample import sample_street

    truth = sample_street(load_prior("car14").for_fleet(size_prior("kitti"))).cars
    errors = {}
    for name, more in (("alone", ()), ("lidar", ("--lidar", sample / "street.npz", "--picture", tmp_path / "p.png"))):
        given = sample / "cars.json", "--image", sample / "street.png"
        done = run("reconstruct", *given, "--json", tmp_path / f"{name}.json", *more)
        assert done.exit_code == 0, done.output
        found = json.loads((tmp_path / f"{name}.json").read_text())["instances"]
        places = [np.array(one["result"]["camera_T_object"])[:3, 3] for one in found]
        pairs = zip(places, truth, strict=True)
        errors[name] = [np.linalg.norm(place - car.truth.camera_T_object[:3, 3]) for place, car in pairs]
    assert max(errors["lidar"]) < 0.2 < np.mean(errors["alone"])


def test_depth_maps_do_so_too_in_metres_or_not(sample, tmp_path):
    from fgrecon.io.images import read_image
    from fgrecon.io.kitti_calibration import read_calibration

    points = np.load(sample / "street.npz")["points"]
    camera = read_calibration(sample / "calib.txt").camera
    height, width = read_image(sample / "street.png").shape[:2]
    depth = np.full((height, width), np.nan)
    points = points[points[:, 2] > 1.0]
    column, row = np.rint(camera.project(points)).astype(int).T
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    depth[row[inside], column[inside]] = points[inside, 2]
    np.save(tmp_path / "metres.npy", depth)
    np.save(tmp_path / "scaled.npy", 0.5 * depth)
    np.save(tmp_path / "millimetres.npy", np.nan_to_num(1000.0 * depth).astype(np.uint32))
    given = "reconstruct", sample / "cars.json", "--image", sample / "street.png", "--json"
    for name, more in (
        ("metres", ()),
        ("millimetres", ("--depth-per-metre", 1000)),
        ("scaled", ("--depth-scale", "scale", "--camera-height", "1.65")),
    ):
        done = run(*given, tmp_path / f"{name}.json", "--depth", tmp_path / f"{name}.npy", *more)
        assert done.exit_code == 0, done.output
        for one in json.loads((tmp_path / f"{name}.json").read_text())["instances"]:
            assert one["result"]["evidence"]["depth"] > 1.0
    places = [
        [one["result"]["camera_T_object"] for one in json.loads((tmp_path / f"{name}.json").read_text())["instances"]]
        for name in ("metres", "millimetres")
    ]
    np.testing.assert_allclose(*places, atol=0.02)  # the same but for what is less than a millimetre
    done = run("reconstruct", sample / "cars.json", "--depth-inverse")
    assert isinstance(done.exception, InvalidInputError)
    assert "--depth" in str(done.exception)


def test_boxes_of_others_are_refined_by_points(sample, tmp_path):
    boxes, image, calib = (sample / name for name in ("detections.txt", "street.png", "calib.txt"))
    done = run("refine", boxes, image, "--calib", calib, "--out", tmp_path / "r.txt", "--lidar", sample / "street.npz")
    assert done.exit_code == 0, done.output
    assert (tmp_path / "r.txt").read_text() != boxes.read_text()


def test_a_scan_of_no_image_is_refused(sample, tmp_path):
    (tmp_path / "scans").mkdir()
    np.savez(tmp_path / "scans" / "other.npz", points=np.ones((3, 3)))
    done = run("reconstruct", sample / "cars.json", "--image", sample / "street.png", "--lidar", tmp_path / "scans")
    assert isinstance(done.exception, InvalidInputError)
    assert "street.png" in str(done.exception)
    np.savez(tmp_path / "turned.npz", points=np.load(sample / "street.npz")["points"][:, [2, 0, 1]] * [1, -1, -1])
    done = run(
        "reconstruct", sample / "cars.json", "--image", sample / "street.png", "--lidar", tmp_path / "turned.npz"
    )
    assert "LiDAR's frame" in str(done.exception)


def test_a_batch_has_the_scan_of_each_image(sample, tmp_path):
    import pyarrow.parquet as pq

    places = {}
    for name, more in (("alone", ()), ("lidar", ("--lidar", sample / "street.npz"))):
        out = tmp_path / name
        done = run("batch", sample / "street.png", "--calib", sample / "calib.txt", "--out", out, *more)
        assert done.exit_code == 0, done.output
        places[name] = pq.read_table(out).column("z").to_pylist()
    assert len(places["alone"]) == len(places["lidar"])
    assert places["alone"] != places["lidar"]


def test_masks_of_an_image_are_the_vehicles(sample, tmp_path):
    import cv2

    from fgrecon.io.catalogue import load_prior
    from fgrecon.simulation.sample import sample_street

    street = sample_street(load_prior("car14"))
    ids = np.zeros(street.image.shape[:2], dtype=np.uint16)
    cars = sorted(enumerate(street.cars), key=lambda one: -one[1].truth.camera_T_object[2, 3])
    for number, car in cars:  # the nearest last
        pose, vehicle = car.truth.camera_T_object, car.truth.vehicle
        pixels = street.camera.project(vehicle.vertices @ pose[:3, :3].T + pose[:3, 3])
        for face in vehicle.faces:
            cv2.fillConvexPoly(ids, np.round(pixels[face] * 16.0).astype(np.int32), number + 1, shift=4)
    cv2.imwrite(str(tmp_path / "street.png"), ids)
    given = sample / "cars.json", "--image", sample / "street.png"
    done = run("reconstruct", *given, "--masks", tmp_path / "street.png", "--json", tmp_path / "m.json")
    assert done.exit_code == 0, done.output
    kinds = [one["result"]["evidence"] for one in json.loads((tmp_path / "m.json").read_text())["instances"]]
    assert all(one["mask"] > 1.0 for one in kinds)


def test_a_lidar_of_unsure_place_is_placed_by_the_cars(sample, tmp_path):
    given = (
        "reconstruct",
        sample / "cars.json",
        "--image",
        sample / "street.png",
        "--together",
        "--lidar-sigma",
        "0.5,0.02",
    )
    refused = run(*given)
    assert isinstance(refused.exception, InvalidInputError)
    assert refused.exception.field == "lidar_sigma"
    done = run(*given, "--lidar", sample / "street.npz", "--json", tmp_path / "a.json")
    assert done.exit_code == 0, done.output
    errors = [one["result"]["place_errors"] for one in json.loads((tmp_path / "a.json").read_text())["instances"]]
    assert errors[0] == errors[1] == errors[2]
    assert np.abs(np.array(errors[0])).max() < 0.02, "it is where it is said to be"
    assert run(*given[:-1], "0.5", "--lidar", sample / "street.npz").exception.field == "lidar_sigma"


@pytest.mark.parametrize("up", [0.0, 1.0])
def test_a_scan_in_a_wrong_place_is_named(sample, tmp_path, up):
    """By every command that takes one, once, and also where the results go to standard output."""
    scan, image, calib = tmp_path / "scan.npz", sample / "street.png", sample / "calib.txt"
    np.savez(scan, points=np.load(sample / "street.npz")["points"] - [0.0, up, 0.0])
    of_image = image, "--calib", calib, "--boxes", sample / "detections.txt"
    for command in (
        ("reconstruct", sample / "cars.json", "--image", image, "--json", "-"),
        ("reconstruct", *of_image, "--json", "-"),
        ("reconstruct", *of_image, "--out", tmp_path / "each"),
        ("batch", *of_image, "--out", tmp_path / "batch"),
        ("refine", sample / "detections.txt", image, "--calib", calib, "--out", tmp_path / "r.txt"),
    ):
        done = run(*command, "--lidar", scan)
        assert done.exit_code == 0, done.output
        said = " ".join(f"{done.stdout} {done.stderr}".split())
        assert said.count("The scan is not where the image shows the vehicles") == (up > 0.0), command
