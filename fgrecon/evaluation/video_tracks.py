"""Labelled boxes of video drives over time: the keypoints that single images gave, followed by their labelled ids.

`ONLINE` is what `fgrecon.Tracker` says after each frame, by that one and those before; `BATCH` what it says at the end,
by all. Both get what the single images got, and nothing else: the camera's own motion is not given.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import groupby

from fgrecon.core.metrics import FAILURE_DEGREES
from fgrecon.core.vehicle_estimate import VehicleEstimate
from fgrecon.evaluation.kitti_images import Setup
from fgrecon.evaluation.video_images import BoxOutcome, VideoBox, outcome
from fgrecon.io.kitti_drives import Drive
from fgrecon.io.track_file import GroundTruth
from fgrecon.solve.tracker import Tracker

__all__ = ["BATCH", "ONLINE", "follow_boxes"]

ONLINE = "online"
"""Each frame by itself and those before."""
BATCH = "batch"
"""Each frame by all."""

_RATE = 10.0  # images of KITTI's drives in a second


def follow_boxes(boxes: Sequence[VideoBox], drives: Sequence[Drive], setups: Mapping[str, Setup]) -> list[VideoBox]:
    """The boxes with outcomes of `ONLINE` and `BATCH` beside those that they have.

    Args:
        boxes: Those of `fgrecon.evaluation.video_images.score_drives`, in its order.
        drives: The drives that they are of.
        setups: What each drive is reconstructed with, by its name.
    """
    found: list[VideoBox] = []
    for drive in drives:
        found += _follow([box for box in boxes if box.drive == drive.name], drive, setups[drive.name])
    return found


def _follow(boxes: Sequence[VideoBox], drive: Drive, setup: Setup) -> list[VideoBox]:
    tracker = Tracker(
        prior=setup.prior, size_prior=setup.size_prior, options=setup.options, shared_ground=setup.together, past=None
    )
    frames = {frame.number: frame for frame in drive.frames}
    online: dict[tuple[int, int], VehicleEstimate] = {}
    for number, some in groupby(boxes, key=lambda box: box.frame):
        camera = frames[number].calibration.camera
        seen = {box.track: box.observation for box in some if box.observation is not None}
        estimates = tracker.update(number / _RATE, seen, camera=camera, ground=setup.ground)
        online |= {(number, track): estimate for track, estimate in estimates.items()}
    times = {key: estimate.time for key, estimate in online.items()}
    smoothed = {(track, one.time): one for track, past in tracker.smooth().items() for one in past}
    batch = {key: smoothed.get((key[1], time)) for key, time in times.items()}
    scored = []
    for box in boxes:
        objects, key = frames[box.frame].objects, (box.frame, box.track)
        truth = GroundTruth(objects.location[box.index], float(objects.rotation_y[box.index]))
        size, offset = objects.size[box.index], frames[box.frame].calibration.label_offset
        both: dict[str, BoxOutcome] = {}
        for name, estimate in ((ONLINE, online.get(key)), (BATCH, batch.get(key))):
            if estimate is None:
                both[name] = BoxOutcome(FAILURE_DEGREES, float("inf"), None, None, "no estimate")
            else:
                both[name] = outcome(estimate.reconstruction, truth, size, offset)
        scored.append(replace(box, outcomes={**box.outcomes, **both}))
    return scored
