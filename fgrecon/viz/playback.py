"""A reconstruction's history as arrays, and the ways of sending rows of it into a recording stream."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import Iteration, Reconstruction
from fgrecon.viz import entities, style
from fgrecon.viz.columns import Outbox, strip_column
from fgrecon.viz.describe import weight_updates
from fgrecon.viz.geometry import image_points
from fgrecon.viz.style import Side
from fgrecon.viz.truth import Truth

__all__ = ["RESULT", "Playback", "Rows"]

RESULT = "result"
"""Stage of the only step of a recording without a history."""


@dataclass(frozen=True)
class Playback:
    """One reconstruction on its way into a stream, its history as arrays.

    Attributes:
        stream: Where it goes.
        reconstruction: The result.
        observation: The keypoints that it was solved from.
        camera: The camera that saw them.
        truth: What is known to be true, or None.
        frame: Number of the image on the timeline `frame`.
        numbers: (n,) numbers of the steps on the timeline `step`; None counts them from 0.
        updates: (n,) numbers of their weight updates on the timeline `irls`; None counts them from 0.
        logged: Entities of the stream that have what does not change; shared by all frames of a track.
    """

    stream: Outbox
    reconstruction: Reconstruction
    observation: Observation
    camera: Camera
    truth: Truth | None
    frame: int = 0
    numbers: NDArray[np.int64] | None = None
    updates: NDArray[np.int64] | None = None
    logged: set[str] = field(default_factory=set)

    @cached_property
    def steps(self) -> tuple[Iteration, ...]:
        """The history; where none was kept the result as its only step, of stage `result`; none where it failed."""
        result = self.reconstruction
        if result.history or not np.isfinite(result.camera_T_object).all():
            return tuple(result.history)
        last = Iteration(
            stage=RESULT,
            irls=0,
            step=0,
            camera_T_object=result.camera_T_object,
            coefficients=result.coefficients,
            keypoints=result.wireframe,
            projections=result.wireframe_uv,
            weights=result.weights,
            energies=result.energies,
        )
        return (last,)

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

    @cached_property
    def weights(self) -> NDArray[np.float64]:
        """(n, K) weights of every step."""
        return np.array([step.weights for step in self.steps])

    @cached_property
    def colours(self) -> NDArray[np.uint8]:
        """(n, K, 3) colour of every keypoint by its weight."""
        return style.weight_colours(self.weights)

    @cached_property
    def coefficients(self) -> NDArray[np.float64]:
        """(n, N) coefficients of every step."""
        return np.array([step.coefficients for step in self.steps])

    @cached_property
    def poses(self) -> NDArray[np.float64]:
        """(n, 4, 4) pose of every step."""
        return np.array([step.camera_T_object for step in self.steps])

    @cached_property
    def keypoints(self) -> NDArray[np.float64]:
        """(n, K, 3) keypoints of every step in the object frame."""
        return np.array([step.keypoints for step in self.steps])

    @cached_property
    def keypoints_in_camera(self) -> NDArray[np.float64]:
        """(n, K, 3) keypoints of every step in the camera frame."""
        in_camera: NDArray[np.float64] = self.keypoints @ self.poses[:, :3, :3].transpose(0, 2, 1)
        return in_camera + self.poses[:, None, :3, 3]

    @cached_property
    def pixels(self) -> NDArray[np.float64]:
        """(n, K, 2) where the real image shows the wireframe of every step; NaN where it does not."""
        points = self.keypoints_in_camera
        return image_points(self.camera, np.eye(4), points.reshape(-1, 3)).reshape(*points.shape[:2], 2)

    @cached_property
    def previous(self) -> NDArray[np.int64]:
        """(n,) row of the last step of the weight update before each step's; its own first row in the first update."""
        starts = np.searchsorted(self.irls, self.irls)
        return np.maximum(starts - 1, 0)

    def once(self, entity: str, archetype: Any, **fields: Any) -> None:
        """Send fields that stay the same, as `fixed` takes them; `every_step` sends the others."""
        _once(self.stream, self.logged, entity, archetype, fields)

    def always(self, entity: str, columns: Iterable[Any]) -> None:
        """Send columns of one row without a time, once for all frames."""
        if (key := f"{entity} always") not in self.logged:
            self.logged.add(key)
            self.stream.send_columns(entity, [], columns)

    def every_step(self, entity: str, columns: Iterable[Any], rows: NDArray[np.int64] | None = None) -> None:
        """Send component columns with one row per step, or one per step of `rows` (m,)."""
        times = self._all_times if rows is None else self._times_at(rows)
        self.stream.send_columns(entity, times, columns)

    def at_start(self, entity: str, columns: Iterable[Any]) -> None:
        """Send columns of one row that belong to the frame: at its first step, or once where there are no steps."""
        self._at(0, entity, columns)

    def at_result(self, entity: str, columns: Iterable[Any]) -> None:
        """Send columns of one row that only the result has: at the last step, or once where there are no steps."""
        self._at(len(self.steps) - 1, entity, columns)

    def _at(self, row: int, entity: str, columns: Iterable[Any]) -> None:
        if self.steps:
            self.every_step(entity, columns, np.array([row]))
        else:
            self.stream.send_columns(entity, [], columns)

    @cached_property
    def _all_times(self) -> list[Any]:
        return self._times_at(np.arange(len(self.steps)))

    def _times_at(self, rows: NDArray[np.int64]) -> list[Any]:
        import rerun as rr

        return [rr.TimeColumn(timeline, sequence=at[rows]) for timeline, at in self.times.items()]


@dataclass(frozen=True)
class Rows:
    """Steps of one or several frames on their way into a stream as arrays, n in all: one chunk for each entity.

    Attributes:
        stream: Where it goes.
        look: A result with the names, edges, faces and pairs that all frames have.
        steps: The n steps.
        times: (n,) position of every step on each timeline.
        detected: (n, K, 2) detected keypoints of each step's frame, pixels; NaN where not measured.
        pixels: (n, K, 2) where the real image shows the wireframe; NaN where it does not.
        weights: (n, K) weights.
        colours: (n, K, 3) colour of every keypoint by its weight.
        coefficients: (n, N) coefficients.
        poses: (n, 4, 4) poses.
        keypoints: (n, K, 3) keypoints in the object frame.
        keypoints_in_camera: (n, K, 3) the same in the camera frame.
        previous: (n,) row of the last step of the weight update before each step's; the frame's first in its first.
        logged: Entities of the stream that have what does not change.
    """

    stream: Outbox
    look: Reconstruction
    steps: tuple[Iteration, ...]
    times: Mapping[str, NDArray[np.int64]]
    detected: NDArray[np.float64]
    pixels: NDArray[np.float64]
    weights: NDArray[np.float64]
    colours: NDArray[np.uint8]
    coefficients: NDArray[np.float64]
    poses: NDArray[np.float64]
    keypoints: NDArray[np.float64]
    keypoints_in_camera: NDArray[np.float64]
    previous: NDArray[np.int64]
    logged: set[str]

    @classmethod
    def of(cls, plays: Sequence[Playback]) -> Rows:
        """The steps of all frames, one after the other; at least one step."""
        first = np.cumsum([0, *(len(play.steps) for play in plays)])
        seen = [np.broadcast_to(p.observation.keypoints, (len(p.steps), *p.observation.keypoints.shape)) for p in plays]
        return cls(
            stream=plays[0].stream,
            look=plays[0].reconstruction,
            steps=tuple(step for play in plays for step in play.steps),
            times={name: np.concatenate([play.times[name] for play in plays]) for name in plays[0].times},
            detected=np.concatenate(seen),
            pixels=np.concatenate([play.pixels for play in plays]),
            weights=np.concatenate([play.weights for play in plays]),
            colours=np.concatenate([play.colours for play in plays]),
            coefficients=np.concatenate([play.coefficients for play in plays]),
            poses=np.concatenate([play.poses for play in plays]),
            keypoints=np.concatenate([play.keypoints for play in plays]),
            keypoints_in_camera=np.concatenate([play.keypoints_in_camera for play in plays]),
            previous=np.concatenate([play.previous + start for play, start in zip(plays, first, strict=False)]),
            logged=plays[0].logged,
        )

    @cached_property
    def edges(self) -> Mapping[Side, NDArray[np.int64]]:
        """The wireframe's edges by side; a side without edges is left out."""
        sides = style.keypoint_sides(self.look.keypoint_names, self.look.wireframe)
        return {side: e for side, e in style.edge_sides(self.look.edges, sides).items() if len(e)}

    def once(self, entity: str, archetype: Any, **fields: Any) -> None:
        """Send fields that stay the same, as `fixed` takes them; `send` sends the others."""
        _once(self.stream, self.logged, entity, archetype, fields)

    def send(self, entity: str, columns: Iterable[Any]) -> None:
        """Send component columns with one row per step."""
        self.stream.send_columns(entity, self._time_columns, columns)

    def strips(self, entity: str, archetype: Any, strips: NDArray[np.float64]) -> None:
        """Send line strips (n, S, P, D), one batch per step; strips with a point that is not finite are left out."""
        self.send(entity, [strip_column(archetype, strips)])

    @cached_property
    def _time_columns(self) -> list[Any]:
        import rerun as rr

        return [rr.TimeColumn(timeline, sequence=at) for timeline, at in self.times.items()]


def _once(stream: Outbox, logged: set[str], entity: str, archetype: Any, fields: Mapping[str, Any]) -> None:
    if entity not in logged:
        logged.add(entity)
        stream.send_fixed(entity, archetype, **fields)
