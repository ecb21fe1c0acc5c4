"""How the viewer lays out a scene: image, space and view from above; below states, words, and a tab for each car."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fgrecon.viz import entities, style
from fgrecon.viz.blueprint import graph_view, image_view, look, page, plot_view
from fgrecon.viz.factor_graph import lay_out
from fgrecon.viz.geometry import crop_around
from fgrecon.viz.overview import state_view
from fgrecon.viz.scene_members import Member

__all__ = ["scene_blueprint"]

_ASPECT = 1.6
_BODY = (entities.SURFACE, entities.MODEL, entities.WIREFRAME_3D)
_BEHIND, _HIGH = 0.45, 0.35  # of the scene's reach: where the eye is, seen from the camera


def scene_blueprint(members: Sequence[Member]) -> Any:
    """The `rerun.blueprint.Blueprint` of a scene's recording."""
    import rerun.blueprint as rrb

    places = [m.sight.reconstruction.location for m in members]
    solved = np.array([place for place in places if np.isfinite(place).all()]).reshape(-1, 3)
    logs = [f"/{member.place(entities.LOG)}" for member in members]
    columns = rrb.TextLogColumns(text_log_columns=["LogLevel", "EntityPath", "Body"])
    words = rrb.Tabs(
        rrb.TextDocumentView(name="Result", origin=f"/{entities.SUMMARY}"),
        rrb.TextLogView(name="Log", origin="/", contents=logs, columns=columns),
    )
    return page(
        [_image_view(members), *_scene_views(members, solved)],
        [rrb.Tabs(*(_details(member) for member in members)), state_view("Stage, then status, and side"), words],
        name="All vehicles of an image",
        timeline=entities.STEP,
    )


def _image_view(members: Sequence[Member]) -> Any:
    """The whole image, without what would hide small vehicles."""
    parts = (entities.BOX_2D, entities.KEYPOINTS_2D, entities.PREVIOUS_2D, entities.RESIDUALS, entities.TRUTH_2D)
    hidden = (f"- /{member.place(part)}/**" for member in members for part in parts)
    return image_view(None, "Image: projected wireframes", ["$origin/**", *hidden])


def _scene_views(members: Sequence[Member], places: Any) -> list[Any]:
    """The space from behind the camera, and from above."""
    import rerun.blueprint as rrb

    parts = (entities.KEYPOINTS_3D, entities.PLANES, entities.UNCERTAINTY, entities.PREVIOUS_3D)
    hidden = [f"{entities.CAMERA}/{entities.IN_VEHICLES}", entities.BOXES_2D]
    hidden += [member.place(part) for member in members for part in parts]
    hidden += [member.place(entities.SURFACE) for member in members if member.sight.model is not None]
    contents = ["$origin/**", *(f"- /{entity}/**" for entity in hidden)]
    bodies = (member.place(part) for member in members for part in _BODY)
    without_bodies = [*contents, *(f"- /{entity}/**" for entity in bodies)]  # which hide how far positions are known
    reach = np.concatenate([places, np.zeros((1, 3))])
    low, high = reach.min(axis=0), reach.max(axis=0)
    middle, span = (low + high) / 2, max(float(np.hypot(*(high - low)[[0, 2]])), 10.0)
    behind = look(np.array([middle[0], -_HIGH * span, low[2] - _BEHIND * span]), middle)
    above = look(middle - np.array([0.0, 1.3 * span, 0.0]), middle, up=(0.0, 0.0, 1.0))
    origin = f"/{entities.SCENE}"
    return [
        rrb.Spatial3DView(
            name=name,
            origin=origin,
            contents=shown,
            eye_controls=eye,
            background=style.SCREEN_BACKGROUND,
            line_grid=False,
        )
        for name, eye, shown in (
            ("Scene: camera frame, metres", behind, contents),
            ("From above: box, heading, 95 % of position", above, without_bodies),
        )
    ]


def _details(member: Member) -> Any:
    """Image, plots and graph of one vehicle."""
    import rerun.blueprint as rrb

    sight, graph = member.sight, member.sight.reconstruction.graph
    crop = crop_around(sight.observation, sight.reconstruction.wireframe_uv, aspect=_ASPECT)
    own = (f"/{entities.CAMERA}", f"/{entities.IMAGE}", f"/{member.place(f'{entities.CAMERA}/')}**")
    views = [
        image_view(crop, "Keypoints by weight", own),
        plot_view("Energy [nats]", member.place(entities.ENERGY)),
        plot_view("Weights", member.place(entities.WEIGHTS), low=-0.02, high=1.02),
    ]
    if graph:
        views.append(graph_view(lay_out(graph), "Factor graph", member.place(entities.GRAPH)))
    return rrb.Tabs(*views, name=member.title)
