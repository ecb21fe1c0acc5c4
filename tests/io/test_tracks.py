"""The reader of tracks: frames, order of keypoints, and errors that name file, frame and field."""

import json

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.track_file import parse_track, read_track
from tests.made_up_track import T2, K


def spoil(content, path, value):
    """Set one field of the content, or remove it where the value is `del`."""
    *way, last = path
    for key in way:
        content = content[key]
    if value is del_:
        del content[last]
    else:
        content[last] = value


del_ = object()


def test_a_track_as_written(content, scene, tmp_path):
    file = tmp_path / "seq1.json"
    file.write_text(json.dumps(content))
    track = read_track(file, scene.prior.category)
    assert track.name == "seq1"
    assert [frame.name for frame in track.frames] == ["seq1:40", "seq1:41", "seq1:42"]
    assert track.camera.matrix.tolist() == K.tolist()
    assert track.camera.image_size is None
    assert track.label_offset == pytest.approx(T2)
    frame = track.frames[1]
    assert frame.observation.keypoints.tolist() == content["frames"][1]["keypoints_uv"]
    assert frame.observation.box.tolist() == content["frames"][1]["box_xyxy"]
    assert frame.truth.location.tolist() == [1.5, 1.65, 10.0]
    assert frame.truth.rotation_y == 1.9


def test_keypoints_are_brought_into_the_categorys_order(content, scene):
    straight = parse_track(json.loads(json.dumps(content)), "t", scene.prior.category)
    content["keypoint_names"].reverse()
    for frame in content["frames"]:
        frame["keypoints_uv"].reverse()
        frame["confidence"][0] = 0.1
        frame["confidence"].reverse()
    turned = parse_track(content, "t", scene.prior.category)
    for a, b in zip(straight.frames, turned.frames, strict=True):
        assert np.array_equal(a.observation.keypoints, b.observation.keypoints)
        assert b.observation.confidence[13] == 0.9
        assert b.observation.confidence[0] == 0.1


def test_null_means_not_measured(content, scene):
    content["frames"][0]["keypoints_uv"][3] = [None, None]
    content["frames"][1]["keypoints_uv"] = [[None, None]] * 14
    track = parse_track(content, "t", scene.prior.category)
    assert np.flatnonzero(~track.frames[0].observation.measured).tolist() == [3]
    assert track.frames[0].observation.confidence[3] == 0.0
    assert track.frames[1].observation is None
    assert len(track.frames) == 3


@pytest.mark.parametrize(
    ("path", "value", "field"),
    [
        (["K"], del_, "K"),
        (["K"], [[700.0, 0, 600], [0, 700, 180]], "K"),
        (["K", 0, 0], "700", "K[0][0]"),
        (["K", 0, 1], True, "K[0][1]"),
        (["P2"], np.zeros((3, 4)).tolist(), "P2"),
        (["keypoint_names", 0], "nose", "keypoint_names"),
        (["frames"], [], "frames"),
        (["frames"], {}, "frames"),
        (["frames", 1], 7, "frames[1]"),
        (["frames", 1, "frame"], del_, "frames[1].frame"),
        (["frames", 1, "keypoints_uv"], del_, "frame 41: keypoints_uv"),
        (["frames", 1, "keypoints_uv", 13], del_, "frame 41: keypoints_uv"),
        (["frames", 1, "keypoints_uv", 2, 1], float("nan"), "frame 41: keypoints_uv[2][1]"),
        (["frames", 1, "keypoints_uv", 2, 1], "NaN", "frame 41: keypoints_uv[2][1]"),
        (["frames", 1, "keypoints_uv", 2, 1], 10**400, "frame 41: keypoints_uv[2][1]"),
        (["frames", 1, "keypoints_uv", 2], [1.0], "frame 41: keypoints_uv[2]"),
        (["frames", 1, "confidence", 5], 1.5, "frame 41: confidence"),
        (["frames", 1, "confidence", 5], None, "frame 41: confidence"),
        (["frames", 1, "confidence"], [0.5] * 13, "frame 41: confidence"),
        (["frames", 1, "box_xyxy"], [5.0, 5.0, 5.0, 9.0], "frame 41: box_xyxy"),
        (["frames", 1, "box_xyxy", 0], None, "frame 41: box_xyxy[0]"),
        (["frames", 1, "gt"], None, "frame 41: gt"),
        (["frames", 1, "gt", "rotation_y"], del_, "frame 41: gt.rotation_y"),
        (["frames", 1, "gt", "location", 2], float("inf"), "frame 41: gt.location[2]"),
    ],
)
def test_a_malformed_file_names_file_frame_and_field(content, scene, tmp_path, path, value, field):
    spoil(content, path, value)
    file = tmp_path / "bad.json"
    file.write_text(json.dumps(content))
    with pytest.raises(InvalidInputError) as error:
        read_track(file, scene.prior.category)
    assert error.value.field == f"{file}: {field}"


@pytest.mark.parametrize(
    "text", [b"", b"{", b"[1]", b"\xff\xfe", b"[" * 100_000], ids=["", "{", "[1]", "bytes", "deep"]
)
def test_what_is_no_track_is_refused(scene, tmp_path, text):
    file = tmp_path / "bad.json"
    file.write_bytes(text)
    with pytest.raises(InvalidInputError, match=r"bad\.json"):
        read_track(file, scene.prior.category)


def test_a_missing_file_is_refused(scene, tmp_path):
    with pytest.raises(InvalidInputError, match="No such file"):
        read_track(tmp_path / "none.json", scene.prior.category)


@pytest.mark.data
def test_the_real_tracks(data, scene):
    files = sorted((data / "kitti_tracking_keypoints14").glob("*.json"))
    tracks = [read_track(file, scene.prior.category) for file in files]
    assert sum(len(track.frames) for track in tracks) == 76
    for track in tracks:
        assert 0.05 < np.linalg.norm(track.label_offset) < 0.07  # t2 of KITTI's colour camera: about 6 cm
        for frame in track.frames:
            # what the labelled pose projects to lies in the box: the two describe the same car
            pixel = track.camera.project(frame.truth.location + track.label_offset - [0, 0.75, 0])
            box = frame.observation.box
            assert (box[:2] <= pixel).all()
            assert (pixel <= box[2:]).all()
