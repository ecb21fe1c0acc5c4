"""The numbers and words of a recording: plots, exact history, text log and summary. Plots and history are in double."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.reconstruction import Status
from fgrecon.viz import entities, style
from fgrecon.viz.columns import Column, Outbox, column, exact_column, fixed_columns
from fgrecon.viz.describe import describe_stop, describe_update, median_residual, summary_table
from fgrecon.viz.playback import Playback, Rows
from fgrecon.viz.style import Colour

__all__ = [
    "INFO",
    "WARN",
    "energy_fields",
    "energy_series",
    "error_series",
    "keypoint_series",
    "log_columns",
    "log_history",
    "log_plots",
    "log_summary",
    "log_words",
    "series_columns",
    "series_style",
    "status_line",
]

INFO, WARN = "INFO", "WARN"
"""Levels of the log's lines; that of a failure is `ERROR`."""

Names = tuple[str, ...]


def log_plots(play: Playback) -> None:
    """Energy by term, weight by keypoint, coefficients and, where the truth is known, errors."""
    steps = play.steps
    names, energies = energy_series([step.energies for step in steps])
    _plot(play, entities.ENERGY, energies, names, tuple(style.energy_colour(n, i) for i, n in enumerate(names)))
    names, colours = keypoint_series(play)
    _plot(play, entities.WEIGHTS, play.weights, names, colours)
    numbers = range(play.coefficients.shape[1])
    names = tuple(f"lambda {j + 1}" for j in numbers)
    _plot(play, entities.COEFFICIENTS, play.coefficients, names, tuple(style.categorical(j) for j in numbers))
    if play.truth is not None:
        errors = [play.truth.errors(step.camera_T_object, step.keypoints) for step in steps]
        for index, (measure, values) in enumerate(error_series(errors).items()):
            entity = f"{entities.ERROR}/{measure}"
            _plot(play, entity, values, (measure_name(measure),), (style.categorical(index),))


def _plot(play: Playback, entity: str, values: NDArray[np.float64], names: Names, colours: tuple[Colour, ...]) -> None:
    """The series (n, M) of one entity."""
    if values.shape[1]:
        play.once(entity, **series_style(names, colours))
        play.every_step(entity, series_columns(values))


def series_style(names: Names, colours: tuple[Colour, ...]) -> dict[str, Any]:
    """Names and colours of the series of a plot, as `fixed` takes them; the total is a thinner line."""
    import rerun as rr

    widths = tuple(1.0 if name == entities.TOTAL else 2.0 for name in names)
    return {"archetype": rr.SeriesLines, "names": names, "colors": colours, "widths": widths}


def series_columns(values: NDArray[np.float64]) -> list[Column]:
    """Component columns of series (n, M), in double."""
    import rerun as rr

    return [column(rr.Scalars, "scalars", values.ravel(), values.shape[1])]


def energy_series(energies: Sequence[Mapping[str, float]]) -> tuple[Names, NDArray[np.float64]]:
    """Names of the terms and `total`, and (n, M) energies of n states; NaN where a state has no such term."""
    terms = tuple(dict.fromkeys(term for state in energies for term in state))
    rows = [[state.get(term, np.nan) for term in terms] + [sum(state.values())] for state in energies]
    return (*terms, entities.TOTAL), np.array(rows, dtype=np.float64).reshape(len(energies), -1)


def keypoint_series(play: Playback) -> tuple[Names, tuple[Colour, ...]]:
    """Names and colours of one series per keypoint."""
    sides = style.keypoint_sides(play.reconstruction.keypoint_names, play.reconstruction.wireframe)
    names = tuple(name.replace("_", " ") for name in play.reconstruction.keypoint_names)
    return names, style.series_colours(sides)


def error_series(errors: Sequence[Mapping[str, float]]) -> dict[str, NDArray[np.float64]]:
    """(n, 1) distances from the truth by measure; NaN where a state lacks one."""
    measures = dict.fromkeys(measure for state in errors for measure in state)
    return {measure: np.array([[state.get(measure, np.nan)] for state in errors]) for measure in measures}


def measure_name(measure: str) -> str:
    """`translation_m` as `translation [m]`."""
    what, _, unit = measure.rpartition("_")
    return f"{what} [{unit}]"


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


def log_words(play: Playback) -> None:
    """One line per weight update, why each stage stopped, how it ended and why; and the summary."""
    rows, texts = _lines(play) if play.steps else ([], [])
    level, end = status_line(play.reconstruction.status, play.reconstruction.message)
    columns = log_columns([*texts, end], [*[INFO] * len(texts), level])
    if play.steps:
        play.every_step(entities.LOG, columns, np.array([*rows, len(play.steps) - 1]))
    else:
        play.at_result(entities.LOG, columns)
    table = summary_table(play.reconstruction, play.observation, play.truth)
    log_summary(play.stream, table)


def log_summary(stream: Outbox, table: str) -> None:
    """The summary, a table in Markdown."""
    import rerun as rr

    look = fixed_columns(rr.TextDocument, media_type="text/markdown")
    stream.send_columns(entities.SUMMARY, [], [*look, column(rr.TextDocument, "text", [table])])


def log_columns(texts: Sequence[str], levels: Sequence[str]) -> list[Column]:
    """Columns of lines of the log and their levels, one a row."""
    import rerun as rr

    return [column(rr.TextLog, "text", texts, 1), column(rr.TextLog, "level", levels, 1)]


def status_line(status: Status, message: str) -> tuple[str, str]:
    """Level and text of the line that says how it ended, and why."""
    levels = {Status.CONVERGED: INFO, Status.FAILED: "ERROR"}
    return levels.get(status, WARN), f"{status.value}: {message}"


def _lines(play: Playback) -> tuple[list[int], list[str]]:
    """Steps and lines of the log: every weight update, and after the last one of a stage why it stopped."""
    rows, texts = [], []
    stages = play.times[entities.STAGE]
    ends = np.flatnonzero(np.diff(play.irls, append=-1))
    for start, end in zip([0, *(ends[:-1] + 1)], ends, strict=True):
        residual = median_residual(play.observation, play.pixels[end], play.weights[end])
        rows.append(int(end))
        texts.append(describe_update(play.steps[start : end + 1], residual))
        if end + 1 == len(play.steps) or stages[end + 1] != stages[end]:
            before = ends[ends < start]
            previous = play.steps[before[-1]] if len(before) else None
            rows.append(int(end))
            texts.append(describe_stop(previous, play.steps[start : end + 1]))
    return rows, texts
