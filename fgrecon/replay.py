"""Reads a recording back as arrays, without a viewer: a recording is data, not only a picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.errors import InvalidInputError
from fgrecon.reconstruction import Iteration
from fgrecon.viz import entities

__all__ = ["LogLine", "Replay", "Series", "StageSummary", "read"]

_SCALARS = "Scalars:scalars"
_TEXT, _LEVEL = "TextLog:text", "TextLog:level"


@dataclass(frozen=True)
class Series:
    """One plotted entity.

    Attributes:
        steps: (n,) global steps, increasing.
        values: (n,) numbers, or (n, M) where the entity holds M series.
    """

    steps: NDArray[np.int64]
    values: NDArray[np.float64]


@dataclass(frozen=True)
class LogLine:
    """One line of the text log, with its global step (None where there was no step) and level (`INFO`, ...)."""

    step: int | None
    level: str
    text: str


@dataclass(frozen=True)
class StageSummary:
    """One stage: how many weight updates and steps it took, and the total energy at its first and last step."""

    stage: str
    weight_updates: int
    steps: int
    first_energy: float
    last_energy: float


@dataclass(frozen=True)
class Replay:
    """What a recording holds apart from what it draws.

    Attributes:
        history: Every step of the optimisation, equal to the recorded one to the last bit.
        scalars: Plotted series by entity, such as `energy/total`, `weights`, `error/translation_m`.
        log: The text log in order; its last line says how it ended and why.
    """

    history: tuple[Iteration, ...]
    scalars: Mapping[str, Series]
    log: tuple[LogLine, ...]

    def summary(self) -> tuple[StageSummary, ...]:
        """The stages in order of their first step."""
        stages = dict.fromkeys(step.stage for step in self.history)
        return tuple(self._summarise(stage) for stage in stages)

    def _summarise(self, stage: str) -> StageSummary:
        steps = [step for step in self.history if step.stage == stage]
        first, last = (float(sum(step.energies.values())) for step in (steps[0], steps[-1]))
        return StageSummary(stage, len({step.irls for step in steps}), len(steps), first, last)


def read(path: str | Path) -> Replay:
    """Read a recording that `fgrecon.viz.record` wrote.

    Raises:
        InvalidInputError: There is no such file, or it is no recording of fgrecon.
    """
    from rerun.chunk import RrdReader  # on use: importing fgrecon must not import rerun

    fix = "Give a .rrd file that fgrecon wrote."
    if not Path(path).is_file():
        raise InvalidInputError("recording", str(path), fix)
    history: list[tuple[int, Iteration]] = []
    rows: dict[str, list[tuple[int, NDArray[np.float64]]]] = {}
    log: list[LogLine] = []
    try:
        for chunk in RrdReader(path).stream():
            columns = chunk.to_record_batch().to_pydict()
            entity = str(chunk.entity_path).strip("/")
            steps = columns.get(entities.STEP)
            if entity == entities.HISTORY and steps is not None:
                history += [(step, _iteration(columns, i)) for i, step in enumerate(steps)]
            elif _SCALARS in columns and steps is not None:
                rows.setdefault(entity, []).extend(zip(steps, map(np.array, columns[_SCALARS]), strict=True))
            elif entity == entities.LOG and _TEXT in columns:
                log += _lines(columns, steps)
    except (RuntimeError, ValueError, KeyError, OSError) as error:
        raise InvalidInputError("recording", f"{path}: {error}", fix) from error
    if not log:
        raise InvalidInputError("recording", f"{path} holds no log of fgrecon", fix)
    log.sort(key=lambda line: -1 if line.step is None else line.step)
    history.sort(key=lambda item: item[0])
    return Replay(tuple(step for _, step in history), {name: _series(rows[name]) for name in sorted(rows)}, tuple(log))


def _series(rows: list[tuple[int, NDArray[np.float64]]]) -> Series:
    rows.sort(key=lambda row: row[0])
    values = np.stack([value for _, value in rows])
    steps = np.array([step for step, _ in rows], dtype=np.int64)
    return Series(steps, values[:, 0] if values.shape[1] == 1 else values)


def _lines(columns: Mapping[str, Any], steps: list[int] | None) -> list[LogLine]:
    texts, levels = columns[_TEXT], columns[_LEVEL]
    at = [None] * len(texts) if steps is None else steps
    return [LogLine(step, level[0], text[0]) for step, text, level in zip(at, texts, levels, strict=True)]


def _iteration(columns: Mapping[str, Any], row: int) -> Iteration:
    def field(name: str) -> list[Any]:
        values: list[Any] = columns[f"{entities.HISTORY_ARCHETYPE}:{name}"][row] or []
        return values

    def array(name: str, *shape: int) -> NDArray[np.float64]:
        return np.array(field(name), dtype=np.float64).reshape(shape)

    return Iteration(
        stage=field("stage")[0],
        irls=field("irls")[0],
        step=field("step")[0],
        camera_T_object=array("camera_T_object", 4, 4),
        coefficients=array("coefficients", -1),
        keypoints=array("keypoints", -1, 3),
        projections=array("projections", -1, 2),
        weights=array("weights", -1),
        energies=dict(zip(field("terms"), field("energies"), strict=True)),
    )
