"""Check that what is given by frame, the camera's poses and the vehicles, is of frames that there are."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Collection, Sequence

import numpy as np

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.text import counted
from fgrecon.io.frames import FrameSource, ImageFrames
from fgrecon.io.poses import CameraPoses
from fgrecon.io.video_frames import VideoFrames, packet_times

Moments = Sequence[tuple[int, float]]
"""Number and time (seconds) of each frame."""


def planned_frames(source: FrameSource) -> Moments | None:
    """The frames that are taken of a source, before one is decoded; None where that is not known exactly.

    Numbers of a video's frames are those of its packets: no frame has a larger one.
    """
    if not isinstance(source, VideoFrames):
        return list(zip(source.numbers, source.times, strict=True))
    times = sorted(packet_times(source.path))
    if not times or np.isnan(times).any():
        return None
    passed = [time - times[0] for time in times]
    choice = source.choice
    return [(n, times[n]) for n, p in enumerate(passed) if choice.takes(n, p) and not choice.ends(p)]


def check_coverage(frames: Moments, poses: CameraPoses | None, vehicles: Collection[int] | None) -> None:
    """Refuse what is given by frame where nothing of it is of a frame.

    Args:
        vehicles: Numbers of the frames that vehicles are given for, or None.
    """
    if not frames:
        return
    numbers = [number for number, _ in frames]
    if poses is not None and poses and all(poses.at(*frame) is None for frame in frames):
        raise InvalidInputError("poses", f"poses of {poses.span}", f"Give poses of the frames, {_span(frames, poses)}.")
    if vehicles is not None and vehicles and set(vehicles).isdisjoint(numbers):
        fix = f"Give vehicles of the frames, {min(numbers)} to {max(numbers)}."
        raise InvalidInputError("tracks", f"vehicles in frames {min(vehicles)} to {max(vehicles)}", fix)


def coverage_warnings(
    frames: Moments, source: FrameSource, poses: CameraPoses | None, vehicles: Collection[int] | None
) -> list[str]:
    """What to warn of after all frames were read: frames without a pose, vehicles in frames that are none.

    Args:
        source: What they come from: vehicles in frames that were not chosen of it are as they should be.
        vehicles: Numbers of the frames that vehicles are given for, or None.
    """
    if not frames:
        return []
    lines, numbers = [], [number for number, _ in frames]
    if poses is not None and poses and (without := sum(poses.at(*frame) is None for frame in frames)):
        spans = f"the poses are of {poses.span}, the frames {_span(frames, poses)}"
        verb = "has" if without == 1 else "have"
        hint = "" if poses.times else _hint(poses.by_frame, numbers)
        count = f"{without} of {counted(len(frames), 'frame')} {verb} no pose of the camera"
        lines.append(f"{count}: {spans}.{hint} Vehicles have no speed there.")
    strangers = sum(not _may_have(source, number, numbers) for number in vehicles or ())
    if strangers and vehicles:
        given, there = f"{min(vehicles)} to {max(vehicles)}", f"{min(numbers)} to {max(numbers)}"
        what = f"{counted(strangers, 'frame')} that {'is' if strangers == 1 else 'are'} not there"
        lines.append(
            f"Vehicles are given for {what}: theirs are {given}, those of the source {there}.{_hint(vehicles, numbers)}"
        )
    return lines


def _may_have(source: FrameSource, number: int, numbers: Sequence[int]) -> bool:
    """Whether a source of which these frames were taken has, or may have, one of this number."""
    if isinstance(source, VideoFrames):
        return number >= 0 and (number < numbers[-1] + source.choice.every or source.choice.end is not None)
    place = bisect_left(numbers, number)
    taken = place < len(numbers) and numbers[place] == number
    return taken or (isinstance(source, ImageFrames) and number in source.left_out)


def _span(frames: Moments, poses: CameraPoses) -> str:
    if poses.times:
        return f"{frames[0][1]:.10g} to {frames[-1][1]:.10g} s"
    return f"{frames[0][0]} to {frames[-1][0]}"


def _hint(given: Collection[int], numbers: Sequence[int]) -> str:
    counts_from_one = min(given) == numbers[0] + 1 and max(given) == numbers[-1] + 1
    return f" Do they count from {min(given)} instead of {numbers[0]}?" if counts_from_one else ""
