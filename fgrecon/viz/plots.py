"""The numbers and words of a recording: plots, exact history, text log and summary. Plots and history are in double."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.reconstruction import Status
from fgrecon.viz import entities, style
from fgrecon.viz.describe import describe_update, median_residual, summary_table, total_energy
from fgrecon.viz.playback import Playback
from fgrecon.viz.style import Colour

__all__ = ["log_history", "log_plots", "log_words"]


def log_plots(play: Playback) -> None:
    """Energy by term, weight by keypoint, coefficients and, where the truth is known, errors."""
    steps = play.steps
    terms = list(dict.fromkeys(term for step in steps for term in step.energies))
    for index, term in enumerate(terms):
        series = [step.energies.get(term) for step in steps]
        _plot(play, f"{entities.ENERGY}/{term}", series, style.energy_colour(term, index))
    totals = [total_energy(step) for step in steps]
    _plot(play, f"{entities.ENERGY}/{entities.TOTAL}", totals, style.energy_colour(entities.TOTAL, 0))
    sides = style.keypoint_sides(play.reconstruction.keypoint_names, play.reconstruction.wireframe)
    names = [name.replace("_", " ") for name in play.reconstruction.keypoint_names]
    _plots(play, entities.WEIGHTS, play.weights, names, style.series_colours(sides))
    coefficients = np.stack([step.coefficients for step in steps])
    numbers = range(coefficients.shape[1])
    names = [f"lambda {j + 1}" for j in numbers]
    _plots(play, entities.COEFFICIENTS, coefficients, names, [style.categorical(j) for j in numbers])
    if play.truth is not None:
        errors = [play.truth.errors(step.camera_T_object, step.keypoints) for step in steps]
        for index, measure in enumerate(errors[0]):
            series = [error[measure] for error in errors]
            what, _, unit = measure.rpartition("_")
            _plot(play, f"{entities.ERROR}/{measure}", series, style.categorical(index), f"{what} [{unit}]")


def _plot(play: Playback, entity: str, values: Sequence[float | None], colour: Colour, name: str = "") -> None:
    """One series, with no row where a step has no value; named after its entity unless told otherwise."""
    import rerun as rr

    present = np.array([value is not None for value in values])
    series = np.array([np.nan if value is None else value for value in values])
    name = name or entity.rpartition("/")[2]
    play.once(entity, rr.SeriesLines(names=name, colors=colour, widths=1.0 if name == entities.TOTAL else 2.0))
    play.every_step(entity, rr.Scalars.columns(scalars=series), present)


def _plots(
    play: Playback, entity: str, values: NDArray[np.float64], names: Sequence[str], colours: Sequence[Colour]
) -> None:
    """Several series (n, M) of one entity."""
    import rerun as rr

    size = values.shape[1]
    if size:
        play.once(entity, rr.SeriesLines(names=list(names), colors=list(colours), widths=[1.5] * size))
        play.every_step(entity, rr.Scalars.columns(scalars=values.ravel()).partition([size] * len(values)))


def log_history(play: Playback) -> None:
    """Every field of every step, to the last bit: what `fgrecon.replay` makes the history of again."""
    import rerun as rr

    steps = play.steps

    def column(name: str, values: Sequence[Any]) -> Any:
        """One component, whose row i holds all elements of values[i]."""
        parts = [np.atleast_1d(value).ravel() for value in values]
        (batch,) = rr.DynamicArchetype.columns(entities.HISTORY_ARCHETYPE, components={name: np.concatenate(parts)})
        return batch.partition([len(part) for part in parts])

    arrays = ("camera_T_object", "coefficients", "keypoints", "projections", "weights")
    values = {name: [getattr(step, name) for step in steps] for name in ("stage", "irls", "step", *arrays)}
    values["terms"] = [np.array(list(step.energies), dtype=np.str_) for step in steps]
    values["energies"] = [np.array(list(step.energies.values()), dtype=np.float64) for step in steps]
    play.every_step(entities.HISTORY, [column(name, part) for name, part in values.items()])


def log_words(play: Playback) -> None:
    """One line per weight update, how it ended and why; and the summary."""
    import rerun as rr

    result = play.reconstruction
    levels = {Status.CONVERGED: rr.TextLogLevel.INFO, Status.FAILED: rr.TextLogLevel.ERROR}
    end = rr.TextLog(f"{result.status.value}: {result.message}", level=levels.get(result.status, rr.TextLogLevel.WARN))
    for stage in play.stages:
        rows, texts = [], []
        for update in np.unique(stage.irls):
            members = stage.rows[stage.irls == update]
            steps = [play.steps[row] for row in members]
            residual = median_residual(play.observation, play.pixels[members[-1]], steps[-1].weights)
            rows.append(members[-1])
            texts.append(describe_update(steps, residual))
        columns = rr.TextLog.columns(text=texts, level=[str(rr.TextLogLevel.INFO)] * len(texts))
        play.stream.send_columns(entities.LOG, stage.times(np.array(rows)), columns)
    play.at_result(entities.LOG, end)
    table = summary_table(result, play.observation, play.truth)
    play.once(entities.SUMMARY, rr.TextDocument(table, media_type=rr.MediaType.MARKDOWN))
