"""All vehicles of an image together: each stands on the ground, and the ground is a variable; so may the camera be.

    +--- keypoints, box --- X(1,0) --- contact ---+
    F(0) keypoints, box --- X(2,0) --- contact --- G(0) --- prior (what is known of the mount)
    +--- keypoints, box --- X(3,0) --- contact ---+

Every vehicle is first solved alone. How far cars lie off a plane that is told beforehand (`Ground`) is mostly the
plane's fault, pitch above all, and the same for all of them; so that part of the plane's uncertainty is the prior's of
G, and what is left is each vehicle's own. A vehicle on another road or a kerb is an outlier of its contact alone.
Without a ground the vehicles' own poses say about where it is, and the prior is wide.

Where the focal length is not known it is the variable F(0) of all keypoints and boxes (`fgrecon.solve.focal`). Vehicles
of which another detector has a 3D box have its factors as well (`fgrecon.solve.detected`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import gtsam
import numpy as np
from numpy.typing import ArrayLike, NDArray

from factors.contact import GroundFrame, contact_factor
from factors.keys import F, G, X
from factors.losses import Loss, RobustLoss
from factors.marginals import Marginal, marginal, marginal_factor
from factors.noise import diagonal_noise
from fgrecon.core.box3d import Box3D, BoxErrors
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.core.options import Options
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.scene_reconstruction import SceneReconstruction
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.core.size_prior import size_prior as named_size_prior
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.alone import Alone, Tried, each_alone, known_boxes
from fgrecon.solve.focal import candidates, focal_prior, log_ratio, starts
from fgrecon.solve.graph.adjust import Adjusted, SolvedStage
from fgrecon.solve.graph.covariance import factorise
from fgrecon.solve.graph.graph import Graph, Seen, State
from fgrecon.solve.graph.optimise import Optimum, optimise
from fgrecon.solve.occlusion import with_occlusion
from fgrecon.solve.pipeline import ground_plane
from fgrecon.solve.result import history_of, results, weakened
from fgrecon.solve.threads import single_threaded
from fgrecon.solve.vehicle.model import VehicleModel, prepare
from fgrecon.solve.weakness import off_ground

__all__ = ["OWN_HEIGHT", "OWN_SLOPE", "OWN_TILT", "ground_evidence", "reconstruct_scene"]

Array = NDArray[np.float64]

OWN_HEIGHT, OWN_SLOPE, OWN_TILT = 0.35, 0.15, 0.5
"""Shares of a told ground's deviations that are each vehicle's own; chosen on KITTI's video (docs/method.md)."""
_WIDE = (0.5, 0.3, 0.1)  # metres, radians, radians: prior of height, pitch and roll where no ground is told
_OUTLYING = 3.0  # standard deviations from which on a contact counts less
_SAME_FOCAL = 0.02  # logarithms that differ by less are of one focal length
_LEAST_HEIGHT = 0.2  # metres; a camera is above the road


@single_threaded
def reconstruct_scene(
    observations: Sequence[Observation],
    camera: Camera | ArrayLike,
    *,
    prior: ShapePrior | str | Path = "car14",
    ground: Ground | float | None = None,
    size_prior: SizePrior | str | None = None,
    options: Options | None = None,
    boxes: Sequence[Box3D | None] | None = None,
    box_errors: BoxErrors | None = None,
) -> SceneReconstruction:
    """Recover pose and shape of all vehicles of an image, and the ground that they stand on.

    Args:
        observations: The keypoints of each vehicle.
        camera: The camera that took the image, or its matrix (3, 3), or (fx, fy, cx, cy). One whose focal length is not
            known (`Camera.focal_sigma`, `Camera.of_unknown`) is found with the vehicles.
        prior: Shape prior, or its name, or the path of its file.
        ground: About where the ground is; a number is the height in metres of a level camera. None tells nothing: the
            vehicles say where it is.
        size_prior: Fleet (`kitti`, `apollo79`), or a size prior; None takes sizes from the shape prior.
        options: Settings; `joint` must be set.
        boxes: What another detector says of each vehicle, None where it does not: factors on its pose, and a size in
            the place of `size_prior`.
        box_errors: How far these boxes are off; None for a monocular detector's.

    Returns:
        The scene. Vehicles that determine no pose are in `refused`. Where fewer than two were solved there is nothing
        to solve together but the focal length, and with a known one the results are those of `fgrecon.reconstruct`.

    Raises:
        InvalidInputError: An argument cannot be used, such as a distorted lens without a focal length; names it, its
            value and the fix.
    """
    options = Options() if options is None else options
    if not options.shape.joint:
        raise InvalidInputError("options.shape.joint", value=False, fix="Let pose and shape move: joint=True.")
    shape_prior, known, plane = load_prior(prior), Camera.of(camera), ground_plane(ground)
    fleet = None if size_prior is None else named_size_prior(size_prior)
    model = prepare(shape_prior, fleet, options.shape.basis_vectors)
    boxed = None
    if boxes is not None:
        plain = prepare(shape_prior, None, options.shape.basis_vectors)
        boxed = known_boxes(boxes, box_errors, len(observations), known, plain)
    started = perf_counter()
    tried = [each_alone(observations, one, model, plane, options, boxed) for one in candidates(known)]
    energies = _energies(tried, known)
    found = perf_counter()
    joint = [scene for i in starts(energies) if (scene := _together(tried[i], known, plane, options)) is not None]
    told = None if not joint else _told(min(joint, key=lambda one: one.optimum.energy), joint, known)
    if told is None:
        alone = tried[min(range(len(tried)), key=lambda i: (energies[i], abs(log_ratio(tried[i].camera, known))))]
        told = _Told({}, plane, None, known, (), "They were solved one by one.", alone)
    alone = told.alone
    each = {number: _result(one) for number, one in alone.vehicles.items() if number not in told.results}
    each |= told.results
    numbers = tuple(sorted(each))
    milliseconds = {"alone": (found - started) * 1e3, "together": (perf_counter() - found) * 1e3}
    return SceneReconstruction(
        numbers,
        with_occlusion([each[n] for n in numbers]),
        alone.refused,
        told.ground,
        told.ground_covariance,
        told.camera,
        told.focal_lengths,
        told.message,
        milliseconds,
    )


@dataclass(frozen=True)
class _Joint:
    """Vehicles that were solved together, from where they were alone."""

    alone: Tried
    seen: list[Seen]
    graph: Graph
    optimum: Optimum
    extra: list[gtsam.NonlinearFactor]
    contacts: dict[int, gtsam.CustomFactor]
    nominal: Ground | None
    frame: GroundFrame | None


@dataclass(frozen=True)
class _Told:
    """What is said of a scene; vehicles without a result are as they were alone."""

    results: dict[int, Reconstruction]
    ground: Ground | None
    ground_covariance: Array | None
    camera: Camera
    focal_lengths: tuple[tuple[float, float], ...]
    message: str
    alone: Tried


def _energies(tried: Sequence[Tried], known: Camera) -> list[float]:
    """The energy with each of the cameras, of the vehicles that were solved with all of them."""
    if len(tried) == 1:
        return [0.0]
    common = set.intersection(*(set(one.solved) for one in tried))
    if not common:
        return [math.inf] * len(tried)
    return [
        sum(one.vehicles[number].adjusted.optimum.energy for number in common)
        + 0.5 * (log_ratio(one.camera, known) / known.focal_sigma) ** 2
        for one in tried
    ]


def _result(one: Alone) -> Reconstruction:
    adjusted = replace(one.adjusted, alternatives=(one.alternatives(one.pose),))
    return results([Seen(one.problem)], [one.start], adjusted, {}, one.own(), facing=[one.facing(one.pose)])[0]


def ground_evidence(
    observations: Sequence[Observation],
    camera: Camera,
    model: VehicleModel,
    plane: Ground,
    options: Options,
    known: Marginal,
) -> Marginal | None:
    """What the vehicles of an image say of the ground, their poses and shapes eliminated.

    Args:
        observations: The keypoints of each vehicle.
        camera: The camera, whose focal length is taken as it is.
        model: The prepared prior.
        plane: About where the ground is.
        options: Settings.
        known: What is known of its change G(0) from there; of the evidence it is no part.

    Returns:
        The evidence about G(0); None where there are fewer than two vehicles, or they could not be solved.
    """
    sure = replace(camera, focal_sigma=0.0)
    best = _together(each_alone(observations, sure, model, plane, options), sure, plane, options, known)
    if best is None or best.frame is None:
        return None
    told, values = gtsam.NonlinearFactorGraph(), best.optimum.values
    built = best.graph.build(best.optimum.state.weights)
    for factor in map(built.at, range(built.size())):
        if list(factor.keys()) != [G(0)]:
            told.add(factor)
    found = marginal(told, values, [key for key in values.keys() if key != G(0)])  # noqa: SIM118 - no mapping
    return found if np.isfinite(found.matrix).all() and np.isfinite(found.right).all() else None


def _together(
    alone: Tried, known: Camera, plane: Ground | None, options: Options, before: Marginal | None = None
) -> _Joint | None:
    """The joint solve; None where there is nothing to solve together, or it gave up."""
    solved = alone.solved
    on_ground = len(solved) > 1 and "ground" not in options.disabled_terms
    if not solved or not (on_ground or known.focal_sigma):
        return None
    seen: list[Seen] = []
    contacts: dict[int, gtsam.CustomFactor] = {}
    priors: list[gtsam.NonlinearFactor] = []
    others = gtsam.Values()
    nominal, frame = plane, None
    if on_ground:
        nominal = plane if plane is not None else _seen_ground([one.pose for one in solved.values()])
        frame = GroundFrame.of(nominal.normal, nominal.distance)
        spread = _WIDE if plane is None else (nominal.height_sigma, nominal.slope_sigma, nominal.slope_sigma)
        if before is None:
            others.insert(G(0), np.zeros(3))
            priors.append(gtsam.PriorFactorVector(G(0), np.zeros(3), diagonal_noise("ground", np.array(spread))))
        else:
            others.insert(before.values)
            priors.append(marginal_factor(before))
        for number, one in solved.items():
            noise = _contact_noise(nominal, float(one.pose[2, 3]))
            contacts[number] = contact_factor(X(number, 0), G(0), frame, noise)
    if known.focal_sigma:
        others.insert(F(0), np.zeros(1))
        priors.append(focal_prior(known, alone.camera))
    for number, one in solved.items():
        priors += one.own(number)
        free = replace(one.problem, ground=None, energy=replace(one.problem.energy, ground=None))
        seen.append(Seen(free if on_ground else one.problem, vehicle=number))
    states = [one.adjusted.optimum.state for one in solved.values()]
    state = State(
        poses=[state.poses[0] for state in states],
        shapes={number: state.shapes[0] for number, state in zip(solved, states, strict=True)},
        weights=[state.weights[0] for state in states],
        others=others,
    )
    extra = [*contacts.values(), *priors]
    graph = Graph(seen, state, pose_free=True, extra=extra)
    optimum = optimise(graph, state)
    if optimum.failure is not None:
        return None
    return _Joint(alone, seen, graph, optimum, extra, contacts, nominal, frame)


def _told(best: _Joint, joint: Sequence[_Joint], known: Camera) -> _Told:
    """Results of the vehicles, the ground and the camera, with what is left open of both."""
    solved, optimum, values = best.alone.solved, best.optimum, best.optimum.values
    poses = [pose.matrix() for pose in optimum.state.poses]
    adjusted = Adjusted(
        optimum,
        (SolvedStage("scene", best.graph, optimum.steps),),
        tuple(one.alternatives(pose) for one, pose in zip(solved.values(), poses, strict=True)),
    )
    starts_ = [one.start for one in solved.values()]
    if best.graph.options.keep_history:  # what led to each vehicle's pose alone; the scene's steps follow
        starts_ = [
            replace(one.start, history=history_of(one.start, one.adjusted, 0, alone=True)) for one in solved.values()
        ]
    facing = [one.facing(pose) for one, pose in zip(solved.values(), poses, strict=True)]
    each = dict(zip(solved, results(best.seen, starts_, adjusted, {}, best.extra, facing=facing), strict=True))
    for number, contact in best.contacts.items():
        energies = {**each[number].energies, "ground": float(contact.error(values))}
        each[number] = replace(each[number], energies=energies)
        if best.frame is not None and best.nominal is not None:
            told = solved[number].problem.ground
            each[number] = weakened(each[number], _off_ground(each[number], told, best, values.atVector(G(0))))
    marginals = factorise(best.graph.build(optimum.state.weights), values)
    ground, camera, shared = best.nominal, best.alone.camera, []
    lengths: tuple[tuple[float, float], ...] = ()
    if best.frame is not None and best.nominal is not None:
        normal, distance = best.frame.plane(values.atVector(G(0)))
        ground = replace(best.nominal, normal=normal, distance=max(distance, _LEAST_HEIGHT))
        shared.append("the ground")
    if known.focal_sigma:
        variance = _marginal(marginals, F(0))
        sigma = known.focal_sigma if variance is None else float(np.sqrt(variance[0, 0]))
        camera = replace(_camera(best), focal_sigma=min(sigma, known.focal_sigma))
        lengths = tuple(
            (float(_camera(one).matrix[0, 0]), one.optimum.energy - optimum.energy)
            for one in sorted(joint, key=lambda one: one.optimum.energy)
        )
        shared.append("the focal length")
    message = f"{len(each)} were solved together with {' and '.join(shared)}."
    covariance = None if best.frame is None else _marginal(marginals, G(0))
    return _Told(each, ground, covariance, camera, _distinct(lengths), message, best.alone)


def _off_ground(result: Reconstruction, told: Ground | None, joint: _Joint, change: Array) -> list[str]:
    """The clause of a vehicle that does not stand on the ground that was told, or else on that of the others."""
    assert joint.frame is not None
    assert joint.nominal is not None
    depth = float(result.location[2])
    if told is not None:
        return off_ground(float(told.normal @ result.location - told.distance), told.height_sigma_at_depth(depth))
    normal, distance = joint.frame.plane(change)
    return off_ground(float(normal @ result.location - distance), _own_height(joint.nominal, depth))


def _camera(joint: _Joint) -> Camera:
    return joint.alone.camera.scaled(math.exp(joint.optimum.values.atVector(F(0))[0]))


def _distinct(lengths: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    """Without those that are one of the better ones again."""
    kept: list[tuple[float, float]] = []
    for pixels, excess in lengths:
        if all(abs(math.log(pixels / other)) > _SAME_FOCAL for other, _ in kept):
            kept.append((pixels, excess))
    return tuple(kept)


def _seen_ground(poses: Sequence[Array]) -> Ground:
    """The plane that vehicles' poses (4, 4) speak of: their median down axis and height."""
    down = np.median([pose[:3, 1] for pose in poses], axis=0)
    normal = down / np.linalg.norm(down)
    distance = float(np.median([pose[:3, 3] @ normal for pose in poses]))
    upright = normal if normal[1] > 0.0 else np.array([0.0, 1.0, 0.0])
    return Ground(upright, max(distance, _LEAST_HEIGHT))


def _contact_noise(ground: Ground, depth: float) -> gtsam.noiseModel.Robust:
    """What is a vehicle's own of its deviation from the plane."""
    height, tilt = _own_height(ground, depth), OWN_TILT * ground.tilt_sigma
    return RobustLoss.of(Loss.CAUCHY, _OUTLYING).wrap(diagonal_noise("contact", np.array([height, tilt, tilt, tilt])))


def _own_height(ground: Ground, depth: float) -> float:
    """How far a vehicle's origin may lie off the ground of the others, metres (1 sigma)."""
    return float(np.hypot(OWN_HEIGHT * ground.height_sigma, OWN_SLOPE * ground.slope_sigma * depth))


def _marginal(marginals: gtsam.Marginals | None, key: int) -> Array | None:
    if marginals is None:
        return None
    covariance: Array = marginals.marginalCovariance(key)
    return covariance if np.isfinite(covariance).all() else None
