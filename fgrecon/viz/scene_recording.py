"""One recording for all vehicles of an image: photograph, camera and ground once, and each vehicle with its steps.

The names are those of `fgrecon.viz.entities`; `fgrecon.viz.replay` reads a file back. Each vehicle is sent as it would
be alone (`fgrecon.viz.recording`), to a branch of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fgrecon.core.camera import Ground
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import position_covariance
from fgrecon.viz import entities, style
from fgrecon.viz.columns import Outbox, column, fixed_columns, made_columns, strip_column
from fgrecon.viz.describe import scene_table
from fgrecon.viz.geometry import ellipsoids, ground_lines, level_axes
from fgrecon.viz.overlay import Shown
from fgrecon.viz.overview import STATES, named_boxes, state_in_words
from fgrecon.viz.photograph import Photograph
from fgrecon.viz.picture import Sight
from fgrecon.viz.playback import Playback
from fgrecon.viz.plots import log_summary
from fgrecon.viz.recording import log_vehicle
from fgrecon.viz.scene import line_style, log_camera, log_image
from fgrecon.viz.scene_members import Member, members_of
from fgrecon.viz.sinks import Recording

__all__ = ["record_scene", "scene_recording_of"]

_RADIUS = 2.7955  # standard deviations that hold a position with a probability of 95 %, in three dimensions
_NOSE, _SPACING, _ASIDE, _BEYOND = 1.6, 5.0, 15.0, 10.0  # metres


def record_scene(path: str | Path, sights: Sequence[Sight], *, ground: Ground | None = None) -> Path:
    """Write one recording of all vehicles of an image to a `.rrd` file, whole or not at all.

    Args:
        path: File to write.
        sights: The vehicles, all seen by one camera in one image.
        ground: The ground plane, or None.

    Returns:
        The path written to.

    Raises:
        InvalidInputError: There is no vehicle, the file cannot be written, or the image is not (H, W, 3) of bytes.
    """
    return scene_recording_of(sights, ground=ground).write(path)


def scene_recording_of(sights: Sequence[Sight], *, ground: Ground | None = None) -> Recording:
    """The recording that `record_scene` writes, to be sent elsewhere; the arguments are those of `record_scene`."""
    from fgrecon.viz.scene_blueprint import scene_blueprint

    if not sights:
        raise InvalidInputError("sights", "none", "Give at least one vehicle.")
    members = members_of(sights)

    def make() -> Callable[[Any], None]:
        return _outbox(members, ground).empty_into

    return Recording(make, lambda: scene_blueprint(members))


def _outbox(members: Sequence[Member], ground: Ground | None) -> Outbox:
    """All chunks of a recording."""
    out = Outbox(f"scene of {len(members)}")
    photograph = Photograph.of(members[0].sight.image)
    _log_place(out, members, photograph, ground)
    for member in members:
        sight = member.sight
        play = Playback(out.branch(member.place), sight.reconstruction, sight.observation, sight.camera, sight.truth)
        log_vehicle(play, sight.model)
        if np.isfinite(sight.reconstruction.camera_T_object).all():
            _log_position(play, member)
        _log_states(play, member)
    log_summary(out, scene_table([(member.title, member.sight.reconstruction) for member in members]))
    return out


def _log_place(out: Outbox, members: Sequence[Member], photograph: Photograph | None, ground: Ground | None) -> None:
    """Camera, photograph, 2D boxes and ground: what all vehicles have in common."""
    import rerun as rr

    solved = [m.sight for m in members if np.isfinite(m.sight.reconstruction.camera_T_object).all()]
    first = max(solved, key=lambda s: float(s.reconstruction.location[2])) if solved else members[0].sight
    trunk = Playback(out, first.reconstruction, first.observation, first.camera, None)
    log_camera(trunk, photograph)
    log_image(trunk, photograph)
    boxes = [(m, m.sight.observation.box) for m in members]
    shown = [Shown(m.number, box, name=m.title) for m, box in boxes if box is not None]
    if shown:
        out.send_columns(entities.BOXES_2D, [], made_columns(named_boxes(shown)))
    if ground is not None and solved:
        right, _, ahead = level_axes(ground)
        places = np.array([s.reconstruction.location @ np.stack([right, ahead]).T for s in solved])
        aside, far = max(_ASIDE, float(np.abs(places[:, 0]).max())), float(places[:, 1].max()) + _BEYOND
        sideways = _SPACING * np.arange(-np.ceil(aside / _SPACING), np.ceil(aside / _SPACING) + 1)
        lines = ground_lines(ground, sideways, _SPACING * np.arange(1, max(np.ceil(far / _SPACING), 1) + 1))
        look = fixed_columns(**line_style(3, style.GROUND, 0.4))
        out.send_columns(entities.GROUND, [], [*look, strip_column(rr.LineStrips3D, lines[None])])


def _log_position(play: Playback, member: Member) -> None:
    """Heading with the name, and how far the position is known."""
    import rerun as rr

    result, colour = play.reconstruction, tuple(style.readable(style.categorical(member.number)).tolist())
    arrow = rr.Arrows3D(
        origins=[(0.0, 0.0, 0.0)],
        vectors=[(result.box_size[0] / 2 + _NOSE, 0.0, 0.0)],
        colors=[colour],
        radii=-2.0,
        labels=[member.title],
        show_labels=True,
    )
    play.always(entities.HEADING, made_columns(arrow))
    if result.pose_covariance is not None and np.isfinite(result.pose_covariance).all():
        covariance = position_covariance(result.camera_T_object, result.pose_covariance)
        axes, rotations = ellipsoids(covariance[None])
        play.once(
            entities.POSITION, rr.Ellipsoids3D, colors=style.UNCERTAINTY, fill_mode="MajorWireframe", line_radii=-1.0
        )
        shape = [
            column(rr.Ellipsoids3D, "half_sizes", _RADIUS * axes),
            column(rr.InstancePoses3D, "translations", result.location[None]),
            column(rr.InstancePoses3D, "mat3x3", rotations),
        ]
        play.at_result(entities.POSITION, shape)


def _log_states(play: Playback, member: Member) -> None:
    """Stage and visible side of every step, as far as they change, and at last the status."""
    import rerun as rr

    entity, stem = f"{STATES}/{member.name}", replace(play, stream=play.stream.branch(str))
    states = [state_in_words(step.stage, step.camera_T_object) for step in play.steps]
    status = play.reconstruction.status.value
    if states:
        states[-1] = state_in_words(status, play.steps[-1].camera_T_object)
        changes = [row for row, state in enumerate(states) if row == 0 or state != states[row - 1]]
        values = column(rr.StateChange, "state", [states[row] for row in changes], 1)
        stem.every_step(entity, [values], np.array(changes))
    else:
        stem.at_result(entity, [column(rr.StateChange, "state", [status], 1)])
