"""How the viewer lays out a recording: image and 3D scene above; plots, factor graph and words below."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.viz import entities, style
from fgrecon.viz.factor_graph import Layout, lay_out
from fgrecon.viz.geometry import Box, crop_around
from fgrecon.viz.truth import ORIENTATION_ERROR, SHAPE_ERROR, TRANSLATION_ERROR, Truth

__all__ = [
    "blueprint",
    "error_measures",
    "error_views",
    "eye",
    "graph_view",
    "image_view",
    "look",
    "page",
    "plot_view",
    "scene_view",
    "word_views",
]

_ASPECT = 1.6
_STEPS_PER_SECOND = 8.0
_GRAPH_MARGIN = (75.0, 30.0)  # half a label beyond the outermost nodes
_NEAR, _CLOSE_UP = 14.0, 8.0  # metres: how far a camera may be to stay in the view, and what is looked at without it


def blueprint(
    reconstruction: Reconstruction, observation: Observation, truth: Truth | None, *, model: bool = False
) -> Any:
    """The `rerun.blueprint.Blueprint` of a recording, zoomed to the vehicle in the image and in the scene.

    With a car model the surface is not shown, which is where that is.
    """
    crop = crop_around(observation, reconstruction.wireframe_uv, aspect=_ASPECT)
    measures = () if truth is None else error_measures(shape=truth.keypoints is not None)
    structure = graph_view(lay_out(reconstruction.graph)) if reconstruction.graph else None
    return _whole(measures, image_view(crop), scene_view(eye(reconstruction), model=model), structure)


def _whole(measures: tuple[tuple[str, str], ...], image: Any, scene: Any, structure: Any) -> Any:
    """The `rerun.blueprint.Blueprint` of these views and the plots; without a factor graph `structure` is None."""
    import rerun.blueprint as rrb

    plots = [
        plot_view("Energy [nats]", entities.ENERGY),
        plot_view("Weights", entities.WEIGHTS, low=-0.02, high=1.02),
        plot_view("Shape", entities.COEFFICIENTS),
    ]
    if measures:
        plots.append(error_views(entities.ERROR, measures))
    return page(
        [image, scene],
        [rrb.Tabs(*plots), *([] if structure is None else [structure]), word_views()],
        name="One vehicle: from keypoints to pose and shape",
        timeline=entities.STEP,
    )


def page(above: Sequence[Any], below: Sequence[Any], *, name: str, timeline: str) -> Any:
    """Two rows of views, and no panels but the player; the last view below has words and a little more room."""
    import rerun.blueprint as rrb

    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(*above, column_shares=[1] * len(above)),
            rrb.Horizontal(*below, column_shares=[5] * (len(below) - 1) + [6]),
            row_shares=[4, 3],
            name=name,
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=timeline, fps=_STEPS_PER_SECOND, play_state="following"),
    )


def image_view(
    crop: Box | None,
    name: str = "Image: keypoints by weight, projected wireframe, residuals",
    contents: Sequence[str] = ("$origin/**",),
) -> Any:
    """The image, zoomed to a crop where one is given."""
    import rerun.blueprint as rrb

    return rrb.Spatial2DView(
        name=name,
        origin=f"/{entities.CAMERA}",
        contents=list(contents),
        background=style.SCREEN_BACKGROUND,
        visual_bounds=None if crop is None else _bounds(crop),
    )


def _bounds(crop: Box) -> Any:
    """The part of a 2D view that is shown."""
    import rerun.blueprint as rrb

    x1, y1, x2, y2 = crop
    return rrb.VisualBounds2D(x_range=(x1, x2), y_range=(y1, y2))


def scene_view(controls: Any, *, model: bool = False) -> Any:
    """The 3D scene without what the image alone shows, and with a car model without the surface."""
    import rerun.blueprint as rrb

    hidden = (
        *((entities.SURFACE,) if model else ()),
        entities.BOX_2D,
        entities.KEYPOINTS_2D,
        entities.WIREFRAME_2D,
        entities.PREVIOUS_2D,
        entities.RESIDUALS,
        entities.TRUTH_2D,
    )
    return rrb.Spatial3DView(
        name="Scene: camera frame, metres",
        origin=f"/{entities.SCENE}",
        contents=["$origin/**", *(f"- /{entity}/**" for entity in hidden)],
        background=style.SCREEN_BACKGROUND,
        eye_controls=controls,
        line_grid=False,
    )


def plot_view(name: str, entity: str, *, low: float | None = None, high: float | None = None) -> Any:
    """One plot; its range is that of the data where none is given."""
    import rerun.blueprint as rrb

    legend = rrb.PlotLegend(rrb.Corner2D.RightTop)
    axis = None if low is None or high is None else rrb.ScalarAxis(range=(low, high))
    return rrb.TimeSeriesView(name=name, origin=f"/{entity}", plot_legend=legend, axis_y=axis)


def error_measures(*, shape: bool) -> tuple[tuple[str, str], ...]:
    """Titles and names of the distances from the truth, with that of the shape or without."""
    pose = (("Orientation error [degrees]", ORIENTATION_ERROR), ("Translation error [m]", TRANSLATION_ERROR))
    return (*pose, ("Error of the 3D keypoints [m]", SHAPE_ERROR)) if shape else pose


def error_views(entity: str, measures: Sequence[tuple[str, str]]) -> Any:
    """Distances from the truth, one plot above the other: they have different units."""
    import rerun.blueprint as rrb

    return rrb.Vertical(*(plot_view(name, f"{entity}/{m}") for name, m in measures), name="Errors")


def graph_view(
    layout: Layout | None, name: str = "Factor graph: keypoints by weight", entity: str = entities.GRAPH
) -> Any:
    """The factor graph, with every node where it was put and, where a layout is given, all of them in the view."""
    import rerun.blueprint as rrb
    import rerun.blueprint.archetypes as forces

    return rrb.GraphView(
        name=name,
        visual_bounds=None if layout is None else _bounds(_reach(layout)),
        origin=f"/{entity}",
        force_link=forces.ForceLink(enabled=False),
        force_many_body=forces.ForceManyBody(enabled=False),
        force_center=forces.ForceCenter(enabled=False),
        force_collision_radius=forces.ForceCollisionRadius(enabled=False),
    )


def _reach(layout: Layout) -> Box:
    """The part of a graph's view where its nodes and their labels are."""
    low, high = layout.positions.min(axis=0) - _GRAPH_MARGIN, layout.positions.max(axis=0) + _GRAPH_MARGIN
    return (low[0], low[1], high[0], high[1])


def word_views() -> Any:
    """The log and the summary. Every line of the log comes from one entity, whose name says nothing."""
    import rerun.blueprint as rrb

    columns = rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"])
    return rrb.Tabs(
        rrb.TextLogView(name="Log", origin=f"/{entities.LOG}", columns=columns),
        rrb.TextDocumentView(name="Result", origin=f"/{entities.SUMMARY}"),
    )


def eye(reconstruction: Reconstruction) -> Any:
    """An eye beside the line of sight, on the side of the flank that the camera sees; None where there is no result.

    A camera nearby is in the view; one farther away is not, so that the vehicle keeps its size.
    """
    at = reconstruction.location
    if not np.isfinite(at).all():
        return None
    towards = at * (1.0, 0.0, 1.0)
    towards = towards / max(float(np.linalg.norm(towards)), 1e-9)
    aside = np.array([towards[2], 0.0, -towards[0]])
    flank = reconstruction.camera_T_object[:3, 2]
    flank = -flank if flank @ towards > 0 else flank
    aside = -aside if flank @ aside < 0 else aside
    near = at[2] <= _NEAR
    span = max(float(at[2]), _CLOSE_UP) if near else _CLOSE_UP
    target = at - (0.32 * span if near else 0.0) * towards - (0.0, 0.6, 0.0)
    # In a close-up the eye stands a little towards the camera, or an end-on vehicle would show its other flank only.
    position = target + 0.75 * span * aside - (0.0, 0.3 * span, 0.0) - (0.0 if near else 0.4 * span) * towards
    return look(position, target)


def look(
    position: NDArray[np.float64], target: NDArray[np.float64], up: tuple[float, float, float] = (0.0, -1.0, 0.0)
) -> Any:
    """An eye at a position that looks at a target, with what is to be up in its view; camera frame, metres."""
    import rerun.blueprint as rrb

    return rrb.EyeControls3D(kind=rrb.Eye3DKind.Orbital, position=position, look_target=target, eye_up=up)
