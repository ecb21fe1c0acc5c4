"""Labelled drives whose boxes are scored beside other methods, and followed over time."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from fgrecon.calibration.labelled_drives import ScoredDrives
from fgrecon.calibration.labelled_frames import Rivals, SceneKnowledge
from fgrecon.cli.commands import option
from fgrecon.cli.options import NOT_GIVEN, DriveOptions, LabelledScene
from fgrecon.cli.terminal import Screen, counting
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.datasets import open_drive, open_video
from fgrecon.io.kitti_files import Drive
from fgrecon_research.evaluation.methods import select
from fgrecon_research.evaluation.sensor_methods import OtherMethods, with_points
from fgrecon_research.evaluation.video_tracks import follow_boxes
from fgrecon_research.io.drive_sensors import Sensor, with_sensors


@dataclass(frozen=True)
class Following:
    """Whether and how the vehicles are followed over time as well."""

    track: bool = option(
        "Follow the vehicles by their labelled ids as well: online, and in batch (`fgrecon.Tracker`); "
        "score velocities, and covariances against errors.",
        "--track",
        default=False,
    )
    forget_ids: bool = option(
        "Follow without the labelled ids, as `fgrecon run` associates.", "--forget-ids", default=False
    )
    estimate_motion: bool | None = option(
        "Follow with the camera's motion as well, as the images tell it.",
        "--estimate-motion/--no-estimate-motion",
        show_default="with --track and a ground",
    )

    def moving(self, labelled: LabelledScene) -> bool:
        """Whether the camera's motion is estimated.

        Raises:
            InvalidInputError: Something is requested of vehicles that are not followed, or there is no ground.
        """
        if self.forget_ids and not self.track:
            raise InvalidInputError("forget_ids", "true", "Give --track as well: single images have no ids.")
        if self.estimate_motion and not self.track:
            raise InvalidInputError("estimate_motion", "true", "Give --track as well: single images know no motion.")
        if self.estimate_motion and labelled.ground == NOT_GIVEN:
            fix = "Give a ground, which says how far the camera goes, or leave --estimate-motion out."
            raise InvalidInputError("estimate_motion", "no ground", fix)
        return (self.track and labelled.ground != NOT_GIVEN) if self.estimate_motion is None else self.estimate_motion


def score_drives(
    how: DriveOptions,
    folders: Sequence[Path],
    labelled: LabelledScene,
    screen: Screen,
    *,
    following: Following,
    rivals: Sequence[str] = (),
    sensors: Collection[Sensor] = (),
) -> ScoredDrives:
    """Reconstruct the labelled boxes that count, follow them if that is requested, and score.

    Args:
        screen: Where progress is shown.
        following: Whether and how the vehicles are followed as well; detected ones have no ids.
        rivals: Methods that get the same keypoints.
        sensors: Those whose methods are scored as well, on the frames that have their files.

    Raises:
        InvalidInputError: As `DriveOptions.score` and `Following.moving` do; or there is no method of a name.
    """
    select(rivals)  # refuse before the work
    track, moving = following.track, following.moving(labelled)
    if track and (others_of := [one for one in sensors if one is Sensor.DEPTH]):
        fix = "Leave --track out: what follows vehicles takes pictures, a LiDAR's points and right images."
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
            forget_ids=following.forget_ids or how.detect,
            estimate_motion=moving,
            sensors=sensors,
            advance=counting(advance, "Followed", (1 + moving) * len(scored.frames)),
        )
    return replace(scored, boxes=boxes)
