"""`fgrecon evaluate tracks`: methods side by side on tracks with known poses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from fgrecon.calibration.labelled_frames import SceneKnowledge
from fgrecon.cli.options import Delivery, JsonOption, LabelledScene, fitting_names
from fgrecon.cli.outputs import check_outputs
from fgrecon.cli.terminal import Screen, Terminal, counting
from fgrecon.cli.track_report import image_numbers, truth_of
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.reconstruction import Reconstruction, Status
from fgrecon.core.size_prior import SizePrior
from fgrecon.core.track_reconstruction import TrackReconstruction
from fgrecon.io.track_file import Track, read_track
from fgrecon.viz import Recording, TrackInputs, track_recording_of
from fgrecon_research.cli.evaluate.data_options import MarkdownOption
from fgrecon_research.evaluation import report
from fgrecon_research.evaluation.methods import METHODS, Method, select
from fgrecon_research.evaluation.run import MethodScores, score_tracks

_FAILURES_SHOWN = 5
_WIDE = 160  # columns of the terminal that the whole table needs


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
            autocompletion=fitting_names(lambda: list(METHODS)),
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
    recording = recorded(methods) if delivery.requested else None
    tracks = [read_track(file, scene.prior.category) for file in files]

    total = len(methods) * sum(len(track.frames) for track in tracks)
    with screen.bar() as advance:
        scores = score_tracks(tracks, methods, scene, counting(advance, "Frames", total))
    narrow = screen.console.width < _WIDE
    screen.print(
        report.table(scores, narrow=narrow).shown(tight=narrow), f"+ground: {origin}. +size: {_in_words(scene.size)}."
    )
    _print_failures(scores, screen)
    named = list(zip(map(str, files), tracks, strict=True))
    screen.write_document(report.document(scores, named, scene, {"ground": origin}))
    screen.write_text(markdown, report.table(scores).markdown())
    screen.write_text(per_frame, report.to_json(report.frames_document(scores)))
    if recording is not None:
        made = recordings(tracks, recording, scene)
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


def recorded(methods: Sequence[Method]) -> Method:
    """The method that is recorded: the last one with a result to play back.

    Raises:
        InvalidInputError: All are baselines.
    """
    known = [method for method in methods if method.reconstruct is not None]
    if not known:
        names = ", ".join(method.name for method in methods)
        raise InvalidInputError("method", names, "Run one of fgrecon's own too: the others have nothing to record.")
    return known[-1]


def recordings(tracks: Sequence[Track], method: Method, scene: SceneKnowledge) -> list[tuple[str, Recording]]:
    """Name and recording of every track, solved once more frame by frame, with the labels as the truth.

    A track of which no frame can be solved has none.
    """
    made = []
    for track in tracks:
        result = _solve(track, method, scene)
        if result is not None:
            sight = TrackInputs(
                observations=[frame.observation for frame in track.frames],
                cameras=[track.camera] * len(track.frames),
                numbers=image_numbers([frame.name for frame in track.frames]),
                truths=[truth_of(track, index) for index in range(len(track.frames))],
                ground=scene.ground if "ground" in method.name else None,
            )
            made.append((track.name, track_recording_of(result, sight)))
    return made


def _solve(track: Track, method: Method, scene: SceneKnowledge) -> TrackReconstruction | None:
    """The frames one by one as a track without a joint optimisation; None where none was solved."""
    assert method.reconstruct is not None
    solved: dict[int, Reconstruction] = {}
    refused: dict[int, str] = {}
    for index, frame in enumerate(track.frames):
        if frame.observation is None:
            refused[index] = "no keypoints"
            continue
        try:
            result = method.reconstruct(scene, frame.observation, track.camera)
        except FgreconError as error:
            refused[index] = str(error)
            continue
        if result.status is Status.FAILED:
            refused[index] = result.message
        else:
            solved[index] = result
    if not solved:
        return None
    frames = tuple(solved.values())
    terms = dict.fromkeys(term for frame in frames for term in frame.diagnostics.energies)
    stages = dict.fromkeys(stage for frame in frames for stage in frame.diagnostics.milliseconds)
    settled = all(frame.status.settled for frame in frames)
    return TrackReconstruction(
        status=Status.CONVERGED if settled else Status.AMBIGUOUS,
        message=f"{len(frames)} of {len(track.frames)} frames, each on its own, by {method.name}",
        numbers=tuple(solved),
        frames=frames,
        refused=refused,
        energies={term: sum(frame.diagnostics.energies.get(term, 0.0) for frame in frames) for term in terms},
        history=(),
        graph=(),
        milliseconds={
            stage: sum(frame.diagnostics.milliseconds.get(stage, 0.0) for frame in frames) for stage in stages
        },
    )
