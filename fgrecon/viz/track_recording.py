"""Recordings of a whole track: frame after frame, the joint optimisation over all of them, and the path in 3D.

On the timeline `frame` it plays the result, frame by frame, with the path so far; on `step` the search for the pose in
every frame, one after the other, and then the joint optimisation, with all frames at once in the 3D scene. The names
are those of `fgrecon.viz.entities`; `fgrecon.viz.replay` reads a file back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.track_reconstruction import TrackReconstruction
from fgrecon.viz import entities, style
from fgrecon.viz.columns import Outbox, exact_column, strip_column
from fgrecon.viz.describe import track_table
from fgrecon.viz.factor_graph import lay_out, log_layout
from fgrecon.viz.photograph import Photograph
from fgrecon.viz.playback import Playback, Rows
from fgrecon.viz.plots import (
    INFO,
    WARN,
    energy_fields,
    energy_series,
    error_series,
    keypoint_series,
    log_columns,
    log_history,
    log_summary,
    measure_name,
    series_columns,
    series_style,
    status_line,
)
from fgrecon.viz.scene import line_style, log_camera, log_frame, log_ground, log_result, log_steps, log_truth
from fgrecon.viz.sinks import Recording
from fgrecon.viz.track_sight import TrackSight

__all__ = ["record_track", "track_recording_of"]

_FAINT = 110
_STAGE = 2  # of the joint optimisation on the timeline `stage`: initialisation and pose come before


def record_track(path: str | Path, track: TrackReconstruction, sight: TrackSight) -> Path:
    """Write a recording of a track, with its layout, to a `.rrd` file, whole or not at all.

    Args:
        path: File to write.
        track: The result.
        sight: What it was reconstructed from.

    Returns:
        The path written to.

    Raises:
        InvalidInputError: The file cannot be written, or an image is not (H, W, 3) of bytes.
    """
    return track_recording_of(track, sight).write(path)


def track_recording_of(track: TrackReconstruction, sight: TrackSight) -> Recording:
    """The recording that `record_track` writes, to be sent elsewhere; the arguments are those of `record_track`."""
    from fgrecon.viz.track_blueprint import track_blueprint

    return Recording(lambda: _outbox(track, sight).empty_into, lambda: track_blueprint(track, sight))


def _outbox(track: TrackReconstruction, sight: TrackSight) -> Outbox:
    """All chunks of a recording."""
    out = Outbox(f"track of {track.frames[0].category}, {track.status.value}")
    whole = _Track(out, track, sight)
    for index, play in zip(track.numbers, whole.plays, strict=True):
        image = None if sight.images is None else sight.images[index]
        photograph = Photograph.of(image)
        log_camera(play, photograph)
        log_frame(play, photograph)
        if play.truth is not None:
            log_truth(play, play.truth)
    drawn = [play for play in whole.plays if play.steps]
    if drawn:
        rows = Rows.of(drawn)
        log_steps(rows)
        if all(play.reconstruction.history for play in drawn):
            log_history(rows)
    _log_result(whole)
    _log_paths(whole)
    _log_frame_plots(whole)
    if track.history:
        _log_joint(whole)
    if track.graph:
        log_layout(out, lay_out(track.graph), colours=True)
    _log_words(whole)
    return out


@dataclass(frozen=True)
class _Track:
    """A track on its way into a stream."""

    stream: Outbox
    track: TrackReconstruction
    sight: TrackSight

    @cached_property
    def plays(self) -> tuple[Playback, ...]:
        """The frames; their searches follow each other on `step`, and their joint steps coincide."""
        plays: list[Playback] = []
        logged: set[str] = set()
        start = update = 0
        for index, result in zip(self.track.numbers, self.track.frames, strict=True):
            observation = self.sight.observations[index]
            assert observation is not None
            truth = None if self.sight.truths is None else self.sight.truths[index]
            play = Playback(self.stream, result, observation, self.sight.cameras[index], truth)
            searched = len(play.steps) - self.joint_steps
            numbers = np.concatenate([start + np.arange(searched), self.first_joint + np.arange(self.joint_steps)])
            updates = play.irls + update
            if self.joint_steps:
                updates[searched:] = self.first_update + np.array([step.irls for step in self.track.history])
            plays.append(
                replace(
                    play,
                    frame=self.sight.number(index),
                    numbers=numbers.astype(np.int64),
                    updates=updates,
                    logged=logged,
                )
            )
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
        return sum(max(len(result.history), 1) - self.joint_steps for result in self.track.frames)

    @cached_property
    def first_update(self) -> int:
        """Number of the first joint weight update on `irls`."""
        keys = [{(step.stage, step.irls) for step in result.history} for result in self.track.frames]
        return sum(len([key for key in found if key[0] != "joint"]) for found in keys)

    def joint_times(self, rows: Sequence[int] | None = None) -> list[Any]:
        """Time columns of joint steps, all of them by default."""
        import rerun as rr

        chosen = np.arange(self.joint_steps) if rows is None else np.array(rows)
        updates = np.array([self.track.history[int(row)].irls for row in chosen], dtype=np.int64)
        return [
            rr.TimeColumn(entities.STEP, sequence=self.first_joint + chosen),
            rr.TimeColumn(entities.STAGE, sequence=np.full(len(chosen), _STAGE)),
            rr.TimeColumn(entities.IRLS, sequence=self.first_update + updates),
        ]

    def frame_times(self, rows: NDArray[np.int64] | None = None) -> list[Any]:
        """Time column of frames, all of them by default."""
        import rerun as rr

        numbers = np.array([play.frame for play in self.plays], dtype=np.int64)
        return [rr.TimeColumn(entities.FRAME, sequence=numbers if rows is None else numbers[rows])]


def _log_result(whole: _Track) -> None:
    """The ground, and surface, box and uncertainty in the first frame of every shape: that of a track is one."""
    found = [play for play in whole.plays if np.isfinite(play.reconstruction.camera_T_object).all()]
    if found:
        log_ground(found[0], whole.sight.ground)
    for before, play in zip([None, *found], found, strict=False):
        shape = play.reconstruction.wireframe
        if before is None or not np.array_equal(shape, before.reconstruction.wireframe):
            log_result(play)


def _log_paths(whole: _Track) -> None:
    """The vehicle's origins up to each frame, estimated and true."""
    estimated = np.array([play.reconstruction.location for play in whole.plays])
    _log_path(whole, entities.PATH, estimated, np.arange(len(estimated)), style.SCREEN_INK)
    known = np.array([row for row, play in enumerate(whole.plays) if play.truth is not None], dtype=np.int64)
    true = np.array([play.truth.camera_T_object[:3, 3] for play in whole.plays if play.truth is not None])
    if len(known):
        _log_path(whole, entities.TRUE_PATH, true, known, style.TRUTH)


def _log_path(
    whole: _Track, entity: str, points: NDArray[np.float64], rows: NDArray[np.int64], colour: style.Colour
) -> None:
    import rerun as rr

    whole.stream.send_fixed(entity, **line_style(3, colour, 1.5))
    columns = rr.LineStrips3D.columns(strips=[points[: end + 1] for end in range(len(points))])
    whole.stream.send_columns(entity, whole.frame_times(rows), columns)


def _log_frame_plots(whole: _Track) -> None:
    """Energy, weights and errors of the result by frame."""
    plays = whole.plays
    names, energies = energy_series([play.reconstruction.energies for play in plays])
    colours = tuple(style.energy_colour(name, i) for i, name in enumerate(names))
    _plot(whole, f"{entities.FRAMES}/{entities.ENERGY}", energies, names, colours)
    weights = np.stack([play.reconstruction.weights for play in plays])
    _plot(whole, f"{entities.FRAMES}/{entities.WEIGHTS}", weights, *keypoint_series(plays[0]))
    known = [row for row, play in enumerate(plays) if play.truth is not None]
    errors = [
        play.truth.errors(play.reconstruction.camera_T_object, play.reconstruction.wireframe)
        for play in plays
        if play.truth is not None
    ]
    if errors:
        for index, (measure, values) in enumerate(error_series(errors).items()):
            entity = f"{entities.FRAMES}/{entities.ERROR}/{measure}"
            _plot(whole, entity, values, (measure_name(measure),), (style.categorical(index),), np.array(known))


def _plot(
    whole: _Track,
    entity: str,
    values: NDArray[np.float64],
    names: tuple[str, ...],
    colours: tuple[style.Colour, ...],
    rows: NDArray[np.int64] | None = None,
) -> None:
    """The series (n, M) of one entity over frames."""
    if values.shape[1]:
        whole.stream.send_fixed(entity, **series_style(names, colours))
        whole.stream.send_columns(entity, whole.frame_times(rows), series_columns(values))


def _log_joint(whole: _Track) -> None:
    """The joint optimisation: all wireframes, energies, coefficients, and every field of every step."""
    import rerun as rr

    history, times = whole.track.history, whole.joint_times()
    edges = whole.track.frames[0].edges
    shapes = np.stack([play.keypoints_in_camera[-len(history) :] for play in whole.plays], axis=1)  # (n, T, K, 3)
    strips = shapes[:, :, edges].reshape(len(history), -1, 2, 3)  # strips of all frames at each step
    whole.stream.send_fixed(entities.TRACK_3D, **line_style(3, (*style.SCREEN_INK, _FAINT), 0.6))
    whole.stream.send_columns(entities.TRACK_3D, times, [strip_column(rr.LineStrips3D, strips)])
    names, energies = energy_series([step.energies for step in history])
    colours = tuple(style.energy_colour(name, i) for i, name in enumerate(names))
    whole.stream.send_fixed(entities.ENERGY, **series_style(names, colours))
    whole.stream.send_columns(entities.ENERGY, times, series_columns(energies))
    coefficients = np.stack([step.coefficients for step in history])
    if coefficients.shape[1]:
        numbers = range(coefficients.shape[1])
        lambdas = tuple(f"lambda {j + 1}" for j in numbers)
        colours = tuple(style.categorical(j) for j in numbers)
        whole.stream.send_fixed(entities.COEFFICIENTS, **series_style(lambdas, colours))
        whole.stream.send_columns(entities.COEFFICIENTS, times, series_columns(coefficients))
    fields: dict[str, Any] = {
        "irls": [step.irls for step in history],
        "step": [step.step for step in history],
        "poses": np.stack([step.poses for step in history]),
        "coefficients": coefficients,
        **energy_fields([step.energies for step in history]),
    }
    whole.stream.send_columns(entities.TRACK, times, [exact_column(entities.JOINT_ARCHETYPE, fields)])


def _log_words(whole: _Track) -> None:
    """What became of every image, every joint weight update, how it ended and why; and the summary."""
    import rerun as rr

    track = whole.track
    for index, reason in track.refused.items():
        line = f"frame {whole.sight.number(index)} was refused: {reason}"
        when = rr.TimeColumn(entities.FRAME, sequence=[whole.sight.number(index)])
        whole.stream.send_columns(entities.LOG, [when], log_columns([line], [WARN]))
    for play in whole.plays:
        searched = len(play.steps) - whole.joint_steps
        if searched > 0:
            energy = sum(play.steps[searched - 1].energies.values())
            text = f"frame {play.frame}: pose found in {searched} steps, energy {energy:.4g}"
            play.every_step(entities.LOG, log_columns([text], [INFO]), np.array([searched - 1]))
    level, end = status_line(track.status, track.message)
    last = {step.irls: row for row, step in enumerate(track.history)}
    if last:
        totals = [sum(track.history[row].energies.values()) for row in last.values()]
        texts = [f"joint {irls}: energy {total:.5g}" for irls, total in zip(last, totals, strict=True)]
        lines = log_columns([*texts, end], [*[INFO] * len(texts), level])
        whole.stream.send_columns(entities.LOG, whole.joint_times([*last.values(), whole.joint_steps - 1]), lines)
    else:
        whole.plays[-1].at_result(entities.LOG, log_columns([end], [level]))
    errors = [
        play.truth.errors(play.reconstruction.camera_T_object, play.reconstruction.wireframe)
        for play in whole.plays
        if play.truth is not None
    ]
    log_summary(whole.stream, track_table(track, errors))
