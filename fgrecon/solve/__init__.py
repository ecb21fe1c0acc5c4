"""From keypoints to pose and shape: proposals, factor graph, result. These are the parts to build one's own from."""

from __future__ import annotations

from typing import TYPE_CHECKING

from factors.lazy import lazy_names

if TYPE_CHECKING:  # imported when used
    from fgrecon.solve.graph.adjust import adjust_shape
    from fgrecon.solve.graph.graph import VehicleGraph, build
    from fgrecon.solve.graph.solver import minimise
    from fgrecon.solve.proposals.adjust import adjust_pose
    from fgrecon.solve.proposals.problem import Problem
    from fgrecon.solve.vehicle.model import prepare

__all__ = ["Problem", "VehicleGraph", "adjust_pose", "adjust_shape", "build", "minimise", "prepare"]

__getattr__, __dir__ = lazy_names(__name__)
