"""How the viewer lays out the recording of a video: image, space and view from above; plots, a graph and words below.

Both views of the space go with the camera, whose frame they are in: x right, y down, z ahead, metres.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fgrecon.viz import entities, style
from fgrecon.viz.blueprint import graph_view, look
from fgrecon.viz.overview import state_view

__all__ = ["HERE", "IMAGE", "LOG", "PLOTS", "RINGS", "SIZES", "WORLD", "video_blueprint"]

IMAGE, WORLD, PLOTS, LOG = "image", "world", "plots", "log"
HERE = f"{WORLD}/here"
"""A frame that goes with the camera."""
RINGS = f"{HERE}/rings"
"""Circles around it, for the view from above."""
SIZES = ("length", "width", "height")
_OTHERS = ("speed", "distance", "facing_probability")
_UNITS = {"yaw": "degrees", "speed": "m/s", "distance": "m", **dict.fromkeys(SIZES, "m")}
_AHEAD, _ABOVE = 24.0, 62.0  # metres: what is looked at, and from how high
_BEHIND = np.array([0.0, -10.0, -12.0])  # where the eye is in the other view


def video_blueprint() -> Any:
    """The `rerun.blueprint.Blueprint` of a video's recording."""
    import rerun.blueprint as rrb

    middle = np.array([0.0, 0.0, _AHEAD])
    above = look(np.array([0.0, -_ABOVE, _AHEAD]), middle, up=(0.0, 0.0, 1.0))
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                rrb.Spatial2DView(origin=f"/{IMAGE}", name="Image"),
                _space("Space", look(_BEHIND, middle), f"- /{RINGS}/**"),
                _space("From above: a circle every 10 m", above),
                column_shares=[3, 2, 2],
            ),
            rrb.Horizontal(
                rrb.Grid(*map(_plot, ("yaw", *SIZES)), grid_columns=2),
                rrb.Tabs(*map(_plot, _OTHERS)),
                graph_view(None, "Factor graph of a window", entities.GRAPH),
                rrb.Vertical(state_view(), rrb.TextLogView(origin=f"/{LOG}", name="Gaps")),
                column_shares=[5, 3, 7, 4],
            ),
            row_shares=[3, 2],
        ),
        collapse_panels=True,
    )


def _space(name: str, eye: Any, *without: str) -> Any:
    """What is in the world, seen from an eye that goes with the camera."""
    import rerun.blueprint as rrb

    return rrb.Spatial3DView(
        name=name,
        origin=f"/{HERE}",
        contents=[f"/{WORLD}/**", *without],
        eye_controls=eye,
        background=style.SCREEN_BACKGROUND,
        line_grid=False,
    )


def _plot(name: str) -> Any:
    """One value of all vehicles, in their colours: without a legend, which would hide it."""
    import rerun.blueprint as rrb

    title = name.replace("_", " ") + (f" [{_UNITS[name]}]" if name in _UNITS else "")
    return rrb.TimeSeriesView(origin=f"/{PLOTS}/{name}", name=title, plot_legend=rrb.PlotLegend(visible=False))
