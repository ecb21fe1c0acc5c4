"""Foxglove's messages in JSON; `tests/formats/test_foxglove.py` has those that its own schemas made."""

import base64
import json

import cv2
import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.bag_drive import open_bag_drive

pytest.importorskip("rosbags")
mcap = pytest.importorskip("mcap.writer")

TIME = {"sec": 1_700_000_000, "nsec": 250_000_000}
CALIBRATION = {
    "timestamp": TIME,
    "frame_id": "camera",
    "width": 64,
    "height": 48,
    "distortion_model": "plumb_bob",
    "D": [],
    "K": [50, 0, 31.5, 0, 51, 23.5, 0, 0, 1],
}


def write(path, *messages):
    with path.open("wb") as file:
        writer = mcap.Writer(file)
        writer.start()
        for topic, schema, content in messages:
            known = writer.register_schema(schema, "jsonschema", b"{}")
            channel = writer.register_channel(topic, "json", known)
            writer.add_message(channel, 10, json.dumps(content).encode(), 10)
        writer.finish()
    return path


def image():
    content = cv2.imencode(".png", np.full((48, 64, 3), 7, np.uint8))[1].tobytes()
    return {"timestamp": TIME, "frame_id": "camera", "format": "png", "data": base64.b64encode(content).decode()}


def bag(path, calibration=CALIBRATION, **changed):
    return write(
        path,
        ("/camera/calibration", "foxglove.CameraCalibration", calibration),
        ("/camera/image", "foxglove.CompressedImage", image() | changed),
        ("/note", "own.Note", {"text": "not read"}),
    )


def test_a_picture_and_its_camera(tmp_path):
    drive = open_bag_drive(bag(tmp_path / "a.mcap"))
    (frame,) = drive.frames.read()
    assert frame.time == pytest.approx(1_700_000_000.25)
    assert (frame.image == 7).all()
    assert drive.camera.matrix[0].tolist() == [50.0, 0.0, 31.5]
    assert drive.camera.image_size == (64, 48)


@pytest.mark.parametrize(
    "changed",
    [
        {"timestamp": None},
        {"timestamp": {"sec": "now", "nsec": 0}},
        {"frame_id": 3},
        {"calibration": {**CALIBRATION, "K": ["wide"]}},
        {"calibration": {"timestamp": TIME, "frame_id": "camera"}},
    ],
)
def test_a_malformed_message_is_named(tmp_path, changed):
    with pytest.raises(InvalidInputError, match=r"a.mcap: /camera/(image|calibration)"):
        _ = open_bag_drive(bag(tmp_path / "a.mcap", **changed)).camera


def test_data_that_is_no_picture_is_a_gap(tmp_path):
    (frame,) = open_bag_drive(bag(tmp_path / "a.mcap", data="AAAA")).frames.read()
    assert frame.image is None
