"""Layout of the viewer for each kind of recording."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import rerun.blueprint as rrb
import rerun.blueprint.archetypes as forces

from fgrecon.core.arrays import Array
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.track_reconstruction import TrackReconstruction
from fgrecon.viz import entities, style
from fgrecon.viz.factor_graph import Layout, lay_out
from fgrecon.viz.geometry import Box, crop_around, image_points
from fgrecon.viz.subjects import ORIENTATION_ERROR, SHAPE_ERROR, TRANSLATION_ERROR, Member, SolvedVehicle, TrackInputs

_ASPECT = 1.6
_STEPS_PER_SECOND = 8.0
_GRAPH_MARGIN = (75.0, 30.0)  # half a label beyond the outermost nodes
_TRACK_MARGIN = 0.08  # of the image's part that is shown
_ALL = "$origin/**"
_IMAGE_MARKS = (entities.BOX_2D, entities.KEYPOINTS_2D, entities.PREVIOUS_2D, entities.RESIDUALS, entities.TRUTH_2D)
_BODY = (entities.SURFACE, entities.MODEL, entities.WIREFRAME_3D)
_NEAR, _CLOSE_UP = 14.0, 8.0  # metres: how far a camera may be to stay in the view, and what is looked at without it
_BEHIND_SCENE, _ABOVE_SCENE = 0.45, 0.35  # of the scene's reach: where the eye is, as the camera sees it
_VIDEO_AHEAD, _VIDEO_ABOVE = 24.0, 62.0  # metres: what is looked at, and from how high
_VIDEO_EYE = np.array([0.0, -10.0, -12.0])  # of the view from behind
_VIDEO_UNITS = {"yaw": "degrees", "speed": "m/s", "distance": "m", **dict.fromkeys(entities.SIZES, "m")}


def vehicle_blueprint(vehicle: SolvedVehicle) -> Any:
    """The `rerun.blueprint.Blueprint` of a vehicle: image and scene above, zoomed to it; plots, graph and words below.

    With a car model the surface is not shown, which is where that is.
    """
    result, truth = vehicle.reconstruction, vehicle.truth
    crop = crop_around(vehicle.observation, result.pose.wireframe_uv, aspect=_ASPECT)
    plots = [*_step_plots(), _plot_view("Shape", entities.COEFFICIENTS)]
    if truth is not None:
        plots.append(_error_views(entities.ERROR, shape=truth.keypoints is not None))
    structure = [_graph_view(lay_out(result.diagnostics.graph))] if result.diagnostics.graph else []
    return _page(
        [_image_view(crop), _scene_view(_eye_beside(result), model=vehicle.model is not None)],
        [rrb.Tabs(*plots), *structure, _word_views()],
        name="One vehicle: from keypoints to pose and shape",
        timeline=entities.STEP,
    )


def scene_blueprint(members: Sequence[Member]) -> Any:
    """Of a scene: image, space and view from above; below states, words, and a tab for each vehicle."""
    logs = [f"/{member.place(entities.LOG)}" for member in members]
    columns = rrb.TextLogColumns(text_log_columns=["LogLevel", "EntityPath", "Body"])
    words = rrb.Tabs(
        rrb.TextDocumentView(name="Result", origin=f"/{entities.SUMMARY}"),
        rrb.TextLogView(name="Log", origin="/", contents=logs, columns=columns),
    )
    marks = [member.place(part) for member in members for part in _IMAGE_MARKS]  # which would hide small vehicles
    title = f"{'No image' if members[0].vehicle.image is None else 'Image'}: projected wireframes"
    return _page(
        [_image_view(None, title, [_ALL, *_without(marks)]), *_scene_views(members)],
        [rrb.Tabs(*map(_details, members)), _state_view("Stage, then status, and side"), words],
        name="All vehicles of an image",
        timeline=entities.STEP,
    )


def track_blueprint(track: TrackReconstruction, inputs: TrackInputs) -> Any:
    """Of a track, showing all of its path: what happens by frame on the left, the joint solve on the right."""
    by_frame = list(_step_plots(f"{entities.FRAMES}/"))[::-1]
    if inputs.truths is not None and any(truth is not None for truth in inputs.truths):
        by_frame.insert(0, _error_views(f"{entities.FRAMES}/{entities.ERROR}", shape=False))
    joint = [_graph_view(lay_out(track.graph), "Factor graph")] if track.graph else []
    if track.history:
        joint += [
            _plot_view("Joint energy (by step)", entities.ENERGY),
            _plot_view("Shape (by step)", entities.COEFFICIENTS),
        ]
    return _page(
        [_image_view(_track_crop(track, inputs)), _scene_view(_eye_above_path(track))],
        [rrb.Tabs(*by_frame), *([rrb.Tabs(*joint)] if joint else []), _word_views()],
        name="One vehicle in several images: a pose for each, one shape for all",
        timeline=entities.FRAME,
    )


def video_blueprint() -> Any:
    """Of a video: image, space and view from above; plots, a graph and words below.

    Both views of the space go with the camera, whose frame they are in: x right, y down, z ahead, metres.
    """
    middle = np.array([0.0, 0.0, _VIDEO_AHEAD])
    above = _look(np.array([0.0, -_VIDEO_ABOVE, _VIDEO_AHEAD]), middle, up=(0.0, 0.0, 1.0))
    behind, world = _look(_VIDEO_EYE, middle), f"/{entities.WORLD}/**"
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                rrb.Spatial2DView(origin=f"/{entities.VIDEO_IMAGE}", name="Image"),
                _space_view("Space", entities.HERE, [world, *_without([entities.RINGS])], behind),
                _space_view("From above: a circle every 10 m", entities.HERE, [world], above),
                column_shares=[3, 2, 2],
            ),
            rrb.Horizontal(
                rrb.Grid(*map(_video_plot, ("yaw", *entities.SIZES)), grid_columns=2),
                rrb.Tabs(*map(_video_plot, ("speed", "distance", "facing_probability"))),
                _graph_view(None, "Factor graph of a window"),
                rrb.Vertical(_state_view("Status and side"), rrb.TextLogView(origin=f"/{entities.LOG}", name="Gaps")),
                column_shares=[5, 3, 7, 4],
            ),
            row_shares=[3, 2],
        ),
        collapse_panels=True,
    )


def _video_plot(name: str) -> Any:
    """One value of all vehicles, in their colours: without a legend, which would hide it."""
    title = name.replace("_", " ") + (f" [{_VIDEO_UNITS[name]}]" if name in _VIDEO_UNITS else "")
    legend = rrb.PlotLegend(visible=False)
    return rrb.TimeSeriesView(origin=f"/{entities.PLOTS}/{name}", name=title, plot_legend=legend)


def _page(above: Sequence[Any], below: Sequence[Any], *, name: str, timeline: str) -> Any:
    """Two rows of views, and no panels but the player; the last view below has words and a little more room."""
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


def _without(names: Iterable[str]) -> list[str]:
    """What leaves entities, and all below them, out of a view."""
    return [f"- /{name}/**" for name in names]


def _image_view(
    crop: Box | None,
    name: str = "Image: keypoints by weight, projected wireframe, residuals",
    contents: Sequence[str] = (_ALL,),
) -> Any:
    """The image, zoomed to a crop where one is given."""
    return rrb.Spatial2DView(
        name=name,
        origin=f"/{entities.CAMERA}",
        contents=list(contents),
        background=style.SCREEN_BACKGROUND,
        visual_bounds=None if crop is None else _bounds(crop),
    )


def _bounds(crop: Box) -> Any:
    """The part of a 2D view that is shown."""
    x1, y1, x2, y2 = crop
    return rrb.VisualBounds2D(x_range=(x1, x2), y_range=(y1, y2))


def _space_view(name: str, origin: str, contents: Sequence[str], eye: Any) -> Any:
    """A 3D view."""
    return rrb.Spatial3DView(
        name=name,
        origin=f"/{origin}",
        contents=list(contents),
        background=style.SCREEN_BACKGROUND,
        eye_controls=eye,
        line_grid=False,
    )


def _scene_view(eye: Any, *, model: bool = False) -> Any:
    """The 3D scene without what the image alone shows, and with a car model without the surface."""
    hidden = (
        *((entities.SURFACE,) if model else ()),
        entities.BOX_2D,
        entities.KEYPOINTS_2D,
        entities.WIREFRAME_2D,
        entities.PREVIOUS_2D,
        entities.RESIDUALS,
        entities.TRUTH_2D,
    )
    return _space_view("Scene: camera frame, metres", entities.SCENE, [_ALL, *_without(hidden)], eye)


def _scene_views(members: Sequence[Member]) -> list[Any]:
    """The space from behind the camera, and from above without the bodies, which hide how far positions are known."""
    parts = (entities.KEYPOINTS_3D, entities.PLANES, entities.UNCERTAINTY, entities.PREVIOUS_3D)
    hidden = [f"{entities.CAMERA}/{entities.IN_VEHICLES}", entities.BOXES_2D]
    hidden += [member.place(part) for member in members for part in parts]
    hidden += [member.place(entities.SURFACE) for member in members if member.vehicle.model is not None]
    contents = [_ALL, *_without(hidden)]
    without_bodies = [*contents, *_without(member.place(part) for member in members for part in _BODY)]
    reach = np.array([*(m.vehicle.reconstruction.location for m in members), (0.0, 0.0, 0.0)])
    low, high = np.nanmin(reach, axis=0), np.nanmax(reach, axis=0)
    middle, span = (low + high) / 2, max(float(np.hypot(*(high - low)[[0, 2]])), 10.0)
    behind = _look(np.array([middle[0], -_ABOVE_SCENE * span, low[2] - _BEHIND_SCENE * span]), middle)
    above = _look(middle - np.array([0.0, 1.3 * span, 0.0]), middle, up=(0.0, 0.0, 1.0))
    return [
        _space_view("Scene: camera frame, metres", entities.SCENE, contents, behind),
        _space_view("From above: box, heading, 95 % of position", entities.SCENE, without_bodies, above),
    ]


def _details(member: Member) -> Any:
    """Image, plots and graph of one vehicle of a scene."""
    result = member.vehicle.reconstruction
    crop = crop_around(member.vehicle.observation, result.pose.wireframe_uv, aspect=_ASPECT)
    contents = (f"/{entities.CAMERA}", f"/{entities.IMAGE}", f"/{member.place(f'{entities.CAMERA}/')}**")
    views = [_image_view(crop, "Keypoints by weight", contents), *_step_plots(member.place(""))]
    if result.diagnostics.graph:
        views.append(_graph_view(lay_out(result.diagnostics.graph), "Factor graph", member.place(entities.GRAPH)))
    return rrb.Tabs(*views, name=member.title)


def _step_plots(root: str = "") -> tuple[Any, Any]:
    """Energy and weights below an entity."""
    weights = _plot_view("Weights", f"{root}{entities.WEIGHTS}", (-0.02, 1.02))
    return _plot_view("Energy [nats]", f"{root}{entities.ENERGY}"), weights


def _plot_view(name: str, entity: str, span: tuple[float, float] | None = None) -> Any:
    """One plot; its range is that of the data where none is given."""
    legend = rrb.PlotLegend(rrb.Corner2D.RightTop)
    axis = None if span is None else rrb.ScalarAxis(range=span)
    return rrb.TimeSeriesView(name=name, origin=f"/{entity}", plot_legend=legend, axis_y=axis)


def _error_views(entity: str, *, shape: bool) -> Any:
    """Distances from the truth, with that of the shape or without, in plots of their own: they have different units."""
    measures = {ORIENTATION_ERROR: "Orientation error [degrees]", TRANSLATION_ERROR: "Translation error [m]"}
    measures |= {SHAPE_ERROR: "Error of the 3D keypoints [m]"} if shape else {}
    return rrb.Vertical(*(_plot_view(name, f"{entity}/{m}") for m, name in measures.items()), name="Errors")


def _graph_view(
    layout: Layout | None, name: str = "Factor graph: keypoints by weight", entity: str = entities.GRAPH
) -> Any:
    """The factor graph, with every node where it was put and, where a layout is given, all of them in the view."""
    bounds = None
    if layout is not None:
        low, high = layout.positions.min(axis=0) - _GRAPH_MARGIN, layout.positions.max(axis=0) + _GRAPH_MARGIN
        bounds = _bounds((low[0], low[1], high[0], high[1]))
    return rrb.GraphView(
        name=name,
        visual_bounds=bounds,
        origin=f"/{entity}",
        force_link=forces.ForceLink(enabled=False),
        force_many_body=forces.ForceManyBody(enabled=False),
        force_center=forces.ForceCenter(enabled=False),
        force_collision_radius=forces.ForceCollisionRadius(enabled=False),
    )


def _state_view(name: str) -> Any:
    """The states of all vehicles over time."""
    return rrb.StateTimelineView(origin=f"/{entities.STATES}", name=name)


def _word_views() -> Any:
    """The log and the summary. Every line of the log comes from one entity, whose name says nothing."""
    columns = rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"])
    return rrb.Tabs(
        rrb.TextLogView(name="Log", origin=f"/{entities.LOG}", columns=columns),
        rrb.TextDocumentView(name="Result", origin=f"/{entities.SUMMARY}"),
    )


def _track_crop(track: TrackReconstruction, inputs: TrackInputs) -> Box:
    """The part of the image where boxes, keypoints and wireframes are in any frame."""
    points = [np.zeros((0, 2))]
    for index, result in zip(track.numbers, track.frames, strict=True):
        frame = inputs.at(index, result)
        points.append(frame.observation.keypoints[frame.observation.measured])
        if frame.observation.box is not None:
            points.append(frame.observation.box.reshape(2, 2))
        else:
            points.append(image_points(frame.camera, result.camera_T_object, result.wireframe))
    shown = np.concatenate(points)
    shown = shown[np.isfinite(shown).all(axis=1)]
    low, high = shown.min(axis=0), shown.max(axis=0)
    (x, y), size = (low + high) / 2, (high - low) * (1 + 2 * _TRACK_MARGIN)
    width, height = max(size[0], _ASPECT * size[1]), max(size[1], size[0] / _ASPECT)
    return (float(x - width / 2), float(y - height / 2), float(x + width / 2), float(y + height / 2))


def _eye_above_path(track: TrackReconstruction) -> Any:
    """An eye above and beside the path and the camera."""
    points = np.array([[0.0, 0.0, 0.0], *(result.location for result in track.frames)])
    points = points[np.isfinite(points).all(axis=1)]
    target = (points.min(axis=0) + points.max(axis=0)) / 2
    span = max(float(np.ptp(points, axis=0).max()), 8.0)
    return _look(target + np.array([0.5, -0.45, -0.25]) * span, target)


def _eye_beside(reconstruction: Reconstruction) -> Any:
    """An eye beside the line of vehicle, on the side of the flank that the camera sees; None where there is no result.

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
    return _look(position, target)


def _look(position: Array, target: Array, up: tuple[float, float, float] = (0.0, -1.0, 0.0)) -> Any:
    """An eye at a position that looks at a target, with what is to be up in its view; camera frame, metres."""
    return rrb.EyeControls3D(kind=rrb.Eye3DKind.Orbital, position=position, look_target=target, eye_up=up)
