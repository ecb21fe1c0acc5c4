"""A rerun recording of a shape prior in which each mode moves from -2 to +2 standard deviations and back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.vehicle_mesh import SIDE_COLOURS, SURFACE, keypoint_sides
from fgrecon.viz.prior_picture import MODE_RANGE, edges_of
from fgrecon.viz.sinks import APPLICATION, Recording

_STEPS = 40
_RADIUS = -1.6
"""Line width of the recording in screen units (negative numbers are pixels in rerun)."""


def record_prior(path: str | Path, prior: ShapePrior) -> Path:
    """Write a recording with the timelines `mode` (which mode moves, from 1; 0 is the mean) and `step`.

    Args:
        path: File to write.
        prior: The prior; a surface moves with its wireframe.

    Returns:
        The path written to.

    Raises:
        InvalidInputError: The file cannot be written.
    """
    return Recording(lambda: lambda stream: _log(stream, prior), _blueprint, f"{APPLICATION} prior").write(path)


def _blueprint() -> Any:
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Spatial3DView(name="Shape: x forward, y down, z left, metres", origin="/prior", line_grid=False),
            rrb.TimeSeriesView(name="Coefficients", origin="/coefficients"),
            row_shares=[4, 1],
        ),
        rrb.TimePanel(timeline="step", play_state="playing", loop_mode="all"),
        collapse_panels=True,
    )


def _coefficients(prior: ShapePrior) -> tuple[NDArray[np.int64], Array]:
    """(T,) mode that moves at each step and (T, N) coefficients: the mean, then a full swing of each mode."""
    swing = MODE_RANGE * np.sin(np.linspace(0.0, 2.0 * np.pi, _STEPS + 1))
    modes, rows = [0], [np.zeros(prior.dimension)]
    for mode in range(prior.dimension):
        for value in swing:
            modes.append(mode + 1)
            rows.append(value * np.eye(prior.dimension)[mode])
    return np.array(modes, dtype=np.int64), np.array(rows)


def _log(stream: Any, prior: ShapePrior) -> None:
    modes, coefficients = _coefficients(prior)
    sides = keypoint_sides(prior.category.keypoints, prior.mean)
    stream.log("prior", rr.ViewCoordinates.RDF, static=True)
    points = rr.Points3D(
        prior.mean,
        labels=list(prior.category.keypoints),
        colors=[SIDE_COLOURS[side] for side in sides],
        radii=-3.5,
        show_labels=False,
    )
    stream.log("prior/mean", points, static=True)
    for step, (mode, row) in enumerate(zip(modes, coefficients, strict=True)):
        stream.set_time("mode", sequence=int(mode))
        stream.set_time("step", sequence=step)
        shape = prior.keypoints(row)
        for side, group in edges_of(prior).items():
            if len(group):
                strips = rr.LineStrips3D(shape[group], colors=SIDE_COLOURS[side], radii=_RADIUS)
                stream.log(f"prior/wireframe/{side.value}", strips)
        if prior.surface is not None:
            mesh = rr.Mesh3D(
                vertex_positions=prior.surface.vertices(row),
                triangle_indices=prior.surface.faces,
                albedo_factor=SURFACE,
            )
            stream.log("prior/surface", mesh)
        for index, value in enumerate(row):
            stream.log(f"coefficients/{index + 1}", rr.Scalars(float(value)))
