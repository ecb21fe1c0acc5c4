"""A reconstruction's history as arrays, and the ways of sending rows of it into a recording stream."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.camera import Camera
from fgrecon.observation import Observation
from fgrecon.reconstruction import Iteration, Reconstruction
from fgrecon.viz import entities, style
from fgrecon.viz.describe import weight_updates
from fgrecon.viz.geometry import image_points
from fgrecon.viz.style import Side
from fgrecon.viz.truth import Truth

__all__ = ["RESULT", "Playback", "Stage"]

RESULT = "result"
"""Stage of the only step of a recording without a history."""


@dataclass(frozen=True)
class Stage:
    """The steps of one stage: their rows in the history, and the weight update that each belongs to."""

    name: str
    rows: NDArray[np.int64]
    irls: NDArray[np.int64]

    def times(self, rows: NDArray[np.int64]) -> list[Any]:
        """Time columns of some of the stage's rows."""
        import rerun as rr

        local = np.searchsorted(self.rows, rows)
        indices = {entities.STEP: rows, entities.IRLS: self.irls[local], self.name: local}
        return [rr.TimeColumn(timeline, sequence=index) for timeline, index in indices.items()]


@dataclass(frozen=True)
class Playback:
    """One reconstruction on its way into a stream, its history as arrays."""

    stream: Any
    reconstruction: Reconstruction
    observation: Observation
    camera: Camera
    truth: Truth | None

    @cached_property
    def steps(self) -> tuple[Iteration, ...]:
        """The history; where none was kept the result as its only step, of stage `result`; none where it failed."""
        result = self.reconstruction
        if result.history or not np.isfinite(result.camera_T_object).all():
            return result.history
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
    def stages(self) -> tuple[Stage, ...]:
        """The stages in order of their first step."""
        names, irls = np.array([step.stage for step in self.steps]), weight_updates(self.steps)
        ordered = dict.fromkeys(names.tolist())
        groups = {name: np.flatnonzero(names == name).astype(np.int64) for name in ordered}
        return tuple(Stage(name, rows, irls[rows]) for name, rows in groups.items())

    @cached_property
    def weights(self) -> NDArray[np.float64]:
        """(n, K) weights of every step."""
        return np.stack([step.weights for step in self.steps])

    @cached_property
    def keypoints(self) -> NDArray[np.float64]:
        """(n, K, 3) keypoints of every step in the object frame."""
        return np.stack([step.keypoints for step in self.steps])

    @cached_property
    def pixels(self) -> NDArray[np.float64]:
        """(n, K, 2) where the real image shows the wireframe of every step; NaN where it does not."""
        return np.stack([image_points(self.camera, step.camera_T_object, step.keypoints) for step in self.steps])

    @cached_property
    def edges(self) -> Mapping[Side, NDArray[np.int64]]:
        """The wireframe's edges by side; a side without edges is left out."""
        sides = style.keypoint_sides(self.reconstruction.keypoint_names, self.reconstruction.wireframe)
        return {side: e for side, e in style.edge_sides(self.reconstruction.edges, sides).items() if len(e)}

    def once(self, entity: str, *archetypes: Any) -> None:
        """Log what does not change; together with `every_step` it fills in the components that stay the same."""
        for archetype in archetypes:
            self.stream.log(entity, archetype, static=True)

    def every_step(self, entity: str, columns: Iterable[Any], present: NDArray[np.bool_] | None = None) -> None:
        """Send one row per step, or per step that is `present` (n,), from rerun component columns of n rows."""
        whole = [(column.component_descriptor(), column.as_arrow_array()) for column in columns]
        for stage in self.stages:
            rows = stage.rows if present is None else stage.rows[present[stage.rows]]
            if len(rows):
                # The arrays are made once and cut by stage: making them costs more than sending them.
                parts = [_Column(descriptor, array.take(rows)) for descriptor, array in whole]
                self.stream.send_columns(entity, stage.times(rows), parts)

    def strips(self, entity: str, archetype: Any, strips: NDArray[np.float64]) -> None:
        """Send line strips (n, S, P, D), one batch per step; strips with a point that is not finite are left out."""
        drawn: NDArray[np.bool_] = np.all(np.isfinite(strips), axis=(2, 3))
        self.every_step(entity, archetype.columns(strips=strips[drawn]).partition(drawn.sum(axis=1)))

    def at_result(self, entity: str, *archetypes: Any) -> None:
        """Log what only the result has: at the last step, or once for all where there are no steps."""
        if not self.steps:
            self.once(entity, *archetypes)
            return
        last = np.array([len(self.steps) - 1])
        stage = next(stage for stage in self.stages if stage.name == self.steps[-1].stage)
        batches = [batch for archetype in archetypes for batch in archetype.as_component_batches()]
        columns = [batch.partition([len(batch.as_arrow_array())]) for batch in batches]
        self.stream.send_columns(entity, stage.times(last), columns)


@dataclass(frozen=True)
class _Column:
    """Arrow data that rerun takes as a component column."""

    descriptor: Any
    array: Any

    def component_descriptor(self) -> Any:
        return self.descriptor

    def as_arrow_array(self) -> Any:
        return self.array
