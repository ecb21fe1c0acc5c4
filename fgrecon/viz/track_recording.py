"""Recordings of a whole track: frame after frame, the joint optimisation over all of them, and the path in 3D.

On the timeline `frame` it plays the result, frame by frame, with the path so far; on `step` the search for the pose in
every frame, one after the other, and then the joint optimisation, with all frames at once in the 3D scene. The names
are those of `fgrecon.viz.entities`; `fgrecon.viz.replay` reads a file back.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import rerun as rr

from fgrecon.core.arrays import Array
from fgrecon.core.track_reconstruction import TrackReconstruction
from fgrecon.core.vehicle_mesh import Colour
from fgrecon.viz import entities, style
from fgrecon.viz.blueprint import track_blueprint
from fgrecon.viz.columns import Outbox, exact_column, strip_columns
from fgrecon.viz.describe import track_table
from fgrecon.viz.factor_graph import lay_out, log_layout
from fgrecon.viz.playback import Playback, Rows
from fgrecon.viz.plots import (
    INFO,
    WARN,
    PlotSink,
    energy_fields,
    log_columns,
    log_history,
    log_summary,
    status_line,
)
from fgrecon.viz.recording import line_style, log_camera, log_frame, log_ground, log_result, log_steps, log_truth
from fgrecon.viz.sinks import Recording
from fgrecon.viz.subjects import TrackInputs

_FAINT = 110
_STAGE = 2  # of the joint optimisation on the timeline `stage`: initialisation and pose come before


def track_recording_of(track: TrackReconstruction, inputs: TrackInputs) -> Recording:
    """The recording of a track, with its layout.

    Args:
        track: The result.
        inputs: What it was reconstructed from.

    Returns:
        What can be written or sent. Making it raises an InvalidInputError where an image is not (H, W, 3) of bytes.
    """

    def make() -> Callable[[Any], None]:
        whole = _Track(Outbox(f"track of {track.frames[0].shape.category}, {track.status.value}"), track, inputs)
        _log_frames(whole)
        _log_results(whole)
        _log_paths(whole)
        _log_frame_plots(whole)
        if track.history:
            _log_joint(whole)
        if track.graph:
            log_layout(whole.stream, lay_out(track.graph), colours=True)
        _log_words(whole)
        return whole.stream.empty_into

    return Recording(make, lambda: track_blueprint(track, inputs))


@dataclass(frozen=True)
class _Track:
    """A track on its way into a stream."""

    stream: Outbox
    track: TrackReconstruction
    inputs: TrackInputs

    @cached_property
    def plays(self) -> tuple[Playback, ...]:
        """The frames; their searches follow each other on `step`, and their joint steps coincide."""
        plays: list[Playback] = []
        logged: set[str] = set()
        start = update = 0
        for index, result in zip(self.track.numbers, self.track.frames, strict=True):
            play = Playback(self.stream, self.inputs.at(index, result))
            searched = len(play.steps) - self.joint_steps
            numbers = np.concatenate([start + np.arange(searched), self.first_joint + np.arange(self.joint_steps)])
            updates = play.irls + update
            if self.joint_steps:
                updates[searched:] = self.first_update + np.array([step.irls for step in self.track.history])
            frame, at = self.inputs.number(index), numbers.astype(np.int64)
            plays.append(replace(play, frame=frame, numbers=at, updates=updates, logged=logged))
            start += searched
            update += len(np.unique(play.irls[:searched]))
        return tuple(plays)

    @property
    def joint_steps(self) -> int:
        """Number of joint steps."""
        return len(self.track.history)

    @cached_property
    def first_joint(self) -> int:
        """Number of the first joint step on `step`: all searches come before."""
        return sum(max(len(result.diagnostics.history), 1) - self.joint_steps for result in self.track.frames)

    @cached_property
    def first_update(self) -> int:
        """Number of the first joint weight update on `irls`."""
        keys = [{(step.stage, step.irls) for step in result.diagnostics.history} for result in self.track.frames]
        return sum(len([key for key in updates if key[0] != "joint"]) for updates in keys)

    def joint_times(self, rows: Sequence[int] | None = None) -> list[Any]:
        """Time columns of joint steps, all of them by default."""
        chosen = np.arange(self.joint_steps) if rows is None else np.array(rows)
        updates = np.array([self.track.history[int(row)].irls for row in chosen], dtype=np.int64)
        return [
            rr.TimeColumn(entities.STEP, sequence=self.first_joint + chosen),
            rr.TimeColumn(entities.STAGE, sequence=np.full(len(chosen), _STAGE)),
            rr.TimeColumn(entities.IRLS, sequence=self.first_update + updates),
        ]

    @property
    def known(self) -> list[Playback]:
        """The frames whose truth is known."""
        return [play for play in self.plays if play.vehicle.truth is not None]

    @property
    def errors(self) -> list[dict[str, float]]:
        """Distances from the truth of these, by measure."""
        pairs = [(play.vehicle.truth, play.vehicle.reconstruction) for play in self.known]
        return [dict(truth.errors(r.camera_T_object, r.wireframe)) for truth, r in pairs if truth is not None]


def _frame_times(plays: Sequence[Playback]) -> list[Any]:
    """Time column of frames."""
    return [rr.TimeColumn(entities.FRAME, sequence=np.array([play.frame for play in plays], dtype=np.int64))]


def _log_frames(whole: _Track) -> None:
    """Photograph, camera, observation and truth of every frame, and all of their steps."""
    for play in whole.plays:
        photograph = play.vehicle.photograph
        log_camera(play, photograph)
        log_frame(play, photograph)
        if play.vehicle.truth is not None:
            log_truth(play, play.vehicle.truth)
    drawn = [play for play in whole.plays if play.steps]
    if drawn:
        rows = Rows(drawn)
        log_steps(rows)
        if all(play.vehicle.reconstruction.diagnostics.history for play in drawn):
            log_history(rows)


def _log_results(whole: _Track) -> None:
    """The ground, and surface, box and uncertainty in the first frame of every shape: that of a track is one."""
    solved = [play for play in whole.plays if play.vehicle.solved]
    if solved:
        log_ground(solved[0], whole.inputs.ground)
    for before, play in zip([None, *solved], solved, strict=False):
        shape = play.vehicle.reconstruction.wireframe
        if before is None or not np.array_equal(shape, before.vehicle.reconstruction.wireframe):
            log_result(play)


def _log_paths(whole: _Track) -> None:
    """The vehicle's origins up to each frame, estimated and true."""
    estimated = np.array([play.vehicle.reconstruction.location for play in whole.plays])
    _log_path(whole, entities.PATH, estimated, whole.plays, style.SCREEN_INK)
    if whole.known:
        true = np.array([p.vehicle.truth.camera_T_object[:3, 3] for p in whole.known if p.vehicle.truth is not None])
        _log_path(whole, entities.TRUE_PATH, true, whole.known, style.TRUTH)


def _log_path(whole: _Track, entity: str, points: Array, plays: Sequence[Playback], colour: Colour) -> None:
    whole.stream.send_fixed(entity, **line_style(3, colour, 1.5))
    columns = rr.LineStrips3D.columns(strips=[points[: end + 1] for end in range(len(points))])
    whole.stream.send_columns(entity, _frame_times(plays), columns)


def _log_frame_plots(whole: _Track) -> None:
    """Energy, weights and errors of the result by frame."""
    results = [play.vehicle.reconstruction for play in whole.plays]
    plots = PlotSink(whole.stream, _frame_times(whole.plays), f"{entities.FRAMES}/")
    plots.energies([result.diagnostics.energies for result in results])
    plots.weights(np.stack([result.diagnostics.weights for result in results]), results[0])
    if whole.known:
        PlotSink(whole.stream, _frame_times(whole.known), f"{entities.FRAMES}/").errors(whole.errors)


def _log_joint(whole: _Track) -> None:
    """The joint optimisation: all wireframes, energies, coefficients, and every field of every step."""
    history, times = whole.track.history, whole.joint_times()
    edges = whole.track.frames[0].shape.edges
    shapes = np.stack([Rows([p]).keypoints_in_camera[-len(history) :] for p in whole.plays], axis=1)  # (n, T, K, 3)
    strips = shapes[:, :, edges].reshape(len(history), -1, 2, 3)  # strips of all frames at each step
    whole.stream.send_fixed(entities.TRACK_3D, **line_style(3, (*style.SCREEN_INK, _FAINT), 0.6))
    whole.stream.send_columns(entities.TRACK_3D, times, strip_columns(rr.LineStrips3D, strips))
    coefficients = np.stack([step.coefficients for step in history])
    energies = [step.energies for step in history]
    plots = PlotSink(whole.stream, times)
    plots.energies(energies)
    plots.coefficients(coefficients)
    fields: dict[str, Any] = {
        "irls": [step.irls for step in history],
        "step": [step.step for step in history],
        "poses": np.stack([step.poses for step in history]),
        "coefficients": coefficients,
        **energy_fields(energies),
    }
    whole.stream.send_columns(entities.TRACK, times, [exact_column(entities.JOINT_ARCHETYPE, fields)])


def _log_words(whole: _Track) -> None:
    """What became of every image, every joint weight update, how it ended and why; and the summary."""
    track = whole.track
    for index, reason in track.refused.items():
        line = f"frame {whole.inputs.number(index)} was refused: {reason}"
        when = rr.TimeColumn(entities.FRAME, sequence=[whole.inputs.number(index)])
        whole.stream.send_columns(entities.LOG, [when], log_columns([line], [WARN]))
    for play in whole.plays:
        searched = len(play.steps) - whole.joint_steps
        if searched > 0:
            energy = sum(play.steps[searched - 1].energies.values())
            text = f"frame {play.frame}: pose found in {searched} steps, energy {energy:.4g}"
            play.at_steps(entities.LOG, log_columns([text], [INFO]), [searched - 1])
    level, end = status_line(track.status, track.message)
    last = {step.irls: row for row, step in enumerate(track.history)}
    if last:
        totals = [sum(track.history[row].energies.values()) for row in last.values()]
        texts = [f"joint {irls}: energy {total:.5g}" for irls, total in zip(last, totals, strict=True)]
        lines = log_columns([*texts, end], [*[INFO] * len(texts), level])
        whole.stream.send_columns(entities.LOG, whole.joint_times([*last.values(), whole.joint_steps - 1]), lines)
    else:
        whole.plays[-1].at_result(entities.LOG, log_columns([end], [level]))
    log_summary(whole.stream, track_table(track, whole.errors))
