"""The numbers and words of a recording: plots, exact history, text log and summary. Plots and history are in double."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr

from fgrecon.core.arrays import Array
from fgrecon.core.reconstruction import Reconstruction, Status
from fgrecon.core.vehicle_mesh import Colour, keypoint_sides
from fgrecon.viz import entities, style
from fgrecon.viz.columns import Outbox, exact_column, fixed_columns
from fgrecon.viz.describe import describe_stop, describe_update, median_residual, summary_table
from fgrecon.viz.playback import Playback, Rows

INFO, WARN = "INFO", "WARN"
"""Levels of the log's lines; that of a failure is `ERROR`."""


class PlotSink:
    """Sends plots whose n rows have the same times."""

    def __init__(self, stream: Outbox, times: list[Any], root: str = "") -> None:
        """Nothing is sent yet.

        Args:
            stream: Where they go.
            times: Time columns of n rows.
            root: What the entities begin with.
        """
        self._stream, self._times, self._root = stream, times, root

    def energies(self, energies: Sequence[Mapping[str, float]]) -> None:
        """Energy by term, and their total; NaN where a row has no such term."""
        terms = tuple(dict.fromkeys(term for row in energies for term in row))
        rows = [[row.get(term, np.nan) for term in terms] + [sum(row.values())] for row in energies]
        values = np.array(rows, dtype=np.float64).reshape(len(energies), -1)
        colours = tuple(style.energy_colour(name, i) for i, name in enumerate((*terms, entities.TOTAL)))
        self._send(entities.ENERGY, values, (*terms, entities.TOTAL), colours)

    def weights(self, weights: Array, result: Reconstruction) -> None:
        """Weights (n, K) of the keypoints of a result."""
        sides = keypoint_sides(result.shape.keypoint_names, result.wireframe)
        names = tuple(name.replace("_", " ") for name in result.shape.keypoint_names)
        self._send(entities.WEIGHTS, weights, names, style.series_colours(sides))

    def coefficients(self, coefficients: Array) -> None:
        """Coefficients (n, N) of the shape."""
        numbers = range(coefficients.shape[1])
        names = tuple(f"lambda {j + 1}" for j in numbers)
        self._send(entities.COEFFICIENTS, coefficients, names, tuple(style.categorical(j) for j in numbers))

    def errors(self, errors: Sequence[Mapping[str, float]]) -> None:
        """Distances from the truth, by measure such as `translation_m`; NaN where a row lacks one."""
        for index, measure in enumerate(dict.fromkeys(measure for row in errors for measure in row)):
            values = np.array([[row.get(measure, np.nan)] for row in errors])
            what, _, unit = measure.rpartition("_")
            self._send(f"{entities.ERROR}/{measure}", values, (f"{what} [{unit}]",), (style.categorical(index),))

    def _send(self, entity: str, values: Array, names: tuple[str, ...], colours: tuple[Colour, ...]) -> None:
        """Series (n, M) of one entity; the total is a thinner line."""
        if values.shape[1]:
            widths = tuple(1.0 if name == entities.TOTAL else 2.0 for name in names)
            entity = f"{self._root}{entity}"
            self._stream.send_fixed(entity, rr.SeriesLines, names=names, colors=colours, widths=widths)
            scalars = rr.Scalars.columns(scalars=values.ravel()).partition([values.shape[1]] * len(values))
            self._stream.send_columns(entity, self._times, scalars)


def log_plots(rows: Rows) -> None:
    """Energy by term, weight by keypoint, coefficients and, where the truth is known, errors."""
    (play,) = rows.plays
    plots, truth = PlotSink(play.stream, rows.time_columns), play.vehicle.truth
    plots.energies([step.energies for step in rows.steps])
    plots.weights(rows.weights, play.vehicle.reconstruction)
    plots.coefficients(rows.coefficients)
    if truth is not None:
        plots.errors([truth.errors(step.camera_T_object, step.keypoints) for step in rows.steps])


def log_history(rows: Rows) -> None:
    """Every field of every step, to the last bit: what `fgrecon.viz.replay` makes the history of again."""
    steps = rows.steps
    fields: dict[str, Any] = {
        "stage": [step.stage for step in steps],
        "irls": [step.irls for step in steps],
        "step": [step.step for step in steps],
        "camera_T_object": rows.poses,
        "coefficients": rows.coefficients,
        "keypoints": rows.keypoints,
        "projections": np.array([step.projections for step in steps]),
        "weights": rows.weights,
        **energy_fields([step.energies for step in steps]),
    }
    rows.send(entities.HISTORY, [exact_column(entities.HISTORY_ARCHETYPE, fields)])


def energy_fields(energies: Sequence[Mapping[str, float]]) -> dict[str, list[Any]]:
    """Names and energies of the terms of n states, as `exact_column` takes them."""
    return {
        "terms": [list(state) for state in energies],
        "energies": [list(state.values()) for state in energies],
    }


def log_words(play: Playback, rows: Rows | None) -> None:
    """One line per weight update, why each stage stopped, how it ended and why; and the summary.

    Args:
        play: What is recorded.
        rows: Its steps; None where it has none.
    """
    result = play.vehicle.reconstruction
    level, end = status_line(result.status, result.message)
    if rows is None:
        play.at_result(entities.LOG, log_columns([end], [level]))
    else:
        at, texts = _lines(rows)
        columns = log_columns([*texts, end], [*[INFO] * len(texts), level])
        play.at_steps(entities.LOG, columns, [*at, len(rows.steps) - 1])
    log_summary(play.stream, summary_table(play.vehicle))


def log_summary(stream: Outbox, table: str) -> None:
    """The summary, a table in Markdown."""
    look = fixed_columns(rr.TextDocument, media_type="text/markdown")
    stream.send_columns(entities.SUMMARY, [], [*look, *rr.TextDocument.columns(text=[table])])


def log_columns(texts: Sequence[str], levels: Sequence[str]) -> Any:
    """Columns of lines of the log and their levels, one a row."""
    return rr.TextLog.columns(text=texts, level=levels)


def status_line(status: Status, message: str) -> tuple[str, str]:
    """Level and text of the line that says how it ended, and why."""
    levels = {Status.CONVERGED: INFO, Status.FAILED: "ERROR"}
    return levels.get(status, WARN), f"{status.value}: {message}"


def _lines(rows: Rows) -> tuple[list[int], list[str]]:
    """Steps and lines of the log: every weight update, and after the last one of a stage why it stopped."""
    (play,) = rows.plays
    at, texts = [], []
    stages = play.times[entities.STAGE]
    ends = np.flatnonzero(np.diff(play.irls, append=-1))
    for start, end in zip([0, *(ends[:-1] + 1)], ends, strict=True):
        residual = median_residual(play.vehicle.observation, rows.pixels[end], rows.weights[end])
        at.append(int(end))
        texts.append(describe_update(rows.steps[start : end + 1], residual))
        if end + 1 == len(rows.steps) or stages[end + 1] != stages[end]:
            before = ends[ends < start]
            previous = rows.steps[before[-1]] if len(before) else None
            at.append(int(end))
            texts.append(describe_stop(previous, rows.steps[start : end + 1]))
    return at, texts
