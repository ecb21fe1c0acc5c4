"""Ground plane of an image as the variable G(t), and the vehicles that stand on it.

How far cars are off a plane that is given (`Ground`) is mostly the plane's fault, pitch above all, and the
same for all of them; so that part of the plane's uncertainty is the prior's of G, and what is left is each vehicle's
own. A vehicle on another road or a kerb is an outlier of its contact alone. Without a ground the vehicles' own poses
say about where it is, and the prior is wide. For a filter the vehicles are one factor on G(0) (`ground_evidence`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from factors.contact import GroundFrame, contact_factor
from factors.keys import G, X
from factors.linear import ZeroPrior
from factors.losses import Loss, RobustLoss
from factors.marginals import Marginal, marginal, marginal_factor
from factors.noise import diagonal_noise
from fgrecon.core.arrays import Array
from fgrecon.core.camera import Ground
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.solve.graph.graph import Graph, GraphObservation, State
from fgrecon.solve.graph.optimise import optimise
from fgrecon.solve.graph.vehicle_part import ShapeValues
from fgrecon.solve.solve_settings import GROUND_FILTER, SCENE, STATUS
from fgrecon.solve.time.frame import Frame
from fgrecon.solve.weakness import against_ground, off_ground


@dataclass(frozen=True)
class ImageGround:
    """The vehicles of an image on its ground."""

    key: int  # of the ground's variable
    nominal: Ground  # about where the ground is
    frame: GroundFrame  # axes in which the variable changes it
    contacts: Mapping[int, gtsam.CustomFactor]  # the factor between ground and pose of each vehicle, by its number
    spread: Array  # (3,) standard deviations of height, pitch and roll before the vehicles say more

    @classmethod
    def of(
        cls,
        image: int,
        poses: Mapping[int, Array],
        nominal: Ground,
        *,
        given: bool = True,
        lower: Mapping[int, tuple[float, float]] | None = None,
    ) -> ImageGround:
        """The ground of an image with vehicles at poses (4, 4), by number, about where it is given or observed.

        `lower` has those that stand lower than their poses: mean and standard deviation, metres.
        """
        frame, contacts = GroundFrame.of(nominal.normal, nominal.distance), {}
        for number, pose in poses.items():
            mean, sigma = (lower or {}).get(number, (0.0, 0.0))
            noise = _contact_noise(nominal, float(pose[2, 3]), sigma)
            contacts[number] = contact_factor(X(number, 0), G(image), frame.lifted(mean), noise)
        return cls(G(image), nominal, frame, contacts, ground_spread(nominal if given else None))

    @property
    def prior(self) -> gtsam.PriorFactorVector:
        """What is known of the ground before the vehicles say more."""
        return ZeroPrior(self.key, diagonal_noise("ground", self.spread))

    def ground(self, values: gtsam.Values) -> Ground | None:
        """The ground at some values; None where that is none."""
        normal, distance = self.frame.plane(values.atVector(self.key))
        if normal[1] <= SCENE.least_normal_down:
            return None
        return replace(self.nominal, normal=normal, distance=max(distance, SCENE.least_camera_height_m))

    def off_ground(self, result: Reconstruction, given: Ground | None, values: gtsam.Values) -> list[str]:
        """The clause of a vehicle that does not stand on the ground that was given, or else on that of the others."""
        if given is not None:
            return against_ground(result.camera_T_object, given, STATUS.leaning_together_sigmas)
        normal, distance = self.frame.plane(values.atVector(self.key))
        below = float(normal @ result.location - distance)
        return off_ground(below, _own_height(self.nominal, float(result.location[2])))


def ground_spread(plane: Ground | None) -> Array:
    """(3,) standard deviations of height, pitch and roll before the vehicles say more; `plane` is what is given."""
    return np.array(
        SCENE.estimated_ground_sigma if plane is None else (plane.height_sigma, plane.slope_sigma, plane.slope_sigma)
    )


def observed_ground(poses: Sequence[Array]) -> Ground | None:
    """The plane that vehicles' poses (4, 4) speak of: their median down axis and height; None where it is none."""
    down = np.median([pose[:3, 1] for pose in poses], axis=0)
    normal = down / np.linalg.norm(down)
    if normal[1] <= SCENE.least_normal_down:
        return None
    distance = float(np.median([pose[:3, 3] @ normal for pose in poses]))
    return Ground(normal, max(distance, SCENE.least_camera_height_m))


def _contact_noise(ground: Ground, depth: float, sigma: float) -> gtsam.noiseModel.Robust:
    """What is a vehicle's own of its deviation from the plane, and of its height besides, metres."""
    height = np.hypot(_own_height(ground, depth), sigma)
    tilt = SCENE.own_tilt_share * min(ground.tilt_sigma, Ground.tilt_sigma)
    return RobustLoss.of(Loss.CAUCHY, SCENE.contact_loss_sigmas).wrap(
        diagonal_noise("contact", np.array([height, tilt, tilt, tilt]))
    )


def own_deviations(ground: Ground, depth: float) -> tuple[float, float]:
    """How far a vehicle's origin is off the ground of the others by its height and slope, metres (1 sigma each)."""
    height = SCENE.own_height_share * min(ground.height_sigma, Ground.height_sigma)
    return height, SCENE.own_slope_share * min(ground.slope_sigma, Ground.slope_sigma) * depth


def _own_height(ground: Ground, depth: float) -> float:
    """How far a vehicle's origin may lie off the ground of the others, metres (1 sigma)."""
    return float(np.hypot(*own_deviations(ground, depth)))


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
