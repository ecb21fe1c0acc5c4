"""What recordings of several vehicles share: named boxes in the image, what becomes of each vehicle, and the views."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.geometry import view_azimuth
from fgrecon.viz import style
from fgrecon.viz.overlay import Shown

__all__ = ["STATES", "named_boxes", "state_in_words", "state_view"]

STATES = "states"
"""Entity below which each vehicle has its states."""


def named_boxes(vehicles: Sequence[Shown]) -> Any:
    """The 2D boxes as a `rerun.Boxes2D`, in the vehicles' colours and with their names and words."""
    import rerun as rr

    return rr.Boxes2D(
        array=np.array([vehicle.box for vehicle in vehicles]).reshape(-1, 4),
        array_format=rr.Box2DFormat.XYXY,
        colors=[style.readable(style.categorical(vehicle.identity)) for vehicle in vehicles],
        labels=[f"{vehicle.name or vehicle.identity} {vehicle.words}".strip() for vehicle in vehicles],
        show_labels=True,
    )


def state_in_words(what: str, camera_T_object: NDArray[np.float64]) -> str:
    """A status or stage, and whether the camera sees the vehicle's front or its rear."""
    azimuth = float(view_azimuth(camera_T_object[:3, :3], camera_T_object[:3, 3]))
    return f"{what}, {'front' if abs(azimuth) < np.pi / 2 else 'rear'}"


def state_view(name: str = "Status and side") -> Any:
    """The states of all vehicles over time."""
    import rerun.blueprint as rrb

    return rrb.StateTimelineView(origin=f"/{STATES}", name=name)
