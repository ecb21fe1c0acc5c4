"""Frames of a run for other programs: what an images file tells beside them, and lines that cannot be read."""

from __future__ import annotations

import json

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.export import ImageInfo, export, read_video_frames
from tests.viz.made_up import make_example

NAMES = tuple(f"{number:06d}.png" for number in (3, 4, 5))


def frames(*, first=0.3):
    """A run of three frames, with a car in the second."""
    example = make_example()
    box = [float(edge) for edge in example.observation.box]
    vehicle = {"id": 7, "box": box, "result": example.reconstruction.to_dict(compact=True)}
    lines = [
        {
            "format": "fgrecon.video-frame/1",
            "name": name,
            "time": first + number / 10,
            "world_T_camera": np.eye(4).tolist(),
            "vehicles": [vehicle] if number == 1 else [],
        }
        for number, name in enumerate(NAMES)
    ]
    return "".join(json.dumps(line, ensure_ascii=False) + "\n" for line in lines)


def test_samples_that_are_no_frame_are_in_nuscenes_results_as_well(tmp_path):
    (file := tmp_path / "frames.jsonl").write_text(frames())
    given = {name.removesuffix(".png"): ImageInfo(sample_token=name) for name in (*NAMES, "000099.png")}
    results, infos = read_video_frames(file, given | {"*": ImageInfo(sample_token="other")})
    assert list(infos) == [*NAMES, "000099"]
    found = json.loads(export(tmp_path / "n.json", results, "nuscenes", infos).read_text())["results"]
    assert {token: len(boxes) for token, boxes in found.items()} == {
        "000003.png": 0,
        "000004.png": 1,
        "000005.png": 0,
        "000099.png": 0,
    }


def test_a_run_of_negative_times_has_no_messages(tmp_path):
    pytest.importorskip("mcap", reason="mcap is not installed: pip install fgrecon[mcap]")
    (file := tmp_path / "frames.jsonl").write_text(frames(first=-0.3))
    results, infos = read_video_frames(file)
    with pytest.raises(InvalidInputError, match="--images") as caught:
        export(tmp_path / "f.mcap", results, "foxglove", infos)
    assert caught.value.field == "images.000004.png.timestamp", "the first that has vehicles"
    results, infos = read_video_frames(file, {name: ImageInfo(timestamp=float(i)) for i, name in enumerate(NAMES)})
    assert export(tmp_path / "f.mcap", results, "foxglove", infos).is_file()


@pytest.mark.parametrize(("encoding", "line"), [("latin-1", 2), ("utf-16", 1)])
def test_frames_that_are_not_utf_8_are_named(tmp_path, encoding, line):
    (file := tmp_path / "frames.jsonl").write_text(frames().replace("000004.png", "café.png"), encoding)
    with pytest.raises(InvalidInputError, match=rf"frames\.jsonl: line {line}: got malformed"):
        read_video_frames(file)
