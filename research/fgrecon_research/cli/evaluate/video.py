"""`fgrecon evaluate video`: from the images of video drives, each on its own, to poses, scored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from fgrecon.calibration.labelled_drives import ScoredDrives
from fgrecon.calibration.labelled_frames import ScoredFrame, reconstruct_frame
from fgrecon.cli.commands import option
from fgrecon.cli.options import DriveOptions, DrivesArgument, JsonOption, LabelledScene, fitting_names
from fgrecon.cli.outputs import check_outputs
from fgrecon.cli.terminal import Screen, Terminal
from fgrecon.core.coverage import Reliability
from fgrecon.io.export.formats import TABLE_FORMATS, export_rows
from fgrecon.io.files import check_ending, check_folder, write_text
from fgrecon.simulation.vehicles import yaw_pose
from fgrecon.viz import SolvedVehicle, contact_sheet, save_picture
from fgrecon.viz.subjects import Truth
from fgrecon_research.cli.evaluate.data_options import MarkdownOption, ResultsOption
from fgrecon_research.cli.evaluate.followed_drives import Following, score_drives
from fgrecon_research.evaluation.methods import METHODS
from fgrecon_research.evaluation.video_summary import (
    document,
    facing_reliability,
    methods_of,
    summarise_groups,
    tables,
    worst_boxes,
)
from fgrecon_research.io.drive_sensors import Sensor

_WORST = 20
_RIVAL = "sqpnp_confident"
_COLUMNS = 5


@dataclass(frozen=True)
class Sensors:
    """Which other sensors' evidence is scored beside the picture alone."""

    lidar: bool = option(
        "Score with the LiDAR as well (folder lidar or velodyne), beside crude baselines.", "--lidar", default=False
    )
    right: bool = option(
        "The same with the right image of a rectified pair (folder image_03).", "--right", default=False
    )

    depth: bool = option(
        "The same with depth maps made of the scans: in metres, and up to a scale and a shift.",
        "--depth",
        default=False,
    )

    @property
    def chosen(self) -> list[Sensor]:
        """Those that are requested."""
        return [sensor for sensor in Sensor if getattr(self, sensor.value, False)]


@dataclass(frozen=True)
class VideoOutputs:
    """What is written."""

    picture: Path | None = option(f"Contact sheet of the {_WORST} worst tracks' worst boxes.", metavar="FILE")
    table: Path | None = option("Rows by box and method as .csv or .parquet.", metavar="FILE")
    results_out: ResultsOption = None
    markdown: MarkdownOption = None
    json_out: JsonOption = None

    def check(self) -> None:
        """Refuse what cannot be written before the work."""
        check_outputs(self.json_out, self.table, self.markdown, picture=self.picture)
        if self.table is not None:
            check_ending(self.table, TABLE_FORMATS)
        if self.results_out is not None:
            check_folder(self.results_out)

    def write(self, scored: ScoredDrives, screen: Screen) -> None:
        """Rows, boxes and the picture of what was scored."""
        if self.results_out is not None:
            screen.wrote(*_write_results(self.results_out, scored.frames))
        if self.table is not None:
            screen.wrote(export_rows(self.table, [row for box in scored.boxes for row in box.rows()]))
        if self.picture is not None and (sights := _sights(scored)):
            screen.wrote(save_picture(self.picture, contact_sheet(sights, columns=_COLUMNS)))


def video_command(
    folders: DrivesArgument,
    labelled: LabelledScene,
    terminal: Terminal,
    how: DriveOptions,
    following: Following,
    sensors: Sensors,
    outputs: VideoOutputs,
    rival: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Method of `evaluate tracks` that gets the same keypoints; repeat for more.",
            show_default=_RIVAL,
            autocompletion=fitting_names(lambda: list(METHODS)),
        ),
    ] = None,
) -> None:
    """Find keypoints in every image of labelled drives, reconstruct cars and vans from their labelled boxes, and score.

    Boxes count that are at least 25 px high, largely occluded at most, and at most half outside the image. Each image
    is taken on its own; with --track the same keypoints are followed over time as well, without a motion of the camera
    and with the one that all images between the first and the last labelled one tell; beside that the single images
    stand flipped where the network's directions so far, or of the whole track, add up to that. A box without a
    result counts as 180 degrees and stays in. Intervals are of 95 %, by bootstrap over tracks. For a picture the worst
    images are solved once more after they were scored. --verbose shows every box.

    With --detect a labelled box is scored by the detected one that overlaps it most, by more than half; labelled boxes
    without one are counted, and in none of the shares. All frames of a drive are looked at, and followed without ids.

    Exit code 1: no box could be reconstructed.
    """
    outputs.check()
    screen = terminal.screen(outputs.json_out)
    scored = score_drives(
        *(how, folders, labelled, screen), following=following, rivals=rival or [_RIVAL], sensors=sensors.chosen
    )
    boxes, summaries = scored.boxes, summarise_groups(scored.boxes)
    screen.print(scored.in_words())
    made = {f"By {by}:": one for by, one in tables(summaries).items()}
    for heading, one in made.items():
        screen.print(heading, one.filled().shown())
    screen.print(_in_words(facing_reliability(boxes)))
    for box in boxes:
        for method, found in box.outcomes.items():
            error = found.failure or f"{found.degrees:.1f} degrees, {found.metres:.2f} m"
            screen.detail(f"{box.drive}/{box.frame:06d}/{box.index} {method}: {error}")
    given = _given(scored, labelled, how, following) | {
        "estimate_motion": following.moving(labelled),
        "sensors": sensors.chosen,
    }
    content = document(boxes, summaries, given, scored.networks())
    screen.write_document(content)
    screen.write_text(outputs.markdown, "\n".join(f"{heading}\n\n{one.markdown()}" for heading, one in made.items()))
    outputs.write(scored, screen)
    if all(box.outcomes[methods_of(boxes)[0]].failure is not None for box in boxes):
        screen.fail("No box could be reconstructed.")
        raise typer.Exit(1)


def _given(scored: ScoredDrives, labelled: LabelledScene, how: DriveOptions, following: Following) -> dict[str, Any]:
    """What was given, for the document."""
    return {
        "drives": [drive.name for drive in scored.drives],
        "images": scored.images,
        "prior": scored.request.given.scene.prior.describe(),
        "ground": scored.request.given.origin,
        "size_prior": labelled.size_prior,
        "box_model": scored.request.encloses.value,
        "together": how.together,
        "traffic": how.traffic,
        "classes": how.classes,
        "track": following.track,
        "ids": "associated" if following.forget_ids or how.detect else "labelled",
        "boxes": scored.request.boxes,
        "missed": scored.missed,
    }


def _write_results(folder: Path, frames: Sequence[ScoredFrame]) -> list[Path]:
    """The folder of each drive, which has a file for each image with a label that counts, found or not."""
    folders = set()
    for frame in frames:
        if frame.boxes or frame.missed:
            path = folder / frame.drive / f"{frame.number:06d}.txt"
            path.parent.mkdir(parents=True, exist_ok=True)
            write_text(path, "".join(box.line for box in frame.boxes))
            folders.add(path.parent)
    return sorted(folders)


def _in_words(facing: Reliability) -> str:
    if not len(facing.count):
        return "The network gives no directions."
    right, sure = (
        100.0 * float(values @ facing.count) / facing.count.sum() for values in (facing.right, facing.confidence)
    )
    return (
        f"The network's more probable half of all directions is right for {right:.1f} % of the boxes, where it says "
        f"{sure:.1f} %; expected calibration error {100.0 * facing.error:.1f} %."
    )


def _sights(scored: ScoredDrives) -> list[SolvedVehicle]:
    """The worst boxes with their photographs and labels, worst first; their frames are solved once more."""
    by_name = {drive.name: drive for drive in scored.drives}
    sights = []
    for box in worst_boxes(scored.boxes, _WORST):
        drive = by_name[box.drive]
        frame = next(frame for frame in drive.frames if frame.number == box.frame)
        image, vehicles = reconstruct_frame(frame, scored.setups[box.drive])
        one = next(vehicle.found for vehicle in vehicles if vehicle.label == box.index)
        if one.result is None:
            continue
        labels, offset = frame.objects, drive.calibration.label_offset
        pose = yaw_pose(float(labels.rotation_y[box.index]), labels.location[box.index] + offset)
        camera = drive.calibration.camera.with_size_of(image)
        title = f"{box.drive}/{box.frame:06d}/{box.index}"
        truth = Truth(pose, labels.size[box.index])
        sights.append(SolvedVehicle(one.result, one.detection.observation, camera, image, truth, title))
    return sights
