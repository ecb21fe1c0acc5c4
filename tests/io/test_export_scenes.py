"""Results for nuScenes, COCO, Foxglove and ROS 2, read back with their own readers where these are installed."""

from __future__ import annotations

import io
import json
from dataclasses import replace

import gtsam
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from jsonschema import Draft202012Validator
from typer.testing import CliRunner

from fgrecon.batch import read_folder
from fgrecon.cli import main
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.export import ImageInfo, NamedResult, export, read_images_file, read_results
from fgrecon.io.export.image_info import box_in, score
from fgrecon.io.export.mcap import pose_covariance
from fgrecon.io.images import write_png
from fgrecon.simulation import yaw_pose
from tests.results import changed
from tests.viz.made_up import make_example

WORLD = np.array([[0.0, 0.0, 1.0, 5.0], [-1.0, 0.0, 0.0, -3.0], [0.0, -1.0, 0.0, 1.65], [0.0, 0.0, 0.0, 1.0]])
"""A camera that looks along the world's x axis; z is up."""


def run(*arguments):
    done = CliRunner().invoke(main.app, [str(argument) for argument in arguments])
    assert done.exit_code == 0, done.output


@pytest.fixture(scope="module")
def cars():
    """Two cars of one image and one of another, seen by a known camera."""
    made = [make_example(seed) for seed in range(3)]
    boxes, names = (made[0].observation.box, None, None), ("a:0", "a:1", "b:0")
    return [
        NamedResult(name, one.reconstruction, box, image=name[0], camera=one.camera)
        for name, one, box in zip(names, made, boxes, strict=True)
    ]


@pytest.fixture(scope="module")
def images():
    return {
        "a": ImageInfo(sample_token="ta", image_id=17, timestamp=2.5, world_T_camera=WORLD),
        "b": ImageInfo(sample_token="tb", timestamp=3.25, world_T_camera=WORLD),
        "c": ImageInfo(sample_token="tc", world_T_camera=WORLD),
    }


def test_boxes_stand_on_the_ground_with_their_axes_forward_left_up():
    pose = yaw_pose(-np.pi / 2, np.array([1.0, 1.65, 10.0]))  # drives away from the camera, on the world's ground
    centre, axes = box_in(ImageInfo(world_T_camera=WORLD), pose, np.array([4.0, 1.8, 1.5]))
    np.testing.assert_allclose(centre, [15.0, -4.0, 0.75], atol=1e-12)
    np.testing.assert_allclose(axes, np.eye(3), atol=1e-12)
    centre, _ = box_in(ImageInfo(), pose, np.array([4.0, 1.8, 1.5]))
    np.testing.assert_allclose(centre, [1.0, 0.9, 10.0], atol=1e-12)


def test_nuscenes(cars, images, tmp_path):
    from scipy.spatial.transform import Rotation

    content = json.loads(export(tmp_path / "n.json", cars, "nuscenes", images).read_text())
    assert content["meta"]["use_camera"] is True
    assert {token: len(boxes) for token, boxes in content["results"].items()} == {"ta": 2, "tb": 1, "tc": 0}
    result, entry = cars[1].result, content["results"]["ta"][1]
    length, width, height = result.box_size
    assert entry["size"] == [width, length, height]
    w, x, y, z = entry["rotation"]
    axes = Rotation.from_quat([x, y, z, w]).as_matrix()
    forward = WORLD[:3, :3] @ result.camera_T_object[:3, 0]
    np.testing.assert_allclose(axes[:, 0], forward, atol=1e-9)
    assert axes[2, 2] == pytest.approx(1.0, abs=0.02), "upright"
    below = np.array(entry["translation"]) - axes[:, 2] * height / 2
    np.testing.assert_allclose(below, (WORLD @ result.camera_T_object)[:3, 3], atol=1e-9)
    assert entry["sample_token"] == "ta"
    assert entry["detection_score"] == score(cars[1])


def test_nuscenes_own_reader_takes_it(cars, images, tmp_path):
    devkit = pytest.importorskip("nuscenes.eval.detection.data_classes", reason="nuscenes-devkit is not installed")
    content = json.loads(export(tmp_path / "n.json", cars, "nuscenes", images).read_text())
    boxes = [devkit.DetectionBox.deserialize(entry) for entry in content["results"]["ta"]]
    assert [box.detection_name for box in boxes] == ["car", "car"]


@pytest.mark.parametrize("field", ["sample_token", "world_T_camera"])
def test_nuscenes_needs_to_know_the_images(cars, images, tmp_path, field):
    with pytest.raises(InvalidInputError) as caught:
        export(tmp_path / "n.json", cars, "nuscenes", images | {"b": replace(images["b"], **{field: None})})
    assert caught.value.field == f"images.b.{field}"
    assert not list(tmp_path.iterdir())


def test_coco(cars, images, tmp_path):
    numbered = images | {"b": replace(images["b"], image_id=18)}
    file = export(tmp_path / "c.json", cars, "coco", numbered)
    entries = json.loads(file.read_text())
    assert [entry["image_id"] for entry in entries] == [17, 17, 18]
    first, result = entries[0], cars[0].result
    points = np.reshape(first["keypoints"], (-1, 3))
    np.testing.assert_array_equal(points[:, :2], result.pose.wireframe_uv)
    np.testing.assert_array_equal(points[:, 2], np.where(result.diagnostics.visibility >= 0.5, 2, 1))
    x, y, width, height = first["bbox"]
    np.testing.assert_allclose([x, y, x + width, y + height], cars[0].box)
    corners = np.array(first["cuboid"]["corners"])
    inside = result.camera_T_object[:3, :3] @ [0, -result.box_size[2] / 2, 0] + result.location
    u, v = cars[0].camera.project(inside)
    assert corners[:, 0].min() < u < corners[:, 0].max()
    assert corners[:, 1].min() < v < corners[:, 1].max()


def test_coco_own_reader_takes_it(cars, images, tmp_path):
    coco = pytest.importorskip("pycocotools.coco", reason="pycocotools is not installed")
    file = export(tmp_path / "c.json", cars, "coco", images | {"b": replace(images["b"], image_id=18)})
    truth = coco.COCO()
    truth.dataset = {"images": [{"id": 17}, {"id": 18}], "categories": [{"id": 1, "name": "car"}], "annotations": []}
    truth.createIndex()
    loaded = truth.loadRes(str(file))
    assert len(loaded.getAnnIds(imgIds=[17])) == 2
    assert loaded.loadAnns(loaded.getAnnIds(imgIds=[18]))[0]["cuboid"]["size"] == cars[2].result.box_size.tolist()


def test_coco_without_knowing_anything(cars, tmp_path):
    bare = [replace(cars[0], image="000012", camera=None)]
    (entry,) = json.loads(export(tmp_path / "c.json", bare, "coco").read_text())
    assert entry["image_id"] == 12
    assert "corners" not in entry["cuboid"]


def test_foxglove(cars, images, tmp_path):
    reader = pytest.importorskip("mcap.reader", reason="mcap is not installed: pip install fgrecon[mcap]")
    content = export(tmp_path / "f.mcap", cars, "foxglove", images).read_bytes()
    found = list(reader.make_reader(io.BytesIO(content)).iter_messages("/fgrecon/scene"))
    assert [message.log_time for _, _, message in found] == [2_500_000_000, 3_250_000_000]
    schema, channel, message = found[0]
    assert (schema.name, schema.encoding) == ("foxglove.SceneUpdate", "jsonschema")
    assert (channel.topic, channel.message_encoding) == ("/fgrecon/scene", "json")
    update = json.loads(message.data)
    Draft202012Validator(json.loads(schema.data)).validate(update)
    near = update["entities"][0]
    assert [entity["id"] for entity in update["entities"]] == ["a:0", "a:1"]
    assert near["frame_id"] == "world"
    centre, _ = box_in(images["a"], cars[0].result.camera_T_object, cars[0].result.box_size)
    np.testing.assert_allclose(list(near["cubes"][0]["pose"]["position"].values()), centre)
    assert list(near["cubes"][0]["size"].values()) == cars[0].result.box_size.tolist()
    points = np.array([list(point.values()) for point in near["lines"][0]["points"]]).reshape(-1, 2, 3)
    pose = WORLD @ cars[0].result.camera_T_object
    edge = cars[0].result.wireframe[cars[0].result.shape.edges[3]] @ pose[:3, :3].T + pose[:3, 3]
    np.testing.assert_allclose(points[3], edge)


def test_an_image_without_a_vehicle_has_a_message_without_one(cars, images, tmp_path):
    reader = pytest.importorskip("mcap.reader", reason="mcap is not installed: pip install fgrecon[mcap]")
    known = {"folder/c.png": ImageInfo(timestamp=3.0), "d": ImageInfo(), **images}
    content = export(tmp_path / "f.mcap", cars, "foxglove", known).read_bytes()
    found = [message for _, _, message in reader.make_reader(io.BytesIO(content)).iter_messages("/fgrecon/scene")]
    assert [message.log_time for message in found] == [2_500_000_000, 3_000_000_000, 3_250_000_000]
    assert [len(json.loads(message.data)["entities"]) for message in found] == [2, 0, 1]
    assert len(json.loads(found[1].data)["deletions"]) == 1


def test_ros_2(cars, tmp_path):
    reader = pytest.importorskip("mcap_ros2.reader", reason="mcap-ros2-support is not installed")
    content = export(tmp_path / "r.mcap", cars, "vision_msgs").read_bytes()
    messages = reader.read_ros2_messages(io.BytesIO(content), topics=["/fgrecon/detections"])
    first, second = (found.ros_msg for found in messages)
    assert (second.header.stamp.sec, second.header.stamp.nanosec) == (0, 100_000_000)
    assert (first.header.frame_id, [found.id for found in first.detections]) == ("camera", ["a:0", "a:1"])
    result, detection = cars[0].result, first.detections[0]
    best, other = detection.results
    assert best.hypothesis.class_id == "car"
    assert best.hypothesis.score + other.hypothesis.score == pytest.approx(score(cars[0]))
    assert other.hypothesis.score < 1e-9, "99 nats worse"
    covariance = np.reshape(best.pose.covariance, (6, 6))
    np.testing.assert_allclose(covariance, pose_covariance(cars[0], ImageInfo()))
    size = detection.bbox.size
    assert [size.x, size.y, size.z] == result.box_size.tolist()
    place = other.pose.pose.position
    wanted, _ = box_in(ImageInfo(), result.uncertainty.alternatives[0].camera_T_object, result.box_size)
    np.testing.assert_allclose([place.x, place.y, place.z], wanted)


@pytest.mark.parametrize("placed", [False, True])
def test_the_covariance_is_that_of_centre_and_fixed_axes(cars, placed):
    """By differences: the centre and the turn of the box, as the pose moves along each of GTSAM's directions."""
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6))
    item = replace(cars[0], result=changed(cars[0].result, pose_covariance=root @ root.T))
    info = ImageInfo(world_T_camera=WORLD if placed else None)
    pose, size, step = gtsam.Pose3(item.result.camera_T_object), item.result.box_size, 1e-6
    centre, axes = box_in(info, pose.matrix(), size)
    columns = []
    for direction in np.eye(6):
        moved, turned = box_in(info, pose.retract(step * direction).matrix(), size)
        turn = gtsam.Rot3.Logmap(gtsam.Rot3(turned @ axes.T))
        columns.append(np.concatenate([moved - centre, turn]) / step)
    jacobian = np.array(columns).T
    wanted = jacobian @ item.result.uncertainty.pose_covariance @ jacobian.T
    np.testing.assert_allclose(pose_covariance(item, info), wanted, atol=1e-4)


def test_images_files(tmp_path):
    (file := tmp_path / "i.json").write_text(json.dumps({"*": {"timestamp": 3, "world_T_camera": WORLD.tolist()}}))
    read = read_images_file(file)["*"]
    assert (read.timestamp, read.sample_token) == (3.0, None)
    np.testing.assert_array_equal(read.world_T_camera, WORLD)
    for bad, field in (
        ({"a": {"world_T_camera": np.ones((4, 4)).tolist()}}, "a.world_T_camera"),
        ({"a": {"world_T_camera": np.diag([1.0, 1.0, -1.0, 1.0]).tolist()}}, "a.world_T_camera"),
        ({"a": {"sample_token": 3}}, "a.sample_token"),
        ({"a": {"image_id": [1]}}, "a.image_id"),
        ([], str(file)),
    ):
        file.write_text(json.dumps(bad))
        with pytest.raises(InvalidInputError) as caught:
            read_images_file(file)
        assert caught.value.field.endswith(field)


@pytest.mark.parametrize(("name", "kind"), [("x.json", None), ("x.mcap", None), ("x.ply", "coco"), ("x.json", "kitti")])
def test_a_kind_that_does_not_fit_is_refused(cars, tmp_path, name, kind):
    with pytest.raises(InvalidInputError, match="format"):
        export(tmp_path / name, cars, kind)


def test_the_folder_of_a_batch_is_exported_as_a_file_of_results_is(tmp_path):
    from tests.batch.support import instances, write_lines

    content = instances(2)
    lines = write_lines(tmp_path / "cars.jsonl", [*content, "{torn"])
    (tmp_path / "cars.json").write_text(json.dumps(content))
    run("batch", lines, "--out", tmp_path / "batch", "--size-prior", "kitti")
    run("reconstruct", tmp_path / "cars.json", "--size-prior", "kitti", "--json", tmp_path / "r.json")
    for results in (tmp_path / "batch", tmp_path / "r.json"):
        run("export", results, tmp_path / f"{results.stem}.ply")
        run("export", results, tmp_path / f"{results.stem}.txt")
    assert (tmp_path / "batch.txt").read_text() == (tmp_path / "r.txt").read_text()
    sizes = [(tmp_path / f"{name}.ply").stat().st_size for name in ("batch", "r")]
    assert sizes[0] == sizes[1] > 100_000, "surfaces are there"
    (tmp_path / "images.json").write_text(json.dumps({"*": {"image_id": 5}}))
    run("export", tmp_path / "batch", tmp_path / "c.json", "--format", "coco", "--images", tmp_path / "images.json")
    assert [entry["image_id"] for entry in json.loads((tmp_path / "c.json").read_text())] == [5, 5]
    assert [(found.image, found.row) for found in read_folder(tmp_path / "batch")] == [
        ("", f"{lines}#1"),
        ("", f"{lines}#2"),
    ], "their images are not given"
    (part,) = (tmp_path / "batch").glob("*.parquet")
    table = pq.read_table(part)
    ids = pa.array([f"{lines}#1:0", f"{lines}#2:0", None])  # as vehicles have that were found in images
    pq.write_table(table.set_column(table.column_names.index("id"), "id", ids), part)
    assert [found.image for found in read_folder(tmp_path / "batch")] == [f"{lines}#1", f"{lines}#2"]
    refused = CliRunner().invoke(main.app, ["export", str(tmp_path / "batch"), str(tmp_path / "x.txt")])
    assert "vehicles of 2 images" in str(refused.exception)
    other = CliRunner().invoke(main.app, ["export", str(tmp_path), str(tmp_path / "x.ply")])
    assert isinstance(other.exception, InvalidInputError)


@pytest.mark.parametrize(
    ("kind", "seconds"),
    [
        ("foxglove", -0.3),
        ("foxglove", 1532402927612460000),  # nanoseconds
        ("vision_msgs", -0.3),
        ("vision_msgs", 4102444800),  # of the year 2100, which ROS 2 cannot tell
        ("vision_msgs", float("nan")),
    ],
)
def test_times_that_mcap_cannot_tell_are_refused_before_anything_is_written(cars, images, tmp_path, kind, seconds):
    pytest.importorskip("mcap_ros2", reason="mcap-ros2-support is not installed")
    with pytest.raises(InvalidInputError, match="Give seconds") as caught:
        export(tmp_path / "f.mcap", cars, kind, images | {"b": replace(images["b"], timestamp=seconds)})
    assert caught.value.field == "images.b.timestamp"
    assert not list(tmp_path.iterdir())
    with pytest.raises(InvalidInputError) as caught:
        export(tmp_path / "f.mcap", [replace(cars[0], image="")], kind, {"*": ImageInfo(timestamp=seconds)})
    assert caught.value.field == "images.*.timestamp"


def test_the_last_times_that_mcap_can_tell(cars, tmp_path):
    pytest.importorskip("mcap_ros2", reason="mcap-ros2-support is not installed")
    for kind, seconds in (("foxglove", 4102444800.0), ("foxglove", 0.0), ("vision_msgs", 2.0**31 - 1e-6)):
        assert export(tmp_path / "f.mcap", cars, kind, {"*": ImageInfo(timestamp=seconds)}).stat().st_size > 0


def test_vehicles_of_one_id_are_entities_of_their_own(cars, tmp_path):
    reader = pytest.importorskip("mcap.reader", reason="mcap is not installed: pip install fgrecon[mcap]")
    twice = [replace(cars[0], name="a"), replace(cars[1], name="a")]
    content = export(tmp_path / "f.mcap", twice, "foxglove").read_bytes()
    ((_, _, message),) = reader.make_reader(io.BytesIO(content)).iter_messages("/fgrecon/scene")
    assert [entity["id"] for entity in json.loads(message.data)["entities"]] == ["a", "a-2"]


def images_of(folder, ids, *, scenes=(), **more):
    """The images that a results file of vehicles of these ids has."""
    result = make_example().reconstruction.to_dict(compact=True)
    entries = [
        {"id": name, "result": result} | {key: values[i] for key, values in more.items()} for i, name in enumerate(ids)
    ]
    content = {"format": "fgrecon.reconstructions/2", "instances": entries, "scenes": list(scenes)}
    (folder / "r.json").write_text(json.dumps(content))
    return [found.image for found in read_results(folder / "r.json")]


def test_what_tells_the_image_of_a_vehicle(tmp_path):
    assert images_of(tmp_path, ["a:0", "a:1", "b:x:0"]) == ["a", "a", "b:x"]
    assert images_of(tmp_path, ["lane1:a", "lane2:b", "c"]) == ["", "", ""], "an id that names none"
    assert images_of(tmp_path, ["lane1:a", ":b"]) == ["", ""]
    assert images_of(tmp_path, ["lane1:a", "lane2:b"], image=["a.png", "a.png"]) == ["a.png", "a.png"]
    assert images_of(tmp_path, ["lane1:a", "lane2:b"], image=["a.png", None]) == ["a.png", ""]
    together = {"image": None, "ground": None}
    assert images_of(tmp_path, ["lane1:a", "lane2:b"], scenes=[together]) == ["", ""], "solved as of one image"
    assert images_of(tmp_path, ["a:0", "b:0"], scenes=[together, together]) == ["a", "b"]


def test_results_tell_the_image_that_keypoints_give(tmp_path):
    """And so those of COCO's images, whose ids are numbers, are of several; those of a photograph are of one."""
    from tests.batch.support import instances

    named = [one | {"id": f"lane{n}:car", "image": f"{'aab'[n]}.png"} for n, one in enumerate(instances(3))]
    (tmp_path / "k.json").write_text(json.dumps(named))
    bare = [{key: value for key, value in one.items() if key != "image"} for one in named]
    (tmp_path / "bare.json").write_text(json.dumps(bare))
    write_png(tmp_path / "street.png", np.zeros((375, 1242, 3), np.uint8))
    found = {}
    for name, *more in (("k.json",), ("bare.json", "--image", tmp_path / "street.png")):
        run("reconstruct", tmp_path / name, "--size-prior", "kitti", "--json", tmp_path / "r.json", *more)
        run("export", tmp_path / "r.json", tmp_path / "c.json", "--format", "coco")
        found[name] = [entry["image_id"] for entry in json.loads((tmp_path / "c.json").read_text())]
    assert found == {"k.json": ["a.png", "a.png", "b.png"], "bare.json": ["street.png"] * 3}
