"""How the viewer lays out the recording of a track: what happens by frame on the left, the joint solve on the right."""

from __future__ import annotations

from typing import Any

import numpy as np

from fgrecon.core.track_reconstruction import TrackReconstruction
from fgrecon.viz import entities
from fgrecon.viz.blueprint import (
    error_measures,
    error_views,
    graph_view,
    image_view,
    look,
    page,
    plot_view,
    scene_view,
    word_views,
)
from fgrecon.viz.factor_graph import lay_out
from fgrecon.viz.track_sight import TrackSight, image_reach

__all__ = ["track_blueprint"]

_ASPECT = 1.6
_MARGIN = 0.08


def track_blueprint(track: TrackReconstruction, sight: TrackSight) -> Any:
    """The `rerun.blueprint.Blueprint` of a track's recording, showing all of its path."""
    import rerun.blueprint as rrb

    by_frame = []
    if sight.truths is not None and any(truth is not None for truth in sight.truths):
        measures = error_measures(shape=False)
        by_frame.append(error_views(f"{entities.FRAMES}/{entities.ERROR}", measures))  # that is one number
    by_frame += [
        plot_view("Weights", f"{entities.FRAMES}/{entities.WEIGHTS}", low=-0.02, high=1.02),
        plot_view("Energy [nats]", f"{entities.FRAMES}/{entities.ENERGY}"),
    ]
    joint = [graph_view(lay_out(track.graph), "Factor graph")] if track.graph else []
    if track.history:
        joint += [
            plot_view("Joint energy (by step)", entities.ENERGY),
            plot_view("Shape (by step)", entities.COEFFICIENTS),
        ]
    middle = [rrb.Tabs(*joint)] if joint else []
    return page(
        [image_view(_crop(track, sight)), scene_view(_eye(track))],
        [rrb.Tabs(*by_frame), *middle, word_views()],
        name="One vehicle in several images: a pose for each, one shape for all",
        timeline=entities.FRAME,
    )


def _crop(track: TrackReconstruction, sight: TrackSight) -> tuple[float, float, float, float]:
    """The part of the image where the vehicle is in any frame."""
    low, high = image_reach(track, sight)
    centre, size = (low + high) / 2, (high - low) * (1 + 2 * _MARGIN)
    width, height = max(size[0], _ASPECT * size[1]), max(size[1], size[0] / _ASPECT)
    x, y = centre
    return (float(x - width / 2), float(y - height / 2), float(x + width / 2), float(y + height / 2))


def _eye(track: TrackReconstruction) -> Any:
    """An eye above and beside the path and the camera."""
    points = np.array([[0.0, 0.0, 0.0], *(result.location for result in track.frames)])
    points = points[np.isfinite(points).all(axis=1)]
    target = (points.min(axis=0) + points.max(axis=0)) / 2
    span = max(float(np.ptp(points, axis=0).max()), 8.0)
    return look(target + np.array([0.5, -0.45, -0.25]) * span, target)
