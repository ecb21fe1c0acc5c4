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
from factors.noise import diagonal_noise
from fgrecon.core.box3d import Box3D, BoxErrors
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.observation import Observation
from fgrecon.core.options import Options
from fgrecon.core.reconstruction import Alternative, Reconstruction, rotation_y
from fgrecon.core.scene_reconstruction import SceneReconstruction
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.core.size_prior import size_prior as named_size_prior
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.detected import DetectedVehicle, KnownBox
from fgrecon.solve.focal import candidates, focal_prior, log_ratio, starts
from fgrecon.solve.graph.adjust import Adjusted, SolvedStage, adjust
from fgrecon.solve.graph.covariance import factorise
from fgrecon.solve.graph.graph import Graph, Seen, State
from fgrecon.solve.graph.optimise import Optimum, optimise
from fgrecon.solve.pipeline import ground_plane, observe
from fgrecon.solve.proposals.adjust import PoseEstimate, adjust_pose
from fgrecon.solve.proposals.problem import Problem
from fgrecon.solve.result import history_of, results
from fgrecon.solve.threads import single_threaded
from fgrecon.solve.time.heading import Belief
from fgrecon.solve.time.turned import turned_alternative
from fgrecon.solve.vehicle.model import prepare

__all__ = ["reconstruct_scene"]

Array = NDArray[np.float64]

_OWN_HEIGHT, _OWN_SLOPE, _OWN_TILT = 0.35, 0.15, 0.5
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
    given = _known_boxes(boxes, box_errors, len(observations), known)
    vehicles = list(zip(observations, given, strict=True))
    started = perf_counter()
    tried = [_each_alone(vehicles, one, shape_prior, fleet, plane, options) for one in candidates(known)]
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
        tuple(each[n] for n in numbers),
        alone.refused,
        told.ground,
        told.ground_covariance,
        told.camera,
        told.focal_lengths,
        told.message,
        milliseconds,
    )


@dataclass(frozen=True)
class _Alone:
    """A vehicle that was solved alone."""

    problem: Problem
    start: PoseEstimate
    adjusted: Adjusted
    known: KnownBox | None = None
    belief: Belief | None = None

    @property
    def pose(self) -> Array:
        pose: Array = self.adjusted.optimum.state.poses[0].matrix()
        return pose

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
class _Tried:
    """All vehicles solved one by one with one camera."""

    camera: Camera
    vehicles: dict[int, _Alone]
    refused: dict[int, FgreconError]

    @property
    def solved(self) -> dict[int, _Alone]:
        return {number: one for number, one in self.vehicles.items() if one.adjusted.optimum.failure is None}


@dataclass(frozen=True)
class _Joint:
    """Vehicles that were solved together, from where they were alone."""

    alone: _Tried
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
    alone: _Tried


def _known_boxes(
    boxes: Sequence[Box3D | None] | None, errors: BoxErrors | None, count: int, camera: Camera
) -> list[KnownBox | None]:
    """What is known of each of so many vehicles.

    Raises:
        InvalidInputError: Another number of boxes is given, or they are of an unknown camera.
    """
    if boxes is None:
        return [None] * count
    if len(boxes) != count:
        raise InvalidInputError("boxes", f"{len(boxes)} for {count} vehicles", "Give a box, or None, for each.")
    if camera.focal_sigma:
        fix = "Give the focal length that the boxes were found with."
        raise InvalidInputError("boxes", "given without a known focal length", fix)
    off = BoxErrors() if errors is None else errors
    return [None if box is None else KnownBox(box, off) for box in boxes]


def _each_alone(
    vehicles: Sequence[tuple[Observation, KnownBox | None]],
    camera: Camera,
    prior: ShapePrior,
    fleet: SizePrior | None,
    plane: Ground | None,
    options: Options,
) -> _Tried:
    alone: dict[int, _Alone] = {}
    refused: dict[int, FgreconError] = {}
    for number, (given, known) in enumerate(vehicles):
        size = fleet if known is None or known.box.size is None else None
        model = prepare(prior, size, options.shape.basis_vectors)
        try:
            observation = observe(given, camera, model.prior, options)
            if known is not None:
                found = DetectedVehicle.solve(known.problem(observation, camera, model, plane, options), known)
                alone[number] = _Alone(found.problem, found.start, found.adjusted, known, found.belief)
                continue
            problem = Problem.of(observation, camera, model, plane, options)
            start = adjust_pose(problem)
        except FgreconError as error:
            refused[number] = error
            continue
        alone[number] = _Alone(problem, start, adjust([Seen(problem)], [start]))
    return _Tried(camera, alone, refused)


def _energies(tried: Sequence[_Tried], known: Camera) -> list[float]:
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


def _result(one: _Alone) -> Reconstruction:
    adjusted = replace(one.adjusted, alternatives=(one.alternatives(one.pose),))
    return results([Seen(one.problem)], [one.start], adjusted, {}, one.own(), facing=[one.facing(one.pose)])[0]


def _together(alone: _Tried, known: Camera, plane: Ground | None, options: Options) -> _Joint | None:
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
        others.insert(G(0), np.zeros(3))
        priors.append(gtsam.PriorFactorVector(G(0), np.zeros(3), diagonal_noise("ground", np.array(spread))))
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
    height = float(np.hypot(_OWN_HEIGHT * ground.height_sigma, _OWN_SLOPE * ground.slope_sigma * depth))
    tilt = _OWN_TILT * ground.tilt_sigma
    return RobustLoss.of(Loss.CAUCHY, _OUTLYING).wrap(diagonal_noise("contact", np.array([height, tilt, tilt, tilt])))


def _marginal(marginals: gtsam.Marginals | None, key: int) -> Array | None:
    if marginals is None:
        return None
    covariance: Array = marginals.marginalCovariance(key)
    return covariance if np.isfinite(covariance).all() else None
