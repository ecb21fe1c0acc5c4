"""Reader of a recording as arrays, without a viewer: a recording is data, not only a picture."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.reconstruction import Iteration
from fgrecon.core.text import whole_text
from fgrecon.core.track_reconstruction import JointStep
from fgrecon.io.isolated import Isolated
from fgrecon.viz import entities
from fgrecon.viz.columns import FIELDS
from fgrecon.viz.sinks import APPLICATION

_SCALARS, _NAMES = "Scalars:scalars", "SeriesLines:names"
_WORDS_AND_STEPS = (entities.HISTORY, entities.TRACK, entities.LOG)
_TEXT, _LEVEL = "TextLog:text", "TextLog:level"

_FIX = "Give a .rrd file that this version of fgrecon wrote."


@dataclass(frozen=True)
class Series:
    """One plotted entity."""

    names: tuple[str, ...]  # M names of its series, as in the legend
    timeline: str  # what `times` counts: `step`, or for numbers by frame of a track or video `frame`
    times: NDArray[np.int64]  # (n,) increasing
    values: Array  # (n, M) numbers; NaN where a series has none

    def __getitem__(self, name: str) -> Array:
        """(n,) values of the series of a name.

        Raises:
            KeyError: There is none.
        """
        if name not in self.names:
            raise KeyError(name)
        return self.values[:, self.names.index(name)]


@dataclass(frozen=True)
class LogLine:
    """One line of the text log, with its global step (None where there was no step) and level (`INFO`, ...)."""

    step: int | None
    level: str
    text: str


@dataclass(frozen=True)
class StageSummary:
    """One stage, of a track over all frames, of a scene over all vehicles."""

    stage: str  # its name
    weight_updates: int  # how many weight updates it took, in all of them together
    steps: int  # how many steps, likewise
    first_energy: float  # total energy at its first step, nats
    last_energy: float  # total energy at its last step
    terms: Mapping[str, float]  # energy by term at its last step


@dataclass(frozen=True)
class Replay:
    """What a recording holds apart from what it draws."""

    # every step of the optimisation by number of the frame, equal to the recorded one to the last bit; a single
    # vehicle's only frame has number 0
    frames: Mapping[int, tuple[Iteration, ...]]
    joint: tuple[JointStep, ...]  # of a track every step of its joint optimisation, to the last bit too; else empty
    scalars: Mapping[str, Series]  # plotted series by entity, such as `energy`, `weights`, `error/translation_m`
    log: tuple[LogLine, ...]  # the text log in order; its last line says how it ended and why
    # of a scene the same of each vehicle, by its name in paths; the scene's own frames, scalars and log are then
    # empty
    vehicles: Mapping[str, Replay] = field(default_factory=dict)

    @property
    def history(self) -> tuple[Iteration, ...]:
        """Every step, frame after frame or vehicle after vehicle."""
        return tuple(step for steps in self._histories() for step in steps)

    def summary(self) -> tuple[StageSummary, ...]:
        """The stages in order of their first step, over all frames or vehicles.

        A track's joint stage is listed once, with the terms of the shape.
        """
        stages, histories = dict.fromkeys(step.stage for step in self.history), self._histories()
        summaries = [
            _summary(stage, [[step for step in steps if step.stage == stage] for steps in histories])
            for stage in stages
            if not (self.joint and stage == "joint")
        ]
        return (*summaries, _summary("joint", [self.joint])) if self.joint else tuple(summaries)

    def _histories(self) -> list[tuple[Iteration, ...]]:
        return [steps for part in (self, *self.vehicles.values()) for steps in part.frames.values()]


def _summary(stage: str, histories: Sequence[Sequence[Iteration | JointStep]]) -> StageSummary:
    """A stage over the steps of it of all frames or vehicles: counts and energies are added up."""
    members = [steps for steps in histories if steps]
    terms: dict[str, float] = {}
    for steps in members:
        for name, energy in steps[-1].energies.items():
            terms[name] = terms.get(name, 0.0) + energy
    return StageSummary(
        stage=stage,
        weight_updates=sum(len({step.irls for step in steps}) for steps in members),
        steps=sum(len(steps) for steps in members),
        first_energy=float(sum(sum(steps[0].energies.values()) for steps in members)),
        last_energy=float(sum(sum(steps[-1].energies.values()) for steps in members)),
        terms=terms,
    )


def read(path: str | Path) -> Replay:
    """Read a recording that fgrecon wrote; one of a video has plots, and one of a shape prior nothing but drawings.

    Raises:
        InvalidInputError: There is no such file, or it is no recording of fgrecon.
    """
    if not Path(path).is_file():
        raise InvalidInputError("recording", str(path), _FIX)
    with Isolated() as child, _named_in_text(Path(path)) as file:  # a damaged file ends the process that decodes it
        return child("recording", _read, file)


@contextmanager
def _named_in_text(path: Path) -> Iterator[Path]:
    """The file by a name that rerun takes: a link to it where its own is not UTF-8."""
    if whole_text(str(path)) == str(path):
        yield path
        return
    with TemporaryDirectory(prefix="fgrecon-") as folder:
        link = Path(folder) / "recording.rrd"
        link.symlink_to(path.resolve())
        yield link


def _read(path: Path) -> Replay:
    from rerun.chunk import RrdReader  # on use: importing fgrecon must not import rerun

    found: dict[str, _Found] = {}
    try:
        applications = [entry.application_id for entry in RrdReader(path).recordings()]
        for entity, columns in _chunks(path):
            vehicle, within = _whose(entity)
            found.setdefault(vehicle, _Found()).add(within, columns)
        read = {name: part.replay() for name, part in sorted(found.items())}
    except (RuntimeError, ValueError, LookupError, TypeError, OSError) as error:  # rows may be empty or null
        raise InvalidInputError("recording", str(path), f"{_FIX} The reason: {error}") from error
    ours = any(application.startswith(APPLICATION) for application in applications)
    if not (ours or any(part.log for part in read.values())):  # a stream of the user's own may have another name
        raise InvalidInputError("recording", str(path), f"{_FIX} This one holds no log of it.")
    own = read.pop("", _Found().replay())
    return replace(own, vehicles=read)


def _whose(entity: str) -> tuple[str, str]:
    """The vehicle of a scene that an entity belongs to, and its name in the recording of that vehicle alone."""
    head, _, rest = entity.partition("/")
    vehicle, _, within = rest.partition("/")
    return (vehicle, within) if head == entities.IN_VEHICLES and within else ("", entity)


def _chunks(path: str | Path) -> Iterator[tuple[str, dict[str, list[Any]]]]:
    """Entity and columns of every chunk that holds words, steps or plotted numbers."""
    from rerun.chunk import RrdReader

    for chunk in RrdReader(path).stream():
        entity = str(chunk.entity_path).strip("/")
        batch = chunk.to_record_batch()
        # What is drawn stays out: photographs alone would take minutes as lists of numbers.
        if _whose(entity)[1] in _WORDS_AND_STEPS or {_SCALARS, _NAMES} & set(batch.schema.names):
            yield entity, batch.to_pydict()


@dataclass(frozen=True)
class _Found:
    """What the chunks of a vehicle, or of a recording without several, hold so far."""

    history: list[tuple[int, int, Iteration]] = field(default_factory=list)  # frame, step and state
    joint: list[tuple[int, JointStep]] = field(default_factory=list)
    rows: dict[str, list[tuple[int, list[float]]]] = field(
        default_factory=dict
    )  # of plots: time and numbers, by entity
    names: dict[str, tuple[str, ...]] = field(default_factory=dict)
    log: list[LogLine] = field(default_factory=list)

    def add(self, entity: str, columns: Mapping[str, list[Any]]) -> None:
        """Take in a chunk; a KeyError or ValueError where columns are missing or have different lengths."""
        steps, frames = columns.get(entities.STEP), columns.get(entities.FRAME)
        if entity == entities.HISTORY and steps is not None and frames is not None:
            states = columns[f"{entities.HISTORY_ARCHETYPE}:{FIELDS}"]
            self.history.extend((f, s, _iteration(row)) for f, s, (row,) in zip(frames, steps, states, strict=True))
        elif entity == entities.TRACK and steps is not None:
            states = columns[f"{entities.JOINT_ARCHETYPE}:{FIELDS}"]
            self.joint.extend((step, _joint_step(row)) for step, (row,) in zip(steps, states, strict=True))
        elif _SCALARS in columns:
            times = frames if _timeline(entity) == entities.FRAME else steps
            self.rows.setdefault(entity, []).extend(zip(times or [], columns[_SCALARS], strict=True))
        elif _NAMES in columns:
            self.names[entity] = tuple(columns[_NAMES][0])
        elif entity == entities.LOG and _TEXT in columns:
            texts, levels = columns[_TEXT], columns[_LEVEL]
            at = [None] * len(texts) if steps is None else steps
            self.log.extend(LogLine(s, level[0], text[0]) for s, text, level in zip(at, texts, levels, strict=True))

    def replay(self) -> Replay:
        """All of it in order."""
        by_frame = groupby(sorted(self.history, key=lambda item: item[:2]), key=itemgetter(0))
        return Replay(
            frames={frame: tuple(step for *_, step in steps) for frame, steps in by_frame},
            joint=tuple(step for _, step in sorted(self.joint, key=itemgetter(0))),
            scalars={name: self._series(name) for name in sorted(self.rows)},
            log=tuple(sorted(self.log, key=lambda line: -1 if line.step is None else line.step)),
        )

    def _series(self, entity: str) -> Series:
        rows = sorted(self.rows[entity], key=itemgetter(0))
        times = np.array([time for time, _ in rows], dtype=np.int64)
        values = np.array([numbers for _, numbers in rows], dtype=np.float64)
        return Series(self.names.get(entity, ()), _timeline(entity), times, values)


def _timeline(entity: str) -> str:
    """The timeline of a plot."""
    return entities.FRAME if entity.startswith((f"{entities.FRAMES}/", f"{entities.PLOTS}/")) else entities.STEP


def _iteration(fields: Mapping[str, Any]) -> Iteration:
    return Iteration(
        stage=fields["stage"],
        irls=fields["irls"],
        step=fields["step"],
        camera_T_object=_array(fields["camera_T_object"], 4, 4),
        coefficients=_array(fields["coefficients"], -1),
        keypoints=_array(fields["keypoints"], -1, 3),
        projections=_array(fields["projections"], -1, 2),
        weights=_array(fields["weights"], -1),
        energies=dict(zip(fields["terms"], fields["energies"], strict=True)),
    )


def _joint_step(fields: Mapping[str, Any]) -> JointStep:
    return JointStep(
        irls=fields["irls"],
        step=fields["step"],
        poses=_array(fields["poses"], -1, 4, 4),
        coefficients=_array(fields["coefficients"], -1),
        energies=dict(zip(fields["terms"], fields["energies"], strict=True)),
    )


def _array(numbers: Sequence[float], *shape: int) -> Array:
    return np.array(numbers, dtype=np.float64).reshape(shape)
