"""Independent solves of an image's vehicles, the start of a scene (`fgrecon.solve.scene`).

Detectors flip some 3D boxes, and keypoint networks some vehicles; a graph that believes in its keypoints follows those
whatever the box says. So which way a vehicle with such a box faces is decided as over time
(`fgrecon.solve.time.heading_filter`): by the poses that its keypoints allow, their energies tempered, the network's
directions, and the box.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.errors import FgreconError
from fgrecon.core.half_turn import flipped_alternative
from fgrecon.core.input_warnings import InputWarning
from fgrecon.core.observation import KeypointsLike, Observation
from fgrecon.core.reconstruction import Alternative, rotation_y
from fgrecon.solve.claimed_points import TakenPlace, is_scanned, without_claimed
from fgrecon.solve.depth_scale import with_scales
from fgrecon.solve.detected import KnownBox
from fgrecon.solve.exclusive_keypoints import with_exclusive_keypoints
from fgrecon.solve.fitted_class import with_fitted_classes
from fgrecon.solve.graph.graph import Graph, GraphObservation, State
from fgrecon.solve.graph.multi_start import MultiStartResult, SolvedStage, minimise_from_proposals
from fgrecon.solve.graph.optimise import optimise
from fgrecon.solve.image_facing import couple_facings, estimate_pose
from fgrecon.solve.inputs import SolveSetup, observe
from fgrecon.solve.proposals.pose_search import PoseEstimate, search_pose
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.time.frame import PosedImage
from fgrecon.solve.time.heading_choice import image_evidence, moved_to
from fgrecon.solve.time.heading_filter import Belief, box_evidence


@dataclass(frozen=True)
class IndependentVehicle:
    """A vehicle that was solved by itself."""

    problem: Problem  # what was solved
    start: PoseEstimate  # the proposals
    adjusted: MultiStartResult  # where the graph's optimisation ended
    box: KnownBox | None = None  # what a detector's box says of it, or None
    belief: Belief | None = None  # which way it faces by that box and all else; None without a box

    @property
    def pose(self) -> Array:
        """(4, 4) camera_T_object."""
        return np.asarray(self.adjusted.optimum.state.poses[0].matrix())

    def converged(self) -> IndependentVehicle:
        """The vehicle as it is solved where nothing follows; with a box it is already."""
        if self.box is not None:
            return self
        return replace(self, adjusted=minimise_from_proposals([GraphObservation(self.problem)], [self.start]))

    def box_factors(self, vehicle: int = 0) -> list[gtsam.NonlinearFactor]:
        """The factors of its box."""
        return [] if self.box is None else self.box.factors(self.problem.camera, vehicle)

    def facing(self, camera_T_object: Array) -> float | None:
        """How probable a pose's facing is by its box and all else; None where only the directions say."""
        return None if self.belief is None else self.belief.facing(rotation_y(camera_T_object))

    def alternatives(self, camera_T_object: Array) -> tuple[Alternative, ...]:
        """Its other poses, where the scene brought it to a pose."""
        facing = self.facing(camera_T_object)
        if facing is None:
            return self.adjusted.alternatives[0]
        return flipped_alternative(camera_T_object, self.adjusted.optimum.state.shapes[0][0], facing)


@dataclass(frozen=True)
class IndependentSolve:
    """All vehicles solved one by one with one camera; `warnings` has what must be wrong with what was given."""

    camera: Camera
    vehicles: dict[int, IndependentVehicle]
    refused: dict[int, FgreconError]
    warnings: dict[int, InputWarning | None]

    @property
    def solved(self) -> dict[int, IndependentVehicle]:
        """Those whose graph was solved."""
        return {number: one for number, one in self.vehicles.items() if one.adjusted.optimum.failure is None}


def solve_independently(
    observations: Sequence[KeypointsLike],
    camera: Camera,
    setup: SolveSetup,
    boxes: Sequence[KnownBox | None] | None = None,
    *,
    image_of: Sequence[int] | None = None,
    steady: float | None = None,
) -> IndependentSolve:
    """Solve vehicles one by one.

    Args:
        setup: What holds for all of them.
        boxes: What a detector's box says of each, whose size takes the place of the fleet's; or None.
        image_of: The image of each, for vehicles of one image say which way one another face; None for one image.
        steady: Where the solves end, as `optimise` has it.
    """
    solved: dict[int, IndependentVehicle] = {}
    refused: dict[int, FgreconError] = {}
    usable: dict[int, Observation] = {}
    warnings: dict[int, InputWarning | None] = {}
    for number, given in enumerate(observations):
        try:
            usable[number], warnings[number] = observe(given, camera, setup, evidence=setup.evidence)
        except FgreconError as error:
            refused[number] = error
    coupled: dict[int, Observation] = {}
    for image in dict.fromkeys(image_of or [0]):
        own = {number: one for number, one in usable.items() if image_of is None or image_of[number] == image}
        own = dict(zip(own, with_exclusive_keypoints([*own.values()], setup.options.keypoints), strict=True))
        own = dict(zip(own, with_scales([*own.values()], camera, setup), strict=True))
        own = dict(zip(own, with_fitted_classes([*own.values()], camera, setup, setup.ground), strict=True))
        usable |= own
        facings = couple_facings([*own.values()], camera, setup.model.prior, setup.options)
        coupled |= zip(own, facings, strict=True)
    for number, observation in usable.items():
        box = None if boxes is None else boxes[number]
        try:
            if box is not None:  # which says itself which way it faces
                solved[number] = _with_box(box.problem(observation, camera, setup), box)
                continue
            solved[number] = _alone(coupled[number], observation, camera, setup, steady)
        except FgreconError as error:
            refused[number] = error
    for image in dict.fromkeys(image_of or [0]):
        places = {
            n: TakenPlace.of(one.adjusted)
            for n, one in solved.items()
            if (image_of is None or image_of[n] == image) and is_scanned(usable[n])
        }
        for number, observation in without_claimed(usable, places).items():
            with suppress(FgreconError):  # it stays where it was
                anew = replace(coupled[number], evidence=observation.evidence)
                solved[number] = _alone(anew, observation, camera, setup, steady)
    return IndependentSolve(camera, solved, refused, warnings)


def _alone(
    coupled: Observation, detected: Observation, camera: Camera, setup: SolveSetup, steady: float | None
) -> IndependentVehicle:
    """Solve a vehicle without a box.

    Args:
        coupled: Its observation, whose directions know the rest.
        detected: It as its detector gave it.
        camera: The camera.
        setup: What holds for all of them.
        steady: Where the solve ends, as `optimise` has it.
    """
    problem = Problem.of(coupled, camera, setup.model_of([detected], [camera]), setup.ground, setup.options)
    problem, start = estimate_pose(problem, detected)
    adjusted = minimise_from_proposals([GraphObservation(problem)], [start], steady=steady)
    return IndependentVehicle(problem, start, adjusted)


def _with_box(problem: Problem, box: KnownBox) -> IndependentVehicle:
    """Solve a vehicle with its box; its keypoints are flipped where that is how they are taken."""
    factors = box.factors(problem.camera)
    start = search_pose(problem, box.box)
    adjusted = minimise_from_proposals([GraphObservation(problem)], [start], factors)
    state = adjusted.optimum.state
    shape = state.shapes[0]
    poses = (Alternative(state.poses[0].matrix(), shape[0], 0.0), *adjusted.alternatives[0])
    evidence = image_evidence(problem.observation, poses)
    evidence = evidence + box_evidence(box.box.rotation_y, box.errors.yaw, box.errors.flip_probability)
    belief = Belief.none().updated(evidence)
    image = PosedImage(given=problem, start=start, poses=poses, pose=state.poses[0], weights=state.weights[0])
    if adjusted.optimum.failure is None and (moved := moved_to(image, belief.heading, shape)) is not image:
        flipped = State([moved.pose], state.shapes, [moved.weights])
        graph = Graph([GraphObservation(moved.problem)], flipped, pose_free=True, extra=factors)
        optimum = optimise(graph, flipped)
        if optimum.failure is None:
            stages = (*adjusted.stages, SolvedStage("joint", graph, optimum.steps))
            problem, adjusted = moved.problem, replace(adjusted, optimum=optimum, stages=stages)
    return IndependentVehicle(problem, start, adjusted, box, belief)
