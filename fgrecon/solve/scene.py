"""All vehicles of an image together: each stands on the ground, and the ground is a variable.

    keypoints, box --- X(1,0) --- contact ---+
    keypoints, box --- X(2,0) --- contact --- G(0) --- prior (what is known of the mount)
    keypoints, box --- X(3,0) --- contact ---+

Every vehicle is first solved alone. How far cars lie off a plane that is told beforehand (`Ground`) is mostly the
plane's fault, pitch above all, and the same for all of them; so that part of the plane's uncertainty is the prior's of
G, and what is left is each vehicle's own. A vehicle on another road or a kerb is an outlier of its contact alone.
Without a ground the vehicles' own poses say about where it is, and the prior is wide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import gtsam
import numpy as np
from numpy.typing import ArrayLike, NDArray

from factors.contact import GroundFrame, contact_factor
from factors.keys import G, X
from factors.losses import Loss, RobustLoss
from factors.noise import diagonal_noise
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.core.options import Options
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.scene_reconstruction import SceneReconstruction
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.core.size_prior import size_prior as named_size_prior
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.graph.adjust import Adjusted, SolvedStage, adjust
from fgrecon.solve.graph.covariance import factorise
from fgrecon.solve.graph.graph import Graph, Seen, State
from fgrecon.solve.graph.optimise import optimise
from fgrecon.solve.pipeline import ground_plane, observe
from fgrecon.solve.proposals.adjust import PoseEstimate, adjust_pose
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.result import history_of, results
from fgrecon.solve.threads import single_threaded
from fgrecon.solve.vehicle.model import prepare

__all__ = ["reconstruct_scene"]

Array = NDArray[np.float64]

_OWN_HEIGHT, _OWN_SLOPE, _OWN_TILT = 0.35, 0.15, 0.5
"""Shares of a told ground's deviations that are each vehicle's own; chosen on KITTI's video (docs/method.md)."""
_WIDE = (0.5, 0.3, 0.1)  # metres, radians, radians: prior of height, pitch and roll where no ground is told
_OUTLYING = 3.0  # standard deviations from which on a contact counts less
_LEAST_HEIGHT = 0.2  # metres; a camera is above the road


@dataclass(frozen=True)
class _Alone:
    """A vehicle that was solved alone."""

    problem: Problem
    start: PoseEstimate
    adjusted: Adjusted

    @property
    def pose(self) -> Array:
        pose: Array = self.adjusted.optimum.state.poses[0].matrix()
        return pose


@single_threaded
def reconstruct_scene(
    observations: Sequence[Observation],
    camera: Camera | ArrayLike,
    *,
    prior: ShapePrior | str | Path = "car14",
    ground: Ground | float | None = None,
    size_prior: SizePrior | str | None = None,
    options: Options | None = None,
) -> SceneReconstruction:
    """Recover pose and shape of all vehicles of an image, and the ground that they stand on.

    Args:
        observations: The keypoints of each vehicle.
        camera: The camera that took the image, or its matrix (3, 3), or (fx, fy, cx, cy).
        prior: Shape prior, or its name, or the path of its file.
        ground: About where the ground is; a number is the height in metres of a level camera. None tells nothing: the
            vehicles say where it is.
        size_prior: Fleet (`kitti`, `apollo79`), or a size prior; None takes sizes from the shape prior.
        options: Settings; `joint` must be set.

    Returns:
        The scene. Vehicles that determine no pose are in `refused`. Where fewer than two were solved there is nothing
        to solve together, and the results are those of `fgrecon.reconstruct`.

    Raises:
        InvalidInputError: An argument cannot be used; names it, its value and the fix.
    """
    options = Options() if options is None else options
    if not options.shape.joint:
        raise InvalidInputError("options.shape.joint", value=False, fix="Let pose and shape move: joint=True.")
    shape_prior, seen_by, plane = load_prior(prior), Camera.of(camera), ground_plane(ground)
    model = prepare(
        shape_prior, None if size_prior is None else named_size_prior(size_prior), options.shape.basis_vectors
    )
    started = perf_counter()
    alone: dict[int, _Alone] = {}
    refused: dict[int, FgreconError] = {}
    for number, given in enumerate(observations):
        try:
            observation = observe(given, seen_by, shape_prior, options)
            problem = Problem.of(observation, seen_by, model, plane, options)
            start = adjust_pose(problem)
        except FgreconError as error:
            refused[number] = error
            continue
        alone[number] = _Alone(problem, start, adjust([Seen(problem)], [start]))
    found = perf_counter()
    solved = {number: one for number, one in alone.items() if one.adjusted.optimum.failure is None}
    told = None if len(solved) < 2 or "ground" in options.disabled_terms else _together(solved, plane, options)
    milliseconds = {"alone": (found - started) * 1e3, "together": (perf_counter() - found) * 1e3}
    if told is None:
        results_ = {number: _result(one) for number, one in alone.items()}
        message = "They were solved one by one."
        shown, covariance = plane, None
    else:
        results_, shown, covariance = told
        results_ |= {number: _result(one) for number, one in alone.items() if number not in results_}
        message = f"{len(told[0])} were solved together with the ground."
    numbers = tuple(sorted(results_))
    return SceneReconstruction(
        numbers, tuple(results_[n] for n in numbers), refused, shown, covariance, message, milliseconds
    )


def _result(one: _Alone) -> Reconstruction:
    return results([Seen(one.problem)], [one.start], one.adjusted, {})[0]


def _together(
    alone: dict[int, _Alone], plane: Ground | None, options: Options
) -> tuple[dict[int, Reconstruction], Ground, Array | None] | None:
    """Results by number, the ground and its covariance; None where the joint solve gave up."""
    nominal = plane if plane is not None else _seen_ground([one.pose for one in alone.values()])
    frame = GroundFrame.of(nominal.normal, nominal.distance)
    seen, contacts = [], {}
    for number, one in alone.items():
        free = replace(one.problem, ground=None, energy=replace(one.problem.energy, ground=None))
        seen.append(Seen(free, vehicle=number))
        contacts[number] = contact_factor(X(number, 0), G(0), frame, _contact_noise(nominal, float(one.pose[2, 3])))
    spread = _WIDE if plane is None else (nominal.height_sigma, nominal.slope_sigma, nominal.slope_sigma)
    mount = gtsam.PriorFactorVector(G(0), np.zeros(3), diagonal_noise("ground", np.array(spread)))
    others = gtsam.Values()
    others.insert(G(0), np.zeros(3))
    states = [one.adjusted.optimum.state for one in alone.values()]
    state = State(
        poses=[state.poses[0] for state in states],
        shapes={number: state.shapes[0] for number, state in zip(alone, states, strict=True)},
        weights=[state.weights[0] for state in states],
        others=others,
    )
    extra = [*contacts.values(), mount]
    graph = Graph(seen, state, pose_free=True, extra=extra)
    optimum = optimise(graph, state)
    if optimum.failure is not None:
        return None
    adjusted = Adjusted(
        optimum,
        (SolvedStage("scene", graph, optimum.steps),),
        tuple(one.adjusted.alternatives[0] for one in alone.values()),
    )
    starts = [one.start for one in alone.values()]
    if options.keep_history:  # what led to each vehicle's pose alone; the scene's steps follow
        starts = [
            replace(one.start, history=history_of(one.start, one.adjusted, 0, alone=True)) for one in alone.values()
        ]
    values = graph.values(optimum.state)
    each = results(seen, starts, adjusted, {}, extra)
    told = {
        number: replace(result, energies={**result.energies, "ground": float(contacts[number].error(values))})
        for number, result in zip(alone, each, strict=True)
    }
    normal, distance = frame.plane(values.atVector(G(0)))
    return (
        told,
        replace(nominal, normal=normal, distance=max(distance, _LEAST_HEIGHT)),
        _covariance(graph, optimum.state),
    )


def _seen_ground(poses: Sequence[Array]) -> Ground:
    """The plane that vehicles' poses (4, 4) speak of: their median down axis and height."""
    down = np.median([pose[:3, 1] for pose in poses], axis=0)
    normal = down / np.linalg.norm(down)
    distance = float(np.median([pose[:3, 3] @ normal for pose in poses]))
    upright = normal if normal[1] > 0.0 else np.array([0.0, 1.0, 0.0])
    return Ground(upright, max(distance, _LEAST_HEIGHT))


def _contact_noise(ground: Ground, depth: float) -> gtsam.noiseModel.Robust:
    """What is a vehicle's own of its deviation from the plane."""
    height = float(np.hypot(_OWN_HEIGHT * ground.height_sigma, _OWN_SLOPE * ground.slope_sigma * depth))
    tilt = _OWN_TILT * ground.tilt_sigma
    return RobustLoss.of(Loss.CAUCHY, _OUTLYING).wrap(diagonal_noise("contact", np.array([height, tilt, tilt, tilt])))


def _covariance(graph: Graph, state: State) -> Array | None:
    marginals = factorise(graph.build(state.weights), graph.values(state))
    if marginals is None:
        return None
    covariance: Array = marginals.marginalCovariance(G(0))
    return covariance if np.isfinite(covariance).all() else None
