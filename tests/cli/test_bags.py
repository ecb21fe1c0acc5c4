"""`fgrecon run` on a bag, and its results in a copy of it, read back by rosbags and by mcap's own readers."""

import json

import cv2
import numpy as np
import pytest

pytest.importorskip("rosbags")
pytest.importorskip("torch")
pytest.importorskip("mcap_ros2")

from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin
from scipy.spatial.transform import Rotation

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.export import ImageInfo, read_video_frames
from fgrecon.io.export.image_info import box_in
from fgrecon.io.export.mcap import pose_covariance
from fgrecon.simulation.vehicles import KITTI_CAMERA
from tests.command_line import run
from tests.io import bags

INFO = ImageInfo()
OURS = "/fgrecon/detections", "/fgrecon/markers", "/fgrecon/scene"


def messages(folder, frame="camera_optical"):
    """The sample's street, seen twice by a body that stands still, and the points of its LiDAR."""
    street = cv2.imread(str(folder / "street.png"))[..., ::-1]
    size = street.shape[1], street.shape[0]
    k = KITTI_CAMERA.matrix.ravel()
    still = [*bags.rig(bags.START), bags.transform(bags.START, "odom", "base_link", np.zeros(3))]
    yield "/tf_static", bags.START, bags.T.TFMessage(transforms=still)
    yield "/camera/camera_info", bags.START, bags.camera_info(bags.START, size, k=k)
    points = np.load(folder / "street.npz")["points"]
    body = bags.OPTICAL.apply(points) + bags.MOUNT - bags.LIDAR
    for i in range(2):
        time = bags.START + i * bags.PERIOD
        yield "/odom", time + 5, bags.odometry(time, np.zeros(3))
        yield "/camera/image_raw", time + 7, bags.image(street, time, frame=frame)
        yield "/points", time + 9, bags.cloud(body, time + 1)


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bags") / "sample"
    assert run("sample", "--out", folder, "-q").exit_code == 0
    return folder


@pytest.fixture(scope="module")
def bag(sample):
    return bags.write(sample.parent / "drive", messages(sample))


@pytest.fixture(scope="module")
def followed(bag, tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "out"
    done = run("run", bag, "--out", out, "--camera-height", "1.65", "-q")
    assert done.exit_code == 0, done.output
    return out


def frames(folder):
    return [json.loads(line) for line in (folder / "frames.jsonl").read_text().splitlines()]


def test_a_run_takes_pictures_times_camera_and_poses_from_the_bag(bag, followed):
    found = frames(followed)
    assert [frame["name"] for frame in found] == [f"{bag.name}#0", f"{bag.name}#1"]
    assert [frame["time"] for frame in found] == pytest.approx([(bags.START + i * bags.PERIOD) / 1e9 for i in range(2)])
    pose = np.array(found[1]["world_T_camera"])
    assert np.allclose(pose[:3, :3], bags.OPTICAL.as_matrix())
    assert np.allclose(pose[:3, 3], bags.MOUNT)
    assert len(found[1]["vehicles"]) == 3
    assert {round(car["speed"]) for car in found[1]["vehicles"]} == {0}


def test_the_lidar_of_the_bag_says_where_the_cars_are(bag, sample, followed, tmp_path):
    from fgrecon.core.size_prior import size_prior
    from fgrecon.io.catalogue import load_prior
    from fgrecon.simulation.sample import sample_street

    out = tmp_path / "out"
    done = run("run", bag, "--out", out, "--lidar", "/points", "--poses", "/odom", "--camera-height", "1.65", "-q")
    assert done.exit_code == 0, done.output
    street = sample_street(load_prior("car14").for_fleet(size_prior("kitti")))
    truth = [car.truth.camera_T_object[:3, 3] for car in street.cars]
    errors = {}
    for name, folder in (("alone", followed), ("lidar", out)):
        places = [np.array(car["result"]["camera_T_object"])[:3, 3] for car in frames(folder)[1]["vehicles"]]
        errors[name] = [min(np.linalg.norm(place - one) for one in truth) for place in places]
    assert max(errors["lidar"]) < 0.25 < np.mean(errors["alone"])


def test_what_does_not_fit_is_refused(bag, sample, tmp_path):
    for arguments, words in (
        (("--lidar", "/cloud"), r"Name a topic of points: /points"),
        (("--poses", "/gps"), r"Name a topic of odometry, or a frame of TF"),
        (("--fps", "5"), r"has the times"),
    ):
        refused = run("run", bag, "--out", tmp_path / "out", *arguments)
        assert isinstance(refused.exception, InvalidInputError)
        assert words in str(refused.exception)
    refused = run("run", f"{bag}#/odom", "--out", tmp_path / "out")
    assert "Name a topic of pictures: /camera/image_raw" in str(refused.exception)
    refused = run("run", sample / "drive", "--out", tmp_path / "out", "--lidar", "/points")
    assert isinstance(refused.exception, InvalidInputError)


def decoded(path):
    """Topic, time of recording and message of all messages of an MCAP, by mcap's own readers."""
    with path.open("rb") as content:
        reader = make_reader(content, decoder_factories=[DecoderFactory()])
        return [(c.topic, m.log_time, d) for _, c, m, d in reader.iter_decoded_messages()]


@pytest.fixture(scope="module")
def copied(bag, followed):
    out = followed.parent / "with.mcap"
    done = run("export", followed, out, "--format", "ros2", "--images", bag)
    assert done.exit_code == 0, done.output
    return out


def test_a_copy_has_all_that_was_there_and_ours_beside_it(bag, copied):
    before, after = decoded(bag), decoded(copied)
    kept = [(topic, time) for topic, time, _ in after if topic not in OURS]
    assert kept == [(topic, time) for topic, time, _ in before]
    assert [topic for topic, _, _ in after if topic in OURS] == list(OURS) * 2
    with bag.open("rb") as one, copied.open("rb") as other:
        contents = [
            [m.data for _, c, m in make_reader(content).iter_messages() if c.topic not in OURS]
            for content in (one, other)
        ]
    assert contents[0] == contents[1]


@pytest.mark.parametrize("library", ["rosbags", "mcap"])
def test_messages_are_read_back(copied, followed, library):
    if library == "rosbags":
        with AnyReader([copied]) as reader:
            found = [(c.topic, time, reader.deserialize(data, c.msgtype)) for c, time, data in reader.messages()]
    else:
        found = decoded(copied)
    results, _ = read_video_frames(followed / "frames.jsonl")
    last = {topic: message for topic, _, message in found if topic in OURS}
    detections, markers, scene = (last[topic] for topic in OURS)
    assert (detections.header.stamp.sec, detections.header.stamp.nanosec) == divmod(bags.START + bags.PERIOD, 10**9)
    assert detections.header.frame_id == "camera_optical"
    mine = [item for item in results if item.image.endswith("#1")]
    assert [one.id for one in detections.detections] == [item.name for item in mine]
    for one, item in zip(detections.detections, mine, strict=True):
        pose, size = item.result.camera_T_object, item.result.box_size
        hypotheses = 1 + len(item.result.uncertainty.alternatives)
        assert len(one.results) == hypotheses
        place, turn = one.bbox.center.position, one.bbox.center.orientation
        centre, axes = box_in(INFO, pose, size)
        assert np.allclose([place.x, place.y, place.z], centre)
        assert np.allclose(Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix(), axes)
        assert np.allclose([one.bbox.size.x, one.bbox.size.y, one.bbox.size.z], size)
        covariance = np.reshape(one.results[0].pose.covariance, (6, 6))
        assert np.allclose(covariance, pose_covariance(item, INFO))
    kinds = [(marker.ns, marker.type, marker.action) for marker in markers.markers]
    assert kinds == [("", 0, 3), *[("box", 1, 0), ("wireframe", 5, 0), ("name", 9, 0)] * len(mine)]
    assert {marker.header.frame_id for marker in markers.markers} == {"camera_optical"}
    entities = scene.entities
    assert [entity.id for entity in entities] == [item.name for item in mine]
    assert len(scene.deletions) == 1
    box, cube = markers.markers[1], entities[0].cubes[0]
    assert box.pose.position.x == cube.pose.position.x == detections.detections[0].bbox.center.position.x
    assert box.scale.x == cube.size.x
    assert len(markers.markers[2].points) == len(entities[0].lines[0].points) > 20


def test_a_bag_of_sqlite_whose_camera_has_axes_of_a_body(sample, tmp_path):
    bag = bags.write(tmp_path / "drive", messages(sample, frame="camera"), StoragePlugin.SQLITE3)
    done = run("run", bag, "--out", tmp_path / "out", "--camera-height", "1.65")
    assert done.exit_code == 0, done.output
    assert "z up" in done.output
    done = run("export", tmp_path / "out", tmp_path / "c.mcap", "--format", "ros2", "--images", bag)
    assert done.exit_code == 0, done.output
    found = decoded(tmp_path / "c.mcap")
    assert len(found) == 8 + 6
    detections = next(message for topic, _, message in found if topic == OURS[0])
    assert detections.header.frame_id == "camera"
    places = [one.bbox.center.position for one in detections.detections]
    assert all(place.x > 5.0 and abs(place.z + 1.65) < 1.3 for place in places), "x ahead, z up"


def test_topics_that_are_no_messages_of_ros_are_kept(bag, followed, tmp_path):
    """By a copy of MCAP alone: what is JSON, what has no schema, attachments and metadata."""
    other = tmp_path / bag.name
    with other.open("wb") as sink, bag.open("rb") as content:
        writer, ids = Writer(sink), {}
        writer.start(profile="ros2", library="test")
        for schema, channel, message in make_reader(content).iter_messages():
            if channel.topic not in ids:
                made = writer.register_schema(schema.name, schema.encoding, schema.data)
                ids[channel.topic] = writer.register_channel(channel.topic, "cdr", made, {"x": "y"})
            writer.add_message(ids[channel.topic], message.log_time, message.data, message.publish_time - 3, 7)
        writer.add_attachment(1, 2, "a.txt", "text/plain", b"hello")
        writer.add_metadata("who", {"name": "nobody"})
        writer.finish()
    out = tmp_path / "out.mcap"
    done = run("export", followed, out, "--format", "ros2", "--images", other)
    assert done.exit_code == 0, done.output
    with out.open("rb") as content:
        reader = make_reader(content)
        (attachment,), (metadata,) = list(reader.iter_attachments()), list(reader.iter_metadata())
        image = next((c, m) for _, c, m in reader.iter_messages() if c.topic == "/camera/image_raw")
    assert (attachment.data, metadata.metadata) == (b"hello", {"name": "nobody"})
    assert image[0].metadata == {"x": "y"}
    assert (image[1].log_time - image[1].publish_time, image[1].sequence) == (3, 7)


def test_copies_that_cannot_be_made_are_refused(bag, followed, tmp_path):
    other = tmp_path / "other.mcap"
    other.write_bytes(bag.read_bytes())
    refused = run("export", followed, tmp_path / "x.mcap", "--format", "ros2", "--images", other)
    assert "has no such image" in str(refused.exception)
    assert not (tmp_path / "x.mcap").exists()


def test_without_a_bag_it_is_a_file_of_its_own(followed, tmp_path):
    done = run("export", followed, tmp_path / "new.mcap", "--format", "ros2")
    assert done.exit_code == 0, done.output
    found = decoded(tmp_path / "new.mcap")
    assert [topic for topic, _, _ in found] == ["/tf", *OURS] * 2
    assert found[1][2].header.frame_id == "world"
    with AnyReader([tmp_path / "new.mcap"]) as reader:
        assert len([reader.deserialize(data, c.msgtype) for c, _, data in reader.messages()]) == 8
