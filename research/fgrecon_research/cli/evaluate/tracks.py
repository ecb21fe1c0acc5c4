"""`fgrecon evaluate tracks`: methods side by side on tracks with known poses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from fgrecon.cli.options import Delivery, JsonOption, LabelledScene, fitting_names
from fgrecon.cli.outputs import check_outputs
from fgrecon.cli.terminal import Screen, Terminal, counting
from fgrecon.core.size_prior import SizePrior
from fgrecon.io.track_file import read_track
from fgrecon_research.cli.evaluate import recording as evaluate_recording
from fgrecon_research.cli.evaluate.data_options import MarkdownOption
from fgrecon_research.evaluation import report
from fgrecon_research.evaluation.methods import METHODS, select
from fgrecon_research.evaluation.run import MethodScores, score_tracks

_FAILURES_SHOWN = 5
_WIDE = 160  # columns of the terminal that the whole table needs


def _methods() -> list[str]:
    return list(METHODS)


def tracks_command(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE", help="Tracks with keypoints and labelled poses (JSON).")
    ],
    labelled: LabelledScene,
    delivery: Delivery,
    terminal: Terminal,
    method: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Run this method alone; give it again for more. With another robust strategy: fgrecon+size:paper.",
            show_default="all",
            autocompletion=fitting_names(_methods),
        ),
    ] = None,
    json_out: JsonOption = None,
    markdown: MarkdownOption = None,
    per_frame: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write every frame's errors by method as JSON.")
    ] = None,
) -> None:
    """Score poses on tracks: orientation error, AOP at 5, 15 and 30 degrees, translation error, time per stage.

    The part of a method's name after + says what it is given: +size the fleet's size, +ground the ground plane. A frame
    that a method fails on counts as 180 degrees and stays in N; --verbose names all of them. Exit code 1: fgrecon
    failed on every frame (any other method, where fgrecon does not run).

    A recording shows the last of fgrecon's own methods, frame by frame, with the labels and the errors; for it the
    frames are solved once more after they were scored.
    """
    check_outputs(json_out, markdown, per_frame)
    delivery.check()
    screen = terminal.screen(json_out)
    scene, (_, origin) = labelled.scene(), labelled.plane()
    methods = select(method or None)
    recording = evaluate_recording.recorded(methods) if delivery.requested else None
    tracks = [read_track(file, scene.prior.category) for file in files]

    total = len(methods) * sum(len(track.frames) for track in tracks)
    with screen.bar() as advance:
        scores = score_tracks(tracks, methods, scene, counting(advance, "Frames", total))
    table = report.table(scores, narrow=screen.console.width < _WIDE)
    screen.print(table, f"+ground: {origin}. +size: {_in_words(scene.size)}.")
    _print_failures(scores, screen)
    named = list(zip(map(str, files), tracks, strict=True))
    screen.write_json(report.to_json(report.document(scores, named, scene, {"ground": origin})))
    screen.write_text(markdown, report.markdown(scores))
    screen.write_text(per_frame, report.to_json(report.frames_document(scores)))
    if recording is not None:
        made = evaluate_recording.recordings(tracks, recording, scene)
        delivery.deliver(made, screen, several=len(tracks) > 1)
    judged = [entry for entry in scores if entry.name.partition("+")[0] == "fgrecon"] or scores
    if failed := [entry.name for entry in judged if len(entry.failures) == len(entry.frames)]:
        screen.fail(f"{', '.join(failed)} failed on every frame.")
        raise typer.Exit(1)


def _print_failures(scores: Sequence[MethodScores], screen: Screen) -> None:
    """Which frames the methods failed on; the first ones, unless the user wants to know more."""
    for entry in scores:
        shown = entry.failures if screen.verbose else entry.failures[:_FAILURES_SHOWN]
        for failure in shown:
            screen.print(f"{entry.name} failed on {failure.frame}: {failure.failure}")
        if len(entry.failures) > len(shown):
            screen.print(f"{entry.name} failed on {len(entry.failures) - len(shown)} more: see --verbose or --json.")


def _in_words(size: SizePrior) -> str:
    length, width, height = size.mean
    return f"{size.name}, {length:g} m long, {width:g} m wide, {height:g} m high on average"
