"""How the viewer lays out a recording: image and 3D scene above, plots and words below."""

from __future__ import annotations

from typing import Any

import numpy as np

from fgrecon.observation import Observation
from fgrecon.reconstruction import Reconstruction
from fgrecon.viz import entities, style
from fgrecon.viz.geometry import crop_around
from fgrecon.viz.truth import Truth

__all__ = ["blueprint"]

_ASPECT = 1.6
_STEPS_PER_SECOND = 8.0
_NEAR, _CLOSE_UP = 14.0, 8.0  # metres: how far a camera may be to stay in the view, and what is looked at without it


def blueprint(reconstruction: Reconstruction, observation: Observation, truth: Truth | None) -> Any:
    """The `rerun.blueprint.Blueprint` of a recording, zoomed to the vehicle in the image and in the scene."""
    import rerun.blueprint as rrb

    x1, y1, x2, y2 = crop_around(observation, reconstruction.wireframe_uv, aspect=_ASPECT)
    image = rrb.Spatial2DView(
        name="Image: keypoints by weight, projected wireframe, residuals",
        origin=f"/{entities.CAMERA}",
        background=style.SCREEN_BACKGROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=(x1, x2), y_range=(y1, y2)),
    )
    only_in_image = (
        entities.BOX_2D,
        entities.KEYPOINTS_2D,
        entities.WIREFRAME_2D,
        entities.RESIDUALS,
        entities.TRUTH_2D,
    )
    scene = rrb.Spatial3DView(
        name="Scene: camera frame, metres",
        origin=f"/{entities.SCENE}",
        contents=["$origin/**", *(f"- /{entity}/**" for entity in only_in_image)],
        eye_controls=_eye(reconstruction),
        line_grid=False,
    )
    legend = rrb.PlotLegend(rrb.Corner2D.RightTop)
    plots = [
        rrb.TimeSeriesView(name="Energy by term", origin=f"/{entities.ENERGY}", plot_legend=legend),
        rrb.TimeSeriesView(
            name="Weight by keypoint",
            origin=f"/{entities.WEIGHTS}",
            axis_y=rrb.ScalarAxis(range=(-0.02, 1.02)),
            plot_legend=legend,
        ),
        rrb.TimeSeriesView(name="Shape coefficients", origin=f"/{entities.COEFFICIENTS}", plot_legend=legend),
    ]
    if truth is not None:
        plots.append(
            rrb.TimeSeriesView(name="Error against the truth", origin=f"/{entities.ERROR}", plot_legend=legend)
        )
    words = [
        rrb.TextLogView(name="Log", origin=f"/{entities.LOG}", columns=_log_columns()),
        rrb.TextDocumentView(name="Result", origin=f"/{entities.SUMMARY}"),
    ]
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(image, scene, column_shares=[1, 1]),
            rrb.Horizontal(rrb.Tabs(*plots), rrb.Tabs(*words), column_shares=[1, 1]),
            row_shares=[4, 3],
            name="One vehicle: from keypoints to pose and shape",
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=entities.STEP, fps=_STEPS_PER_SECOND, play_state="following"),
    )


def _log_columns() -> Any:
    """Level and text beside the step: every line comes from one entity, whose name says nothing."""
    import rerun.blueprint as rrb

    return rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"])


def _eye(reconstruction: Reconstruction) -> Any:
    """An eye beside the line of sight, on the side of the flank that the camera sees; None where there is no result.

    A camera nearby is in the view; one farther away is not, so that the vehicle keeps its size.
    """
    import rerun.blueprint as rrb

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
    target = at - (0.4 * span if near else 0.0) * towards - (0.0, 0.6, 0.0)
    # In a close-up the eye stands a little towards the camera, or an end-on vehicle would show its other flank only.
    position = target + 0.85 * span * aside - (0.0, 0.35 * span, 0.0) - (0.0 if near else 0.4 * span) * towards
    return rrb.EyeControls3D(kind=rrb.Eye3DKind.Orbital, position=position, look_target=target, eye_up=(0.0, -1.0, 0.0))
