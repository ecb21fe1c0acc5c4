"""Warnings about keypoints that are surely not what they are taken for, by what commands have."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from fgrecon.cli.reconstruct_work import Outcome, Task
from fgrecon.core.camera import Camera
from fgrecon.core.doubts import Doubts, doubt_of, hardly_fits
from fgrecon.core.errors import FgreconError
from fgrecon.core.observation import Observation

if TYPE_CHECKING:  # who solves a keypoint file needs nothing of videos
    from fgrecon.video.follow import TrackedFrame

__all__ = ["about_fits", "about_keypoints", "about_video"]


def about_keypoints(tasks: Sequence[Task]) -> list[str]:
    """What to warn of before vehicles are solved: keypoints in other units, or not where the vehicle is."""
    found = Doubts()
    for task in tasks:
        if (seen := _seen(task)) is not None:
            found.add(task.instance.name, doubt_of(seen, task.camera))
    return found.lines()


def about_fits(outcomes: Sequence[Outcome]) -> list[str]:
    """What to warn of once they are solved: in most of the vehicles hardly a keypoint fits."""
    found = Doubts()
    for outcome in outcomes:
        seen = _seen(outcome.task)
        if outcome.result is not None and seen is not None:
            found.add_fit(outcome.name, hardly=hardly_fits(seen, outcome.result.weights))
    return found.lines()


def about_video(frames: Sequence[TrackedFrame], camera: Camera) -> list[str]:
    """What to warn of the keypoints that were given for a video."""
    found = Doubts()
    for frame in frames:
        for identity, seen in frame.observations.items():
            name = f"{identity} in {frame.name}"
            found.add(name, doubt_of(seen, camera))
            if (estimate := frame.estimates.get(identity)) is not None:
                found.add_fit(name, hardly=hardly_fits(seen, estimate.reconstruction.weights))
    return found.lines()


def _seen(task: Task) -> Observation | None:
    """What was observed; None where its numbers cannot be used, which the solver says."""
    try:
        return task.instance.observation
    except FgreconError:
        return None
