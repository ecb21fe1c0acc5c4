"""One recording for all vehicles of an image: photograph, camera and ground once, and each vehicle with its steps.

The names are those of `fgrecon.viz.entities`; `fgrecon.viz.replay` reads a file back. Each vehicle is sent as it would
be alone (`fgrecon.viz.recording`), to a branch of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import rerun as rr

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Ground
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import position_covariance
from fgrecon.viz import entities, style
from fgrecon.viz.blueprint import scene_blueprint
from fgrecon.viz.columns import Outbox, fixed_columns, made_columns, strip_columns
from fgrecon.viz.describe import scene_table, state_in_words
from fgrecon.viz.geometry import NOSE, ground_lines
from fgrecon.viz.playback import Playback
from fgrecon.viz.plots import log_summary
from fgrecon.viz.recording import line_style, log_camera, log_ellipsoids, log_image, log_vehicle
from fgrecon.viz.sinks import Recording
from fgrecon.viz.subjects import DrawnVehicle, Member, SolvedVehicle, members_of

_RADIUS = 2.7955  # standard deviations that hold a position with a probability of 95 %, in three dimensions
_SPACING = 5.0  # metres between the lines of the ground's grid


def scene_recording_of(vehicles: Sequence[SolvedVehicle], *, ground: Ground | None = None) -> Recording:
    """One recording of all vehicles of an image, with its layout.

    Args:
        vehicles: The vehicles, all observed by one camera in one image.
        ground: The ground plane, or None.

    Returns:
        What can be written or sent. Making it raises an InvalidInputError where the image is not (H, W, 3) of bytes.

    Raises:
        InvalidInputError: There is no vehicle.
    """
    if not vehicles:
        raise InvalidInputError("vehicles", "none", "Give at least one vehicle.")
    members = members_of(vehicles)

    def make() -> Callable[[Any], None]:
        out = Outbox(f"scene of {len(members)}")
        _log_place(out, members, ground)
        for member in members:
            play = Playback(out.branch(member.place), member.vehicle)
            log_vehicle(play)
            if member.vehicle.solved:
                _log_position(play, member)
            _log_states(play, member)
        log_summary(out, scene_table([(member.title, member.vehicle) for member in members]))
        return out.empty_into

    return Recording(make, lambda: scene_blueprint(members))


def _log_place(out: Outbox, members: Sequence[Member], ground: Ground | None) -> None:
    """Camera, photograph, 2D boxes and ground: what all vehicles have in common."""
    photograph = members[0].vehicle.photograph
    solved = [member.vehicle for member in members if member.vehicle.solved]
    first = max(solved, key=lambda s: float(s.reconstruction.location[2])) if solved else members[0].vehicle
    trunk = Playback(out, replace(first, truth=None))
    log_camera(trunk, photograph)
    log_image(trunk, photograph)
    boxes = [(m, m.vehicle.observation.box) for m in members]
    shown = [DrawnVehicle(m.number, b, name=m.title, detection=m.vehicle.detection) for m, b in boxes if b is not None]
    if shown:
        out.send_columns(entities.BOXES_2D, [], made_columns(named_boxes(shown)))
    if ground is not None and solved:
        lines = ground_lines(ground, [s.reconstruction.location for s in solved], _evenly)
        look = fixed_columns(**line_style(3, style.GROUND, 0.4))
        out.send_columns(entities.GROUND, [], [*look, *strip_columns(rr.LineStrips3D, lines[None])])


def _evenly(far: float) -> Array:
    """Where lines across the ground are."""
    return _SPACING * np.arange(1, max(np.ceil(far / _SPACING), 1) + 1)


def named_boxes(vehicles: Sequence[DrawnVehicle]) -> Any:
    """The 2D boxes as a `rerun.Boxes2D`, in the vehicles' colours and with their names and words."""
    return rr.Boxes2D(
        array=np.array([vehicle.box for vehicle in vehicles]).reshape(-1, 4),
        array_format=rr.Box2DFormat.XYXY,
        colors=[style.readable(style.categorical(vehicle.identity)) for vehicle in vehicles],
        labels=[f"{vehicle.label} {vehicle.all_words}".strip() for vehicle in vehicles],
        show_labels=True,
    )


def _log_position(play: Playback, member: Member) -> None:
    """Heading with the name, and how far the position is known."""
    result, colour = play.vehicle.reconstruction, tuple(style.readable(style.categorical(member.number)).tolist())
    arrow = rr.Arrows3D(
        origins=[(0.0, 0.0, 0.0)],
        vectors=[(result.box_size[0] / 2 + NOSE, 0.0, 0.0)],
        colors=[colour],
        radii=-2.0,
        labels=[member.title],
        show_labels=True,
    )
    play.always(entities.HEADING, made_columns(arrow))
    if result.uncertainty.pose_covariance is not None and np.isfinite(result.uncertainty.pose_covariance).all():
        covariance = position_covariance(result.camera_T_object, result.uncertainty.pose_covariance)[None]
        log_ellipsoids(play, entities.POSITION, result.location[None], covariance, line_radii=-1.0, deviations=_RADIUS)


def _log_states(play: Playback, member: Member) -> None:
    """Stage and visible side of every step, as far as they change, and at last the status."""
    entity, stem = f"{entities.STATES}/{member.name}", replace(play, stream=play.stream.branch(str))
    states = [state_in_words(step.stage, step.camera_T_object) for step in play.steps]
    status = play.vehicle.reconstruction.status.value
    if states:
        states[-1] = state_in_words(status, play.steps[-1].camera_T_object)
        changes = [row for row, state in enumerate(states) if row == 0 or state != states[row - 1]]
        stem.at_steps(entity, rr.StateChange.columns(state=[states[row] for row in changes]), changes)
    else:
        stem.at_result(entity, rr.StateChange.columns(state=[status]))
