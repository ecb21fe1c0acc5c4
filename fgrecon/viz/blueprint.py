"""How the viewer lays out a recording: image and 3D scene above, plots and words below."""

from __future__ import annotations

from typing import Any

import numpy as np

from fgrecon.observation import Observation
from fgrecon.reconstruction import Reconstruction
from fgrecon.viz import entities
from fgrecon.viz.geometry import crop_around
from fgrecon.viz.truth import Truth

__all__ = ["blueprint"]

_ASPECT = 1.6
_STEPS_PER_SECOND = 8.0
_EYE_SPAN = (6.0, 14.0)  # metres: the least and greatest stretch of the line of sight that the eye takes in


def blueprint(reconstruction: Reconstruction, observation: Observation, truth: Truth | None) -> Any:
    """The `rerun.blueprint.Blueprint` of a recording, zoomed to the vehicle in the image and in the scene."""
    import rerun.blueprint as rrb

    x1, y1, x2, y2 = crop_around(observation, reconstruction.wireframe_uv, aspect=_ASPECT)
    image = rrb.Spatial2DView(
        name="Image: keypoints by weight, projected wireframe, residuals",
        origin=f"/{entities.CAMERA}",
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
    plots = [
        rrb.TimeSeriesView(name="Energy by term", origin=f"/{entities.ENERGY}"),
        rrb.TimeSeriesView(
            name="Weight by keypoint", origin=f"/{entities.WEIGHTS}", axis_y=rrb.ScalarAxis(range=(-0.02, 1.02))
        ),
        rrb.TimeSeriesView(name="Shape coefficients", origin=f"/{entities.COEFFICIENTS}"),
    ]
    if truth is not None:
        plots.append(rrb.TimeSeriesView(name="Error against the truth", origin=f"/{entities.ERROR}"))
    words = [
        rrb.TextLogView(name="Log", origin=f"/{entities.LOG}", columns=_log_columns()),
        rrb.TextDocumentView(name="Result", origin=f"/{entities.SUMMARY}"),
    ]
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(image, scene, column_shares=[1, 1]),
            rrb.Horizontal(rrb.Tabs(*plots), rrb.Tabs(*words), column_shares=[1, 1]),
            row_shares=[3, 2],
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
    """An eye beside the line of sight that sees vehicle and camera; None where there is no result.

    It stands on the side of the flank that the camera sees too. A camera far away leaves the view, so that the vehicle
    keeps its size.
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
    span = float(np.clip(at[2], *_EYE_SPAN))
    target = at - 0.4 * span * towards - (0.0, 0.6, 0.0)
    position = target + 0.75 * span * aside - (0.0, 0.33 * span, 0.0)
    return rrb.EyeControls3D(kind=rrb.Eye3DKind.Orbital, position=position, look_target=target, eye_up=(0.0, -1.0, 0.0))
