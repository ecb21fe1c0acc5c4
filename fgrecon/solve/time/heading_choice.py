"""Images of a vehicle brought to a chosen heading: to one of their poses there, or with the keypoints flipped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import gtsam
import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.errors import DegenerateProblemError
from fgrecon.core.half_turn import HALF_TURN, flipped_observation
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import Alternative, rotation_y
from fgrecon.solve.graph.graph import Graph, GraphObservation, State
from fgrecon.solve.graph.optimise import Optimum, optimise
from fgrecon.solve.graph.vehicle_part import ShapeValues
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.proposals.terms import direction_penalty
from fgrecon.solve.time.frame import Frame, PosedImage
from fgrecon.solve.time.heading_filter import another_side, direction_evidence, earlier_beliefs, pose_evidence
from fgrecon.solve.time.time_settings import SETTINGS

Image = TypeVar("Image", bound=PosedImage)


def image_evidence(observation: Observation, poses: Sequence[Alternative]) -> Array:
    """(B,) logarithms of what an image says of the heading.

    Args:
        observation: What is observed there.
        poses: The poses that its keypoints allow, the result first, with the energies of the whole.
    """
    azimuth = observation.azimuth
    energies = [p.excess - direction_penalty(azimuth, p.camera_T_object) for p in poses]
    if not np.isfinite(energies).all():  # a strategy without an energy of its own
        energies = [0.0 if i == 0 else SETTINGS.unscored_pose_excess_nats for i in range(len(poses))]
    evidence = pose_evidence([rotation_y(p.camera_T_object) for p in poses], energies, alone=azimuth is None)
    return evidence + direction_evidence(azimuth, poses[0].camera_T_object[:3, 3])


def choose_headings(frames: Sequence[Frame], shape: ShapeValues) -> list[Frame]:
    """The frames, each on the side where it is by what the last one knows, and with the belief of that."""
    steps = [(f.step.seconds, f.step.turn) for f in frames[1:] if f.step is not None]
    beliefs = earlier_beliefs(frames[-1].belief, [f.image for f in frames], steps)
    return [
        replace(moved_to(frame, belief.heading, shape), belief=belief)
        for frame, belief in zip(frames, beliefs, strict=True)
    ]


def moved_to(image: Image, heading: float, shape: ShapeValues) -> Image:
    """The image as it is where it faces a heading already, else started anew there."""
    if not another_side(rotation_y(image.pose.matrix()), heading):
        return image
    near = [
        p
        for p in image.poses
        if not p.excess > SETTINGS.pose_excess_nats and not another_side(rotation_y(p.camera_T_object), heading)
    ]
    if near:
        pose = gtsam.Pose3(min(near, key=lambda p: p.excess).camera_T_object)
        if image.flipped is None:
            return replace(image, pose=pose)
        problem, _ = _explaining(image.given, image.flipped, pose, image, shape)
        return replace(image, pose=pose, flipped=None if problem is image.given else problem)
    pose = image.pose.compose(gtsam.Pose3(HALF_TURN))
    if another_side(rotation_y(pose.matrix()), heading):
        turn = heading - rotation_y(image.pose.matrix())  # about its own vertical axis
        pose = gtsam.Pose3(image.pose.rotation().compose(gtsam.Rot3.Ry(turn)), image.pose.translation())
    other = _flipped(image.given) if image.flipped is None else image.given
    problem, end = _explaining(image.problem, other, pose, image, shape)
    refined = end.state.poses[0]
    moved = pose if another_side(rotation_y(refined.matrix()), heading) else refined
    return replace(image, pose=moved, flipped=None if problem is image.given else problem)


def _explaining(
    first: Problem, second: Problem | None, pose: gtsam.Pose3, image: PosedImage, shape: ShapeValues
) -> tuple[Problem, Optimum]:
    """The first of two problems, or the second where a pose explains that clearly better; with the refined pose."""

    def refined(problem: Problem) -> Optimum:
        """The pose by its image alone, the shape held."""
        state = State([pose], {0: shape}, [image.weights])
        return optimise(Graph([GraphObservation(problem)], state, pose_free=True, hold_shape=True), state)

    end = refined(first)
    if second is not None and (other := refined(second)).energy + SETTINGS.flip_gain_nats < end.energy:
        return second, other
    return first, end


def _flipped(given: Problem) -> Problem | None:
    """The problem with its keypoints flipped; None where too few have a partner on the other side."""
    try:
        return given.showing(flipped_observation(given.observation, given.model.prior))
    except DegenerateProblemError:
        return None
