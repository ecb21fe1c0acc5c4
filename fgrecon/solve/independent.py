"""The vehicles of an image one by one: where a scene begins (`fgrecon.solve.scene`).

Detectors turn some 3D boxes round, and keypoint networks some vehicles; a graph that believes in its keypoints follows
those whatever the box says. So which way a vehicle with such a box faces is decided as over time
(`fgrecon.solve.time.heading`): by the poses that its keypoints allow, their energies tempered, the network's
directions, and the box.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.errors import FgreconError
from fgrecon.core.observation import KeypointsLike, Observation
from fgrecon.core.reconstruction import Alternative, rotation_y
from fgrecon.core.turned import turned_alternative
from fgrecon.solve.detected import KnownBox
from fgrecon.solve.facing import couple_facings, estimate_pose
from fgrecon.solve.graph.graph import Graph, GraphObservation, State
from fgrecon.solve.graph.multi_start import MultiStartResult, SolvedStage, minimise_from_proposals
from fgrecon.solve.graph.optimise import optimise
from fgrecon.solve.inputs import SolveSetup, observe
from fgrecon.solve.proposals.pose_search import PoseEstimate, search_pose
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.time.heading import Belief, box_says
from fgrecon.solve.time.vehicle import face, image_says
from fgrecon.solve.time.window import Frame

__all__ = ["Alone", "Tried", "each_alone"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Alone:
    """A vehicle that was solved alone.

    Attributes:
        problem: What was solved.
        start: The proposals.
        adjusted: Where the graph's optimisation ended.
        known: What a detector's box says of it, or None.
        belief: Which way it faces by that box and all else; None without a box.
    """

    problem: Problem
    start: PoseEstimate
    adjusted: MultiStartResult
    known: KnownBox | None = None
    belief: Belief | None = None

    @property
    def pose(self) -> Array:
        """(4, 4) camera_T_object."""
        pose: Array = self.adjusted.optimum.state.poses[0].matrix()
        return pose

    def to_the_end(self) -> Alone:
        """The vehicle as it is solved where nothing follows; with a box it is already."""
        if self.known is not None:
            return self
        return replace(self, adjusted=minimise_from_proposals([GraphObservation(self.problem)], [self.start]))

    def own(self, vehicle: int = 0) -> list[gtsam.NonlinearFactor]:
        """The factors of its box."""
        return [] if self.known is None else self.known.factors(self.problem.camera, vehicle)

    def facing(self, camera_T_object: Array) -> float | None:
        """How probable a pose's facing is by its box and all else; None where only the directions tell."""
        return None if self.belief is None else self.belief.facing(rotation_y(camera_T_object))

    def alternatives(self, camera_T_object: Array) -> tuple[Alternative, ...]:
        """Its other poses, where the scene brought it to a pose."""
        facing = self.facing(camera_T_object)
        if facing is None:
            return self.adjusted.alternatives[0]
        return turned_alternative(camera_T_object, self.adjusted.optimum.state.shapes[0][0], facing)


@dataclass(frozen=True)
class Tried:
    """All vehicles solved one by one with one camera."""

    camera: Camera
    vehicles: dict[int, Alone]
    refused: dict[int, FgreconError]

    @property
    def solved(self) -> dict[int, Alone]:
        """Those whose graph was solved."""
        return {number: one for number, one in self.vehicles.items() if one.adjusted.optimum.failure is None}


def each_alone(
    observations: Sequence[KeypointsLike],
    camera: Camera,
    setup: SolveSetup,
    known: Sequence[KnownBox | None] | None = None,
    *,
    image_of: Sequence[int] | None = None,
    steady: float | None = None,
) -> Tried:
    """Solve vehicles one by one.

    Args:
        observations: The keypoints of each.
        camera: The camera.
        setup: What holds for all of them.
        known: What a detector's box says of each, whose size takes the place of the fleet's; or None.
        image_of: The image of each, for vehicles of one image say which way one another face; None for one image.
        steady: Where the solves end, as `optimise` has it.
    """
    alone: dict[int, Alone] = {}
    refused: dict[int, FgreconError] = {}
    seen: dict[int, Observation] = {}
    for number, given in enumerate(observations):
        try:
            seen[number] = observe(given, camera, setup.prior.category, setup.options)
        except FgreconError as error:
            refused[number] = error
    together: dict[int, Observation] = {}
    for image in dict.fromkeys(image_of or [0]):
        own = {number: one for number, one in seen.items() if image_of is None or image_of[number] == image}
        together |= zip(own, couple_facings([*own.values()], camera, setup.model.prior, setup.options), strict=True)
    for number, observation in seen.items():
        box = None if known is None else known[number]
        try:
            if box is not None:  # which says itself which way it faces
                alone[number] = _with_box(box.problem(observation, camera, setup), box)
                continue
            coupled = Problem.of(together[number], camera, setup.model, setup.ground, setup.options)
            problem, start = estimate_pose(coupled, observation)
        except FgreconError as error:
            refused[number] = error
            continue
        alone[number] = Alone(
            problem, start, minimise_from_proposals([GraphObservation(problem)], [start], steady=steady)
        )
    return Tried(camera, alone, refused)


def _with_box(problem: Problem, known: KnownBox) -> Alone:
    """Solve a vehicle with its box; the observation is turned round where that is how it is taken.

    Raises:
        DegenerateProblemError: No pose is found.
    """
    own = known.factors(problem.camera)
    start = search_pose(problem, known.box)
    adjusted = minimise_from_proposals([GraphObservation(problem)], [start], own)
    state = adjusted.optimum.state
    poses = (Alternative(state.poses[0].matrix(), state.shapes[0][0], 0.0), *adjusted.alternatives[0])
    box, errors = known.box, known.errors
    evidence = image_says(problem.observation, poses) + box_says(box.rotation_y, errors.yaw, errors.turned)
    belief = Belief.none().told(evidence)
    frame = Frame(0, 0.0, problem, start, poses, evidence, None, state.poses[0], state.weights[0], belief=belief)
    if adjusted.optimum.failure is None and face([frame], state.shapes[0]):
        turned = State([frame.pose], state.shapes, [frame.weights])
        graph = Graph([GraphObservation(frame.problem)], turned, pose_free=True, extra=own)
        optimum = optimise(graph, turned)
        if optimum.failure is None:
            stages = (*adjusted.stages, SolvedStage("joint", graph, optimum.steps))
            problem, adjusted = frame.problem, replace(adjusted, optimum=optimum, stages=stages)
    return Alone(problem, start, adjusted, known, belief)
