"""`fgrecon evaluate`: methods side by side on data with known poses. The paper's tables are in `fgrecon.cli.paper`."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fgrecon.cli import evaluate_kitti
from fgrecon.cli.common import GroundOption, JsonOption, PriorOption, check_outputs, console, ground_plane, write_json
from fgrecon.cli.deliver import ConnectOption, SaveOption, SpawnOption, check_delivery, deliver, wants_recording

if TYPE_CHECKING:  # the command line must start fast: what the commands need is imported when they run
    from collections.abc import Callable, Iterator, Sequence

    from rich.table import Table

    from fgrecon.core.size_prior import SizePrior
    from fgrecon.evaluation.run import MethodScores

__all__ = ["KITTI_CAMERA_HEIGHT", "app"]

KITTI_CAMERA_HEIGHT = 1.65
"""Height of KITTI's cameras above the road, metres."""

_FAILURES_SHOWN = 5

app = typer.Typer(help="Compare fgrecon with other methods on data with known poses.", no_args_is_help=True)


app.command("kitti")(evaluate_kitti.kitti_command)


@app.callback()
def _group() -> None:
    """Compare fgrecon with other methods on data with known poses."""


@app.command("tracks")
def tracks_command(
    files: Annotated[list[Path], typer.Argument(help="Tracks with keypoints and labelled poses (JSON).")],
    method: Annotated[
        list[str] | None,
        typer.Option(
            help="Run this method alone; give it again for more. With another robust strategy: fgrecon+size:paper.",
            show_default="all",
        ),
    ] = None,
    prior: PriorOption = "car14",
    size_prior: Annotated[
        str, typer.Option(help="Size of the fleet for the rows `+size`: kitti, apollo79 or length,width,height in m.")
    ] = "kitti",
    camera_height: Annotated[
        float | None,
        typer.Option(help="Height of a level camera for the row `+ground`, m.", show_default=str(KITTI_CAMERA_HEIGHT)),
    ] = None,
    ground: GroundOption = None,
    json_out: JsonOption = None,
    markdown_out: Annotated[Path | None, typer.Option("--markdown", help="Write the table as Markdown.")] = None,
    frames_out: Annotated[
        Path | None, typer.Option("--per-frame", help="Write every frame's errors by method as JSON.")
    ] = None,
    save: SaveOption = None,
    connect: ConnectOption = None,
    spawn: SpawnOption = False,
    progress: Annotated[
        bool | None, typer.Option("--progress/--no-progress", help="Progress bar.", show_default="on a terminal")
    ] = None,
) -> None:
    """Score poses on tracks: orientation error, AOP at 5, 15 and 30 degrees, translation error, time per stage.

    A frame that a method fails on counts as 180 degrees and stays in N. Exit code 1: fgrecon failed on every frame (any
    other method, where fgrecon does not run).

    A recording shows the last of fgrecon's own methods, frame by frame, with the labels and the errors; for it the
    frames are solved once more after they were scored.
    """
    from fgrecon.cli import evaluate_recording
    from fgrecon.core.camera import Ground
    from fgrecon.core.size_prior import size_prior as parse_size
    from fgrecon.evaluation import report
    from fgrecon.evaluation.methods import SceneKnowledge, select
    from fgrecon.evaluation.run import score_tracks
    from fgrecon.io.catalogue import load_prior
    from fgrecon.io.files import write_text
    from fgrecon.io.track_file import read_track

    check_outputs(json_out, markdown_out, frames_out)
    check_delivery(save, connect)
    plane, origin = ground_plane(ground, camera_height) or (
        Ground.level(KITTI_CAMERA_HEIGHT),
        f"level camera {KITTI_CAMERA_HEIGHT} m above the ground (KITTI's)",
    )
    scene = SceneKnowledge(prior=load_prior(prior), ground=plane, size=parse_size(size_prior))
    methods = select(method or None)
    recording = evaluate_recording.recorded(methods) if wants_recording(save, connect, spawn=spawn) else None
    tracks = [read_track(file, scene.prior.category) for file in files]

    frames = sum(len(track.frames) for track in tracks)
    shown = sys.stderr.isatty() if progress is None else progress
    with _bar(frames * len(methods), shown=shown) as advance:
        scores = score_tracks(tracks, methods, scene, advance)

    _show(report.table(scores), scores, f"+ground: {origin}. +size: {_in_words(scene.size)}.", error=json_out == "-")
    if json_out is not None:
        text = report.to_json(
            report.document(scores, list(zip(map(str, files), tracks, strict=True)), scene, {"ground": origin})
        )
        write_json(json_out, text)
    if markdown_out is not None:
        write_text(markdown_out, report.markdown(scores))
    if frames_out is not None:
        write_text(frames_out, report.to_json(report.frames_document(scores)))
    if recording is not None:
        made = evaluate_recording.recordings(tracks, recording, scene)
        deliver(made, save, connect, spawn=spawn, several=len(tracks) > 1)
    judged = [entry for entry in scores if entry.name.partition("+")[0] == "fgrecon"] or scores
    if any(len(entry.failures) == len(entry.frames) for entry in judged):
        raise typer.Exit(1)


def _show(table: Table, scores: Sequence[MethodScores], told: str, *, error: bool) -> None:
    """Print the table, what the methods were told, and which frames they failed on."""
    out = console(error=error)
    out.print(table)
    out.print(told, markup=False)
    for entry in scores:
        for failure in entry.failures[:_FAILURES_SHOWN]:
            out.print(f"{entry.name} failed on {failure.frame}: {failure.failure}", markup=False)
        if len(entry.failures) > _FAILURES_SHOWN:
            out.print(f"{entry.name} failed on {len(entry.failures) - _FAILURES_SHOWN} more: see --json.")


def _in_words(size: SizePrior) -> str:
    length, width, height = size.mean
    return f"{size.name}, {length:g} m long, {width:g} m wide, {height:g} m high on average"


@contextlib.contextmanager
def _bar(total: int, *, shown: bool) -> Iterator[Callable[[str], None]]:
    """A progress bar on the error stream, or nothing."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=not shown) as progress:
        task = progress.add_task("", total=total)
        yield lambda name: progress.update(task, advance=1, description=name)
