"""From keypoints to pose and shape: proposals, factor graph, result. These are the parts for building your own."""

from __future__ import annotations

from typing import TYPE_CHECKING

from factors.lazy import lazy_names

if TYPE_CHECKING:  # imported when used
    from fgrecon.solve.graph.graph import Graph, GraphObservation, State
    from fgrecon.solve.graph.multi_start import minimise_from_proposals
    from fgrecon.solve.graph.optimise import optimise
    from fgrecon.solve.graph.solver import minimise
    from fgrecon.solve.proposals.pose_search import search_pose
    from fgrecon.solve.proposals.problem import Problem
    from fgrecon.solve.vehicle.model import prepare

__all__ = [
    "Graph",
    "GraphObservation",
    "Problem",
    "State",
    "minimise",
    "minimise_from_proposals",
    "optimise",
    "prepare",
    "search_pose",
]

__getattr__, __dir__ = lazy_names(__name__)
