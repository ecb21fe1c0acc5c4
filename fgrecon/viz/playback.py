"""Reconstructions on their way into a recording: their histories as arrays, and the ways of sending rows of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.reconstruction import Iteration
from fgrecon.core.vehicle_mesh import Side
from fgrecon.viz import entities, style
from fgrecon.viz.columns import Outbox, strip_columns
from fgrecon.viz.describe import weight_updates
from fgrecon.viz.geometry import image_points
from fgrecon.viz.subjects import SolvedVehicle, result_step


@dataclass(frozen=True)
class Playback:
    """A vehicle in one image, on its way into a stream."""

    stream: Outbox  # where it goes
    vehicle: SolvedVehicle
    frame: int = 0  # number of the image on the timeline `frame`
    # (n,) numbers of the steps on the timeline `step`; None counts them from 0
    numbers: NDArray[np.int64] | None = None
    # (n,) numbers of their weight updates on the timeline `irls`; None counts them from 0
    updates: NDArray[np.int64] | None = None
    # entities of the stream that have what does not change; shared by all frames of a track
    logged: set[str] = field(default_factory=set)

    @cached_property
    def steps(self) -> tuple[Iteration, ...]:
        """The history; where none was kept the result as its only step, of stage `result`; none where it failed."""
        result = self.vehicle.reconstruction
        if result.diagnostics.history or not self.vehicle.solved:
            return tuple(result.diagnostics.history)
        return (result_step(result),)

    @cached_property
    def irls(self) -> NDArray[np.int64]:
        """(n,) index of each step's weight update, counted across all stages."""
        return weight_updates(self.steps)

    @cached_property
    def times(self) -> Mapping[str, NDArray[np.int64]]:
        """(n,) position of every step on each timeline."""
        names = [step.stage for step in self.steps]
        order = {name: index for index, name in enumerate(dict.fromkeys(names))}
        return {
            entities.STEP: np.arange(len(names)) if self.numbers is None else self.numbers,
            entities.STAGE: np.array([order[name] for name in names], dtype=np.int64),
            entities.IRLS: self.irls if self.updates is None else self.updates,
            entities.FRAME: np.full(len(names), self.frame, dtype=np.int64),
        }

    def once(self, entity: str, archetype: Any, **fields: Any) -> None:
        """Send fields that stay the same, as `fixed` takes them."""
        if entity not in self.logged:
            self.logged.add(entity)
            self.stream.send_fixed(entity, archetype, **fields)

    def always(self, entity: str, columns: Iterable[Any]) -> None:
        """Send columns of one row without a time, once for all frames."""
        if (key := f"{entity} always") not in self.logged:
            self.logged.add(key)
            self.stream.send_columns(entity, [], columns)

    def at_steps(self, entity: str, columns: Iterable[Any], rows: Sequence[int] | NDArray[np.int64]) -> None:
        """Send component columns with one row for each of some steps."""
        self.stream.send_columns(entity, _time_columns({name: at[rows] for name, at in self.times.items()}), columns)

    def at_start(self, entity: str, columns: Iterable[Any]) -> None:
        """Send columns of one row that belong to the frame: at its first step, or once where there are no steps."""
        self._at(0, entity, columns)

    def at_result(self, entity: str, columns: Iterable[Any]) -> None:
        """Send columns of one row that only the result has: at the last step, or once where there are no steps."""
        self._at(len(self.steps) - 1, entity, columns)

    def _at(self, row: int, entity: str, columns: Iterable[Any]) -> None:
        if self.steps:
            self.at_steps(entity, columns, np.array([row]))
        else:
            self.stream.send_columns(entity, [], columns)


@dataclass(frozen=True)
class Rows:
    """The n steps of one or several frames of a vehicle, at least one, as arrays: one chunk for each entity."""

    plays: Sequence[Playback]

    @cached_property
    def steps(self) -> tuple[Iteration, ...]:
        """The steps, frame after frame."""
        return tuple(step for play in self.plays for step in play.steps)

    @cached_property
    def detected(self) -> Array:
        """(n, K, 2) detected keypoints of each step's frame, pixels; NaN where not measured."""
        return np.repeat([play.vehicle.observation.keypoints for play in self.plays], self._counts, axis=0)

    @cached_property
    def weights(self) -> Array:
        """(n, K) weights."""
        return np.array([step.weights for step in self.steps])

    @cached_property
    def colours(self) -> NDArray[np.uint8]:
        """(n, K, 3) colour of every keypoint by its weight."""
        return style.weight_colours(self.weights)

    @cached_property
    def coefficients(self) -> Array:
        """(n, N) coefficients."""
        return np.array([step.coefficients for step in self.steps])

    @cached_property
    def poses(self) -> Array:
        """(n, 4, 4) poses `camera_T_object`."""
        return np.array([step.camera_T_object for step in self.steps])

    @cached_property
    def keypoints(self) -> Array:
        """(n, K, 3) keypoints in the object frame."""
        return np.array([step.keypoints for step in self.steps])

    @cached_property
    def keypoints_in_camera(self) -> Array:
        """(n, K, 3) keypoints in the camera frame."""
        in_camera: Array = self.keypoints @ self.poses[:, :3, :3].transpose(0, 2, 1)
        return in_camera + self.poses[:, None, :3, 3]

    @cached_property
    def pixels(self) -> Array:
        """(n, K, 2) where the real image shows the wireframe; NaN where it does not."""
        parts = np.split(self.keypoints_in_camera, np.cumsum(self._counts)[:-1])
        pairs = zip(self.plays, parts, strict=True)
        pixels = [image_points(play.vehicle.camera, np.eye(4), points.reshape(-1, 3)) for play, points in pairs]
        return np.concatenate(pixels).reshape(len(self.steps), -1, 2)

    @cached_property
    def previous(self) -> NDArray[np.int64]:
        """(n,) row of the last step of the weight update before each step's; the frame's first in its first update."""
        starts = np.cumsum([0, *self._counts])
        before = [np.maximum(np.searchsorted(play.irls, play.irls) - 1, 0) for play in self.plays]
        return np.concatenate([rows + start for rows, start in zip(before, starts, strict=False)])

    @cached_property
    def edges(self) -> Mapping[Side, NDArray[np.int64]]:
        """The wireframe's edges by side; a side without edges is left out."""
        return {
            side: edges
            for side, edges in style.edges_by_side(self.plays[0].vehicle.reconstruction).items()
            if len(edges)
        }

    def once(self, entity: str, archetype: Any, **fields: Any) -> None:
        """Send fields that stay the same, as `fixed` takes them; `send` sends the others."""
        self.plays[0].once(entity, archetype, **fields)

    def send(self, entity: str, columns: Iterable[Any]) -> None:
        """Send component columns with one row per step."""
        self.plays[0].stream.send_columns(entity, self.time_columns, columns)

    def strips(self, entity: str, archetype: Any, strips: Array) -> None:
        """Send line strips (n, S, P, D), one batch per step; strips with a point that is not finite are left out."""
        self.send(entity, strip_columns(archetype, strips))

    @cached_property
    def _counts(self) -> list[int]:
        return [len(play.steps) for play in self.plays]

    @cached_property
    def time_columns(self) -> list[Any]:
        """Time columns with one row per step."""
        times = [play.times for play in self.plays]
        return _time_columns({name: np.concatenate([part[name] for part in times]) for name in times[0]})


def _time_columns(times: Mapping[str, NDArray[np.int64]]) -> list[Any]:
    return [rr.TimeColumn(timeline, sequence=at) for timeline, at in times.items()]
