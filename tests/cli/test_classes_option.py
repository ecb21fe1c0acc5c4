"""`--classes`: vehicles have the size of their class, and the command does what `VehicleClass` does in Python."""

import json

import numpy as np
import pytest

import fgrecon
from fgrecon import VehicleClass
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.options import BoxOptions
from fgrecon.io.catalogue import load_category
from fgrecon.io.kitti_calibration import read_calibration
from tests.command_line import run

pytest.importorskip("torch")


def poses(file):
    """(4, 4) pose of each vehicle of a results file, and the name of its prior."""
    results = [one["result"] for one in json.loads(file.read_text())["instances"]]
    return [(np.array(one["camera_T_object"]), one["prior"]) for one in results if one is not None]


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    folder = tmp_path_factory.mktemp("classes") / "sample"
    done = run("sample", "--out", folder)
    assert done.exit_code == 0, done.output
    content = json.loads((folder / "cars.json").read_text())
    kinds = ["Van", "Pedestrian"]
    for one, kind in zip(content["instances"], kinds, strict=False):
        one["kind"] = kind
    (folder / "named.json").write_text(json.dumps(content))
    numbers = [f"{edge:.2f}" for edge in content["instances"][0]["box"]]
    (folder / "street.txt").write_text(" ".join(["Van", "0", "0", "0", *numbers, *["1"] * 7]) + "\n")
    return folder


def test_of_keypoints_their_kind_is_the_class(sample, tmp_path):
    given = "reconstruct", sample / "named.json", "--image", sample / "street.png"
    found = {}
    for name, more in (("none", ()), ("labels", ("--classes", "labels"))):
        done = run(*given, *more, "--json", tmp_path / f"{name}.json")
        assert done.exit_code == 0, done.output
        found[name] = poses(tmp_path / f"{name}.json")
    assert [prior for _, prior in found["labels"]][:2] == ["car14 of van", "car14"]
    assert (found["labels"][1][0] == found["none"][1][0]).all(), "a pedestrian is no class of vehicle"
    assert found["labels"][0][0][2, 3] > found["none"][0][0][2, 3]
    assert json.loads((tmp_path / "labels.json").read_text())["settings"]["classes"] == "labels"
    for file, source in ((sample / "cars.json", "labels"), (sample / "named.json", "detected")):
        refused = run("reconstruct", file, "--classes", source)
        assert isinstance(refused.exception, InvalidInputError)
        assert refused.exception.field == "classes"


def test_boxes_of_vans_are_those_of_python(sample, tmp_path):
    image, camera = sample / "street.png", read_calibration(sample / "calib.txt").camera
    given = "reconstruct", image, "--calib", sample / "calib.txt", "--boxes", sample / "street.txt"
    refused = run(*given)
    assert "no car" in str(refused.exception) or "Van" in str(refused.exception)
    done = run(*given, "--classes", "labels", "--json", tmp_path / "a.json")
    assert done.exit_code == 0, done.output
    ((pose, prior),) = poses(tmp_path / "a.json")
    assert prior == "car14 of van"
    box = np.array((sample / "street.txt").read_text().split()[4:8], dtype=float)
    (same,) = fgrecon.reconstruct_image(
        image,
        camera,
        [box],
        classes=[VehicleClass("Van", "kitti")],
        options=fgrecon.Options(box=BoxOptions(model="cuboid")),
    )
    assert pose == pytest.approx(same.result.camera_T_object, abs=1e-9)
    done = run("batch", image, "--calib", sample / "calib.txt", "--boxes", sample / "street.txt", "--classes", "labels",
               "--out", tmp_path / "parts", "--table", tmp_path / "a.csv")  # fmt: skip
    assert done.exit_code == 0, done.output
    import pyarrow.csv as pc

    assert pc.read_csv(tmp_path / "a.csv").column("z").to_pylist() == pytest.approx([pose[2, 3]], abs=1e-6)


@pytest.mark.parametrize("source", ["detected", "keypoints"])
def test_what_networks_say_is_as_in_python(sample, tmp_path, source):
    image, camera = sample / "street.png", read_calibration(sample / "calib.txt").camera
    done = run(
        "reconstruct", image, "--calib", sample / "calib.txt", "--classes", source, "--json", tmp_path / "a.json"
    )
    assert done.exit_code == 0, done.output
    expected = [
        one.result for one in fgrecon.reconstruct_image(image, camera, classes=source) if one.result is not None
    ]
    found = poses(tmp_path / "a.json")
    assert len(found) == len(expected)
    for (pose, _), one in zip(found, expected, strict=True):
        assert pose == pytest.approx(one.camera_T_object, abs=1e-9)
    own = run("reconstruct", image, "--calib", sample / "calib.txt", "--classes", "labels")
    assert own.exception.field == "classes", "the detector labels nothing"


def test_a_batch_has_the_classes_of_its_keypoints(sample, tmp_path):
    import pyarrow.parquet as pq

    heights = {}
    for name, more in (("none", ()), ("labels", ("--classes", "labels")), ("keypoints", ("--classes", "keypoints"))):
        done = run("batch", sample / "named.json", *more, "--out", tmp_path / name)
        assert (done.exit_code == 0) == (name != "keypoints"), done.output
        heights[name] = pq.read_table(tmp_path / name).column("height").to_pylist()
    assert heights["labels"][0] > heights["none"][0]
    assert heights["labels"][1:] == heights["none"][1:]
    assert all(height is None for height in heights["keypoints"])


def test_a_run_knows_the_classes_of_its_tracks(tmp_path):
    from fgrecon.solve.tracker import Tracker
    from fgrecon.video import read_given
    from tests.video.streets import make_drive

    images, file = make_drive(tmp_path / "drive", 3)
    content = json.loads(file.read_text())
    for one in content["instances"]:
        one["kind"] = "Van" if one["track"] == 0 else "Car"
    file.write_text(json.dumps(content))
    given = "run", images, "--tracks", file, "--intrinsics", "721.5,721.5,609.6,172.9", "--fps", 10, "--online"
    done = run(*given, "--no-estimate-motion", "--classes", "labels", "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    frames = [json.loads(line) for line in (tmp_path / "out" / "frames.jsonl").read_text().splitlines()]
    tracker = Tracker(prior="car14", shared_ground=True)
    camera = fgrecon.Camera(np.array([[721.5, 0, 609.6], [0, 721.5, 172.9], [0, 0, 1]]), image_size=(1242, 375))
    for frame, sightings in zip(frames, read_given(file, load_category("car14")).vehicles.values(), strict=True):
        said = {one.identity: VehicleClass(one.kind, "kitti") for one in sightings}
        seen = {one.identity: one.observation.with_evidence([said[one.identity]]) for one in sightings}
        expected = tracker.update(frame["time"], seen, camera=camera)
        found = {one["id"]: np.array(one["result"]["camera_T_object"])[:3, 3] for one in frame["vehicles"]}
        assert found.keys() == expected.keys()
        for identity, one in expected.items():
            assert one.reconstruction.shape.prior == ("car14 of van" if identity == 0 else "car14")
            assert found[identity] == pytest.approx(one.reconstruction.location, abs=1e-6)
    for more in (("--classes", "keypoints"), ("--classes", "labels", "--tracks", cars_of(content, tmp_path))):
        refused = run(
            *given[:2], *given[4:], *(() if "--tracks" in more else given[2:4]), *more, "--out", tmp_path / "no"
        )
        assert isinstance(refused.exception, InvalidInputError)
        assert refused.exception.field == "classes"


def cars_of(content, folder):
    """The same without a kind."""
    bare = [{name: value for name, value in one.items() if name != "kind"} for one in content["instances"]]
    (folder / "bare.json").write_text(json.dumps({**content, "instances": bare}))
    return folder / "bare.json"
