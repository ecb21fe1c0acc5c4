"""Evidence of the ground from the vehicles of one image that stand on it together, as a factor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from factors.keys import G
from factors.marginals import Marginal, marginal, marginal_factor
from fgrecon.core.camera import Ground
from fgrecon.solve.graph.graph import Graph, GraphObservation, State
from fgrecon.solve.graph.optimise import optimise
from fgrecon.solve.graph.vehicle_part import ShapeValues
from fgrecon.solve.image_ground import ImageGround
from fgrecon.solve.solve_settings import GROUND_FILTER
from fgrecon.solve.time.frame import Frame


@dataclass(frozen=True)
class GroundEvidence:
    """What the vehicles of a frame say of G(0)."""

    marginal: Marginal  # for where it is
    common_factor: float  # by how much less it says of how sure that is, see `Problem.common_factor`


def ground_evidence(
    frames: Sequence[Frame],
    shapes: Sequence[ShapeValues],
    nominal: Ground,
    known: Marginal,
    lower: Mapping[int, tuple[float, float]] | None = None,
) -> GroundEvidence | None:
    """What the vehicles of an image say of the ground, their poses and shapes eliminated.

    Args:
        frames: The image for each of them, near its minimum.
        shapes: Of each, as it is known.
        nominal: About where the ground is.
        known: What is known of its change G(0) from there; of the evidence it is no part.
        lower: By how much lower than they are solved some stand, by index: mean and standard deviation, metres.

    Returns:
        The evidence about G(0); None where there are fewer than two vehicles, or they could not be solved.
    """
    if len(frames) < 2 or "ground" in frames[0].problem.options.disabled_terms:
        return None
    standing = ImageGround.of(0, {i: one.pose.matrix() for i, one in enumerate(frames)}, nominal, lower=lower)
    state = State([one.pose for one in frames], dict(enumerate(shapes)), [one.weights for one in frames], known.values)
    extra = [*standing.contacts.values(), marginal_factor(known)]
    graph = Graph(
        [GraphObservation(one.problem.on(None), vehicle=i) for i, one in enumerate(frames)],
        state,
        pose_free=True,
        extra=extra,
    )
    optimum = optimise(graph, state, GROUND_FILTER.ground_iterations)
    if optimum.failure is not None:
        return None
    speaking, values = gtsam.NonlinearFactorGraph(), optimum.values
    built = graph.build(optimum.state.weights)
    for factor in map(built.at, range(built.size())):
        if list(factor.keys()) != [G(0)]:
            speaking.add(factor)
    try:
        found = marginal(speaking, values, [key for key in values.keys() if key != G(0)])  # noqa: SIM118 - no mapping
    except np.linalg.LinAlgError:  # vehicles that determine nothing
        return None
    if not (np.isfinite(found.matrix).all() and np.isfinite(found.right).all()):
        return None
    return GroundEvidence(found, max(one.problem.common_factor for one in frames))
