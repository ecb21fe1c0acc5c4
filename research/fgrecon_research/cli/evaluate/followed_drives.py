"""Labelled drives whose boxes are scored beside other methods, and followed over time."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from fgrecon.calibration.labelled_drives import ScoredDrives
from fgrecon.calibration.labelled_frames import Rivals
from fgrecon.calibration.setup import SceneKnowledge
from fgrecon.cli.options import NOT_GIVEN, DriveOptions, LabelledScene
from fgrecon.cli.terminal import Screen, counting
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.datasets import open_drive, open_video
from fgrecon.io.kitti_drives import Drive
from fgrecon_research.evaluation.methods import select
from fgrecon_research.evaluation.sensor_methods import OtherMethods, with_points
from fgrecon_research.evaluation.video_tracks import follow_boxes
from fgrecon_research.io.drive_sensors import Sensor, with_sensors


def score_drives(
    how: DriveOptions,
    folders: Sequence[Path],
    labelled: LabelledScene,
    screen: Screen,
    *,
    rivals: Sequence[str] = (),
    sensors: Collection[Sensor] = (),
    track: bool = False,
    forget_ids: bool = False,
    estimate_motion: bool = False,
) -> ScoredDrives:
    """Reconstruct the labelled boxes that count, follow them if that is requested, and score.

    Args:
        screen: Where progress is shown.
        rivals: Methods that get the same keypoints.
        sensors: Those whose methods are scored as well, on the frames that have their files.
        track: Whether the vehicles are followed as well.
        forget_ids: Whether the vehicles that are followed are given ids anew; detected ones have none.
        estimate_motion: Whether they are followed with the camera's estimated motion as well.

    Raises:
        InvalidInputError: As `DriveOptions.score` does; there is no method of a name; or the camera's motion is to be
            estimated without a ground.
    """
    select(rivals)  # refuse before the work
    if estimate_motion and labelled.ground == NOT_GIVEN:
        fix = "Give a ground, which says how far the camera goes, or leave --estimate-motion out."
        raise InvalidInputError("estimate_motion", "no ground", fix)
    if track and (others_of := [one for one in sensors if one is not Sensor.LIDAR]):
        fix = "Leave --track out: what follows vehicles takes pictures and a LiDAR's points."
        raise InvalidInputError("track", f"with {', '.join(others_of)}", fix)

    def read(folder: Path) -> Drive:
        drive = (open_video if track else open_drive)(folder)
        return with_sensors(drive, sensors) if sensors else drive

    def others(scene: SceneKnowledge) -> Callable[[], Rivals]:
        return partial(OtherMethods, scene, tuple(rivals), tuple(sensors))

    scored = how.score(folders, labelled, screen, read=read, rivals=others if rivals or sensors else None)
    if Sensor.LIDAR in sensors:
        scored = replace(scored, boxes=with_points(scored.boxes, scored.drives))
    if not track:
        return scored
    with screen.bar() as advance:
        boxes = follow_boxes(
            scored.frames,
            scored.drives,
            scored.setups,
            forget_ids=forget_ids or how.detect,
            estimate_motion=estimate_motion,
            lidar=Sensor.LIDAR in sensors,
            advance=counting(advance, "Followed", (1 + estimate_motion) * len(scored.frames)),
        )
    return replace(scored, boxes=boxes)
