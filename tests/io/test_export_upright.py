"""MCAP has a frame in which z points up, whatever the world is: a parked car stands upright there."""

import io
import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from fgrecon.cli import main
from fgrecon.core.camera import Ground
from fgrecon.io.export import ImageInfo, NamedResult, export, read_results
from fgrecon.io.export.mcap import map_T_camera
from fgrecon.simulation import yaw_pose
from tests.results import changed
from tests.viz.made_up import make_example

PITCHED = Ground(np.array([0.02, np.cos(0.2), np.sin(0.2)]), 1.65)
"""The ground of a camera that looks down by 0.2 radians, and rolls a little."""


def parked(ground):
    """A car that stands on the ground, 12 metres ahead."""
    standing = np.eye(4)
    standing[:3, :3] = ground.upright
    level = yaw_pose(0.7, np.array([1.0, 0.0, 12.0]))
    level[1, 3] = ground.distance
    result = changed(make_example(0).reconstruction, camera_T_object=standing @ level)
    return NamedResult("a", result, None, image="a", ground=ground)


def frames_of(content):
    """Poses in the root frame, by the frame's name, of each image of Foxglove's messages; and its cars' boxes."""
    reader = pytest.importorskip("mcap.reader", reason="mcap is not installed: pip install fgrecon[mcap]")
    found = []
    for _, channel, message in reader.make_reader(io.BytesIO(content)).iter_messages():
        data = json.loads(message.data)
        if channel.topic == "/tf":
            assert {one["parent_frame_id"] for one in data["transforms"]} == {"map"}
            placed = {one["child_frame_id"]: pose(one["translation"], one["rotation"]) for one in data["transforms"]}
            found.append((placed, []))
        else:
            found[-1][1].extend((one["frame_id"], one["cubes"][0]["pose"]) for one in data["entities"])
    return found


def pose(position, orientation):
    made = np.eye(4)
    made[:3, :3] = Rotation.from_quat(list(orientation.values())).as_matrix()
    made[:3, 3] = list(position.values())
    return made


def stands_upright(content, height, image=0):
    """Whether the first car of an image has its up axis and its height over the ground in the root frame."""
    placed, cars = frames_of(content)[image]
    frame, box = cars[0]
    in_root = placed[frame] @ pose(**box)
    np.testing.assert_allclose(in_root[:3, 2], [0.0, 0.0, 1.0], atol=1e-6)
    assert in_root[2, 3] == pytest.approx(height / 2, abs=1e-6)
    return in_root


def test_a_parked_car_of_a_single_image_stands_on_the_ground(tmp_path):
    car = parked(PITCHED)
    content = export(tmp_path / "a.mcap", [car], "foxglove").read_bytes()
    place = stands_upright(content, car.result.box_size[2])
    assert place[0, 3] > 10.0, "x points ahead"
    assert place[1, 3] == pytest.approx(-1.0, abs=0.3), "y to the left"


def test_the_world_of_a_run_is_that_of_its_first_camera(tmp_path):
    """A camera that drives on: the same car, the same place in the root frame."""
    car, on = parked(PITCHED), np.eye(4)
    on[:3, 3] = PITCHED.upright @ [0.0, 0.0, 2.0]
    later = changed(car.result, camera_T_object=np.linalg.inv(on) @ car.result.camera_T_object)
    lost = NamedResult("c", car.result, image="c", ground=PITCHED)
    cars = [car, NamedResult("b", later, image="b", ground=PITCHED), lost]
    images = {
        "a": ImageInfo(timestamp=0.0, world_T_camera=np.eye(4)),
        "b": ImageInfo(timestamp=1.0, world_T_camera=on),
        "c": ImageInfo(timestamp=2.0),
    }
    content = export(tmp_path / "r.mcap", cars, "foxglove", images).read_bytes()
    height = car.result.box_size[2]
    first, second = (stands_upright(content, height, image) for image in range(2))
    np.testing.assert_allclose(first, second, atol=1e-9)
    placed = [frames for frames, _ in frames_of(content)]
    np.testing.assert_allclose(placed[1]["camera"][:3, 3], [2.0, 0.0, 1.65], atol=0.1)
    np.testing.assert_array_equal(placed[2]["camera"], placed[1]["camera"])  # where it was last


def test_a_world_that_is_upright_stays_as_it_is(tmp_path):
    car = parked(PITCHED)
    world = map_T_camera(PITCHED)
    world[:3, 3] += [700.0, -300.0, 20.0]
    content = export(tmp_path / "n.mcap", [car], "foxglove", {"*": ImageInfo(world_T_camera=world)}).read_bytes()
    ((placed, _),) = frames_of(content)
    np.testing.assert_allclose(placed["world"], np.eye(4), atol=1e-9)
    np.testing.assert_allclose(placed["camera"], world, atol=1e-9)


def test_a_camera_without_a_ground_is_level():
    expected = [[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
    np.testing.assert_array_equal(map_T_camera(None), expected)


def test_ros_2_has_the_same_frames(tmp_path):
    reader = pytest.importorskip("mcap_ros2.reader", reason="mcap-ros2-support is not installed")
    content = export(tmp_path / "r.mcap", [parked(PITCHED)], "vision_msgs").read_bytes()
    (message,) = (found.ros_msg for found in reader.read_ros2_messages(io.BytesIO(content), topics=["/tf"]))
    (one,) = message.transforms
    assert (one.header.frame_id, one.child_frame_id) == ("map", "camera")
    shift, turn = one.transform.translation, one.transform.rotation
    made = pose({"x": shift.x, "y": shift.y, "z": shift.z}, {"x": turn.x, "y": turn.y, "z": turn.z, "w": turn.w})
    np.testing.assert_allclose(made, map_T_camera(PITCHED), atol=1e-12)


@pytest.mark.parametrize("command", ["reconstruct", "batch"])
def test_the_ground_that_was_given_is_the_one(tmp_path, command):
    from tests.batch.support import instances

    def run(*arguments):
        done = CliRunner().invoke(main.app, [str(argument) for argument in arguments])
        assert done.exit_code == 0, done.output

    (file := tmp_path / "cars.json").write_text(json.dumps(instances(1)))
    out = ["--json", tmp_path / "r.json"] if command == "reconstruct" else ["--out", tmp_path / "r.json"]
    run(command, file, *out, "--ground=0,1,0.02,1.65")
    run("export", tmp_path / "r.json", tmp_path / "x.mcap", "--format", "foxglove")
    ((placed, _),) = frames_of((tmp_path / "x.mcap").read_bytes())
    np.testing.assert_allclose(placed["camera"], map_T_camera(Ground(np.array([0.0, 1.0, 0.02]), 1.65)), atol=1e-9)


def test_the_ground_that_the_cars_of_an_image_found_goes_before(tmp_path):
    from tests.cli.conftest import INTRINSICS
    from tests.solve.test_scene import street

    seen = street(5, count=4)[1]
    cars = [{"keypoints": one.keypoints.tolist(), "box": one.box.tolist(), "id": str(i)} for i, one in enumerate(seen)]
    (file := tmp_path / "cars.json").write_text(json.dumps(cars))
    options = [INTRINSICS, "--camera-height", "1.5", "--together", "--json", tmp_path / "r.json"]
    done = CliRunner().invoke(main.app, ["reconstruct", str(file), *map(str, options)])
    assert done.exit_code == 0, done.output
    (scene,) = json.loads((tmp_path / "r.json").read_text())["scenes"]
    grounds = {found.ground.distance for found in read_results(tmp_path / "r.json")}
    assert grounds == {scene["ground"]["distance"]} != {1.5}
