"""From keypoints to pose and shape: proposals, factor graph, result. These are the parts to build one's own from."""

from __future__ import annotations

from typing import TYPE_CHECKING

from factors.lazy import lazy_names

if TYPE_CHECKING:  # imported when used
    from fgrecon.solve.graph.adjust import adjust
    from fgrecon.solve.graph.graph import Graph, Seen, State
    from fgrecon.solve.graph.optimise import optimise
    from fgrecon.solve.graph.solver import minimise
    from fgrecon.solve.proposals.adjust import adjust_pose
    from fgrecon.solve.proposals.problem import Problem
    from fgrecon.solve.vehicle.model import prepare

__all__ = ["Graph", "Problem", "Seen", "State", "adjust", "adjust_pose", "minimise", "optimise", "prepare"]

__getattr__, __dir__ = lazy_names(__name__)
