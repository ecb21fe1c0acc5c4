"""Labelled boxes that are followed over time, on the made-up drive of single images and on copies of its image."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from fgrecon.evaluation.video_images import SYSTEM, score_drives
from fgrecon.evaluation.video_summary import document, summarise_boxes
from fgrecon.evaluation.video_tracks import BATCH, ONLINE, follow_boxes
from fgrecon.io.kitti_drives import read_drive
from tests.evaluation.test_video_images import folder, setup  # noqa: F401  # fixtures


def test_a_track_of_one_box_is_a_single_image(folder, setup, scene):  # noqa: F811
    setup, drives = replace(setup, together=False), [read_drive(folder)]
    boxes = score_drives(drives, {"drive": setup}, scene)
    followed = follow_boxes(boxes, drives, {"drive": setup})
    for box, before in zip(followed, boxes, strict=True):
        alone = before.outcomes[SYSTEM]
        for method in (ONLINE, BATCH):
            found = box.outcomes[method]
            assert (found.degrees, found.size, found.status) == (alone.degrees, alone.size, alone.status)
            assert found.metres == alone.metres
        assert box.outcomes[SYSTEM] == alone
    assert followed[2].outcomes[ONLINE].failure == "no estimate"


def test_several_images_and_how_much_errors_change(folder, setup, scene):  # noqa: F811
    lines = (folder / "label_02.txt").read_text().splitlines()
    for number in (1, 2, 6):
        shutil.copy(folder / "image_02" / "000000.png", folder / "image_02" / f"{number:06d}.png")
    (folder / "label_02.txt").write_text(
        "".join(f"{number} {line.split(maxsplit=1)[1]}\n" for number in (0, 1, 2, 6) for line in lines)
    )
    clean = json.loads((folder / "clean_tracks.json").read_text())
    (folder / "clean_tracks.json").write_text(json.dumps({name: [0, 1, 2, 6] for name in clean}))
    drives = [read_drive(folder)]
    boxes = follow_boxes(score_drives(drives, {"drive": setup}, scene), drives, {"drive": setup})
    first = [box for box in boxes if box.track == 0]
    assert len(first) == 4
    for method in (ONLINE, BATCH):
        assert max(box.outcomes[method].degrees for box in first) < 1.5
        assert max(box.outcomes[method].metres for box in first) < 0.2
    alone, online = (summarise_boxes(first, method) for method in (SYSTEM, ONLINE))
    assert alone.jitter_metres == pytest.approx(0.0, abs=1e-9)  # the images are one
    offs = [box.outcomes[ONLINE].off for box in first[:3]]  # the last comes too late to count
    assert online.jitter_metres == pytest.approx(np.linalg.norm(np.diff(offs, axis=0)[:, 1:], axis=1).mean())
    assert online.jitter_degrees == pytest.approx(np.abs(np.diff(offs, axis=0)[:, 0]).mean())
    assert alone.mean_absolute_size_error == pytest.approx(np.abs(first[0].outcomes[SYSTEM].size).mean())
    made = document(boxes, {}, [])
    assert list(made["methods"]) == [SYSTEM, ONLINE, BATCH]
    json.dumps(made, allow_nan=False)
