"""All vehicles of an image together: each stands on the ground, and the ground is a variable; so may the camera be.

    +--- keypoints, box --- X(1,0) --- contact ---+
    F(0) keypoints, box --- X(2,0) --- contact --- G(0) --- prior (what is known of the mount)
    +--- keypoints, box --- X(3,0) --- contact ---+

Every vehicle is first solved by itself, nearly to the end (`fgrecon.solve.independent`); the ground is in
`fgrecon.solve.image_ground`.

Where the focal length is not known it is the variable F(0) of all keypoints and boxes (`fgrecon.solve.focal`), also of
several images that one camera took, each with a ground of its own. Vehicles of which another detector has a 3D box have
its factors as well (`fgrecon.solve.detected`).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from time import perf_counter

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from factors.keys import F, S, decode_key
from fgrecon.core.arrays import Array
from fgrecon.core.box3d import Box3D, BoxErrors
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.checks import as_list
from fgrecon.core.evidence import Evidence
from fgrecon.core.input_warnings import InputWarnings, warn_of
from fgrecon.core.observation import KeypointsLike
from fgrecon.core.options import Options
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.scene_reconstruction import SceneReconstruction
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizesLike
from fgrecon.solve.box_check import boxes_off, boxes_warning
from fgrecon.solve.contradiction import with_contradictions, with_mirrored_gain
from fgrecon.solve.detected import KnownBox
from fgrecon.solve.either_class import with_either_class
from fgrecon.solve.focal import candidates, distinct_lengths, energies_of, focal_prior, log_ratio, starts
from fgrecon.solve.graph.covariance import covariance_of, undetermined
from fgrecon.solve.graph.graph import Graph, GraphObservation, State
from fgrecon.solve.graph.multi_start import MultiStartResult, SolvedStage
from fgrecon.solve.graph.optimise import Optimum, optimise
from fgrecon.solve.graph.vehicle_part import fleet_prior, is_any_fleets
from fgrecon.solve.image_ground import ImageGround, observed_ground
from fgrecon.solve.independent import IndependentSolve, IndependentVehicle, solve_independently
from fgrecon.solve.inputs import SolveSetup, as_box_errors, as_boxes, as_extra_factors, check_frames, evidence_of
from fgrecon.solve.mutual_occlusion import with_occlusion
from fgrecon.solve.result import Marginalised, marginalise, pose_history, results
from fgrecon.solve.road_plane import ground_by_points
from fgrecon.solve.solve_settings import SCENE
from fgrecon.solve.threads import single_threaded
from fgrecon.solve.vehicle.model import prepare
from fgrecon.solve.weakness import unknown_focal, weakened

_OF_VEHICLE = "XLOPM"
_NOT_IN_IT = (
    "factors of yours (`extra_factors`) on it are left out: with them the graph has no minimum, or leaves it open"
)


@single_threaded
def reconstruct_scene(
    observations: Sequence[KeypointsLike],
    camera: Camera | ArrayLike,
    *,
    prior: ShapePrior | str | Path = "car14",
    ground: Ground | float | None = None,
    size_prior: SizesLike | None = None,
    options: Options | None = None,
    boxes: Sequence[Box3D | None] | None = None,
    box_errors: BoxErrors | None = None,
    evidence: Sequence[Evidence] = (),
    extra_factors: Sequence[gtsam.NonlinearFactor] = (),
) -> SceneReconstruction:
    """Recover pose and shape of all vehicles of an image, and the ground that they stand on.

    Args:
        observations: The keypoints of each vehicle, as `fgrecon.reconstruct` takes them.
        camera: The camera that took the image, or its matrix (3, 3), or (fx, fy, cx, cy). One whose focal length is not
            known (`Camera.focal_sigma`, `Camera.of_unknown`) is found with the vehicles.
        prior: Shape prior, or its name, or the path of its file.
        ground: About where the ground is; a number is the height in metres of a level camera. None gives nothing: the
            vehicles say where it is.
        size_prior: Fleet by name (`fgrecon.SIZE_PRIORS`), or a size prior; None takes sizes from the shape prior.
        options: Settings; `joint` must be set.
        boxes: What another detector says of each vehicle, None where it does not: factors on its pose, and a size in
            the place of `size_prior`.
        box_errors: How far these boxes are off; None for a monocular detector's.
        evidence: What other sensors say of all vehicles, such as `fgrecon.Points` of a scan; what they say of one alone
            is given with its `Observation`.
        extra_factors: The caller's own factors on the poses X(v, 0) and lambdas L(v), v the number of the observation,
            and the ground G(0); those on a vehicle that is refused are left out. Where they have no solution, what they
            are on is `weak` without them. See `fgrecon.reconstruct`.

    Returns:
        The scene. Vehicles that determine no pose are in `refused`. Where fewer than two were solved there is nothing
        to solve together but the focal length, and with a known one the results are those of `fgrecon.reconstruct`.

    Raises:
        InvalidInputError: An argument cannot be used, such as a distorted lens without a focal length; names it, its
            value and the fix.
    """
    setup, known = SolveSetup.of(prior, size_prior, options, ground, joint=True), Camera.of(camera)
    observations, errors = as_list("observations", observations), as_box_errors(box_errors)
    boxed: list[KnownBox | None] | None = None
    if boxes is not None:
        unsized = prepare(setup.prior, None, setup.options.shape.basis_vectors)
        each = as_boxes(boxes, len(observations), known, setup.prior)
        boxed = [None if box is None else KnownBox(box, errors, unsized) for box in each]
    sensed = evidence_of(evidence, known, of_all=True)
    check_frames(sensed, known, setup.ground, observations)
    setup = replace(
        setup, evidence=sensed, ground=ground_by_points(sensed, setup.ground, known, setup.options.disabled_terms)
    )
    return _reconstruct(_Images([observations], known, setup, as_extra_factors(extra_factors)), boxed)[0]


@single_threaded
def reconstruct_scenes(
    images: Sequence[Sequence[KeypointsLike]],
    camera: Camera | ArrayLike,
    *,
    prior: ShapePrior | str | Path = "car14",
    ground: Ground | float | None = None,
    size_prior: SizesLike | None = None,
    options: Options | None = None,
) -> list[SceneReconstruction]:
    """Recover the vehicles of several images that one camera took, whose focal length all of them tell together.

    Where it is known the images have nothing in common, and each is reconstructed as by `reconstruct_scene`.

    Args:
        images: The keypoints of each vehicle, of each image.
        camera: The camera of all images, as in `reconstruct_scene`.
        prior: Shape prior, or its name, or the path of its file.
        ground: About where the ground is, in each image anew; a number is the height in metres of a level camera.
        size_prior: Fleet by name (`fgrecon.SIZE_PRIORS`), or a size prior; None takes sizes from the shape prior.
        options: Settings; `joint` must be set.

    Returns:
        The scene of each image, all with the same camera.

    Raises:
        InvalidInputError: An argument cannot be used; names it, its value and the fix.
    """
    setup, known = SolveSetup.of(prior, size_prior, options, ground, joint=True), Camera.of(camera)
    images = [as_list(f"images[{number}]", one) for number, one in enumerate(as_list("images", images))]
    if not known.focal_sigma:
        return [_reconstruct(_Images([one], known, setup))[0] for one in images]
    return _reconstruct(_Images(images, known, setup))


@dataclass(frozen=True)
class _Images:
    """Images of one camera, whose vehicles, numbered through, are solved together; `camera` is what is known of it.

    `extra` are factors of the caller's own.
    """

    vehicles: Sequence[Sequence[KeypointsLike]]
    camera: Camera
    setup: SolveSetup
    extra: Sequence[gtsam.NonlinearFactor] = ()

    @property
    def numbers(self) -> set[int]:
        """The numbers of all vehicles."""
        return set(range(len(self.image_of)))

    @property
    def image_of(self) -> list[int]:
        """The image of each vehicle, by its number."""
        return [image for image, some in enumerate(self.vehicles) for _ in some]

    def extra_without(self, left_out: Collection[int]) -> list[gtsam.NonlinearFactor]:
        """The caller's factors but those on some vehicles."""
        return [factor for factor in self.extra if _vehicles_of(factor).isdisjoint(left_out)]


def _vehicles_of(factor: gtsam.NonlinearFactor) -> set[int]:
    """The numbers of the vehicles that a factor is on."""
    return {key.vehicle for key in map(decode_key, factor.keys()) if key.letter in _OF_VEHICLE}


@dataclass(frozen=True)
class _JointSolve:
    """Vehicles that were solved together, from where they were independently."""

    independent: IndependentSolve
    parts: list[GraphObservation]
    graph: Graph
    optimum: Optimum
    extra: list[gtsam.NonlinearFactor]
    standing: dict[int, ImageGround]

    @property
    def camera(self) -> Camera:
        """The camera with its focal length, where that is a variable."""
        return self.independent.camera.scaled(math.exp(self.optimum.values.atVector(F(0))[0]))


@dataclass(frozen=True)
class _Estimate:
    """What is known of the scenes: their grounds by image; vehicles without a result are as they were independently."""

    independent: IndependentSolve
    camera: Camera
    results: dict[int, Reconstruction] = field(default_factory=dict)
    grounds: dict[int, tuple[Ground, Array | None]] = field(default_factory=dict)
    focal_lengths: tuple[tuple[float, float], ...] = ()
    shared: tuple[str, ...] = ()
    determined: bool = True

    def message(self, image: int, count: int, images: int) -> str:
        """What was done with so many vehicles of one of so many images."""
        shared = [*(["the ground"] if image in self.grounds else []), *self.shared]
        if not count or not shared:
            return "They were solved one by one."
        others = f", as were {len(self.results) - count} of other images" if images > 1 else ""
        return f"{count} {'was' if count == 1 else 'were'} solved together with {' and '.join(shared)}{others}."


def _reconstruct(images: _Images, boxes: Sequence[KnownBox | None] | None = None) -> list[SceneReconstruction]:
    """The scenes of images."""
    known, setup, image_of = images.camera, images.setup, images.image_of
    observations = [one for some in images.vehicles for one in some]
    started = perf_counter()
    steady = SCENE.single_visibility_step if len(observations) > 1 or known.focal_sigma else None
    tried = [
        solve_independently(observations, one, setup, boxes, image_of=image_of, steady=steady)
        for one in candidates(known)
    ]
    energies = energies_of(tried, known)
    begun = perf_counter()
    scene = _solved([tried[i] for i in starts(energies)], images)
    if scene is None:
        best = min(range(len(tried)), key=lambda i: (energies[i], abs(log_ratio(tried[i].camera, known))))
        scene = _Estimate(tried[best], known)
    vehicles = scene.independent.vehicles
    each = scene.results | {n: _result(one.converged()) for n, one in vehicles.items() if n not in scene.results}
    for number, one in each.items():
        if (vehicle := vehicles[number]).box is None:
            each[number] = with_either_class(one, vehicle.problem, setup, vehicle.adjusted.optimum)
    each = {n: with_mirrored_gain(one, vehicles[n].problem) for n, one in each.items()}
    each = _weakened_where_left_out(each, images, scene)
    margin = setup.options.ambiguity_margin
    status, warnings = unknown_focal(scene.camera.focal_sigma, scene.focal_lengths, margin)
    each = {number: weakened(one, warnings, status) for number, one in each.items()}
    each = _weakened_where_two_are(each, image_of)
    input_warnings = InputWarnings.of({f"vehicle {n}": warning for n, warning in scene.independent.warnings.items()})
    for number, one in each.items():
        input_warnings.add_result(f"vehicle {number}", vehicles[number].problem.observation, one)
    warn_of(input_warnings, stacklevel=4)
    milliseconds = {"alone": (begun - started) * 1e3, "together": (perf_counter() - begun) * 1e3}
    return [_scene_of_image(image, images, scene, each, milliseconds) for image in range(len(images.vehicles))]


def _weakened_where_left_out(
    each: dict[int, Reconstruction], images: _Images, scene: _Estimate
) -> dict[int, Reconstruction]:
    """The results, weak where factors of the caller's on solved vehicles could not be used."""
    alone = scene.independent.solved.keys() - scene.results.keys()
    usable = images.extra_without(images.numbers - scene.independent.solved.keys())
    about = [_vehicles_of(factor) for factor in usable]
    missing = set[int]().union(*(some for some in about if not some.isdisjoint(alone)))
    return {n: weakened(one, (_NOT_IN_IT,)) if n in missing else one for n, one in each.items()}


def _weakened_where_two_are(each: dict[int, Reconstruction], image_of: list[int]) -> dict[int, Reconstruction]:
    """The results, weak where two of an image are in one place: one vehicle that was given twice, or a wrong pose."""
    reasons = dict[int, str]()
    near = {number: SCENE.same_place_widths * float(one.box_size[1]) for number, one in each.items()}
    places = {number: one.location.tolist() for number, one in each.items()}
    for one, other in combinations(each, 2):
        if image_of[one] == image_of[other] and math.dist(places[one], places[other]) < min(near[one], near[other]):
            first = image_of.index(image_of[one])
            for number, there in ((one, other), (other, one)):
                reasons.setdefault(number, f"vehicle {there - first} is in its place: is one given twice?")
    return {n: weakened(result, (reasons[n],) if n in reasons else ()) for n, result in each.items()}


def _scene_of_image(
    image: int,
    images: _Images,
    scene: _Estimate,
    each: dict[int, Reconstruction],
    milliseconds: dict[str, float],
) -> SceneReconstruction:
    first = sum(map(len, images.vehicles[:image]))
    own = range(first, first + len(images.vehicles[image]))
    numbers = [number for number in own if number in each]
    refused = scene.independent.refused
    ground, covariance = scene.grounds.get(image, (images.setup.ground, None))
    message = scene.message(image, sum(number in scene.results for number in own), len(images.vehicles))
    off = boxes_off(each[n].diagnostics.box_excess for n in numbers)
    return SceneReconstruction(
        tuple(number - first for number in numbers),
        with_occlusion([each[n] for n in numbers]),
        {number - first: refused[number] for number in own if number in refused},
        ground,
        covariance,
        scene.camera,
        scene.focal_lengths,
        message if off is None else f"{message} {boxes_warning(off)}",
        milliseconds,
    )


def _result(one: IndependentVehicle) -> Reconstruction:
    adjusted = replace(one.adjusted, alternatives=(one.alternatives(one.pose),))
    facing = one.facing(one.pose)
    found = results([GraphObservation(one.problem)], [one.start], adjusted, {}, one.box_factors(), facing=[facing])
    return with_contradictions(found, adjusted.ended)[0]


def _solved(begun: Sequence[IndependentSolve], images: _Images) -> _Estimate | None:
    """The best end of the joint solves; None where there is none.

    A vehicle that the graph leaves open leaves all others without a covariance, so it is taken out.
    """
    out: set[int] = set()
    while True:
        ends = (_solve_jointly(one, images, out) for one in begun)
        joint = [one for one in ends if one is not None]
        if not joint:
            return None
        best = min(joint, key=lambda one: one.optimum.energy)
        scene = _contradicted(_estimate(best, joint, images.camera), best, images, out)
        if scene.determined:
            return scene
        left_open = undetermined(best.graph, best.optimum.values, best.optimum.state.weights)
        if not left_open or len(left_open) == len(best.parts):
            return scene
        out |= left_open


def _contradicted(scene: _Estimate, best: _JointSolve, images: _Images, out: Collection[int]) -> _Estimate:
    """The estimate, its vehicles weak where factors of the caller's own, or ranges, contradict the image."""
    alone = _solve_jointly(best.independent, images, out, own=False) if images.extra else None
    without = None if alone is None else (alone.graph, alone.optimum)
    found = with_contradictions([*scene.results.values()], (best.graph, best.optimum), without)
    return replace(scene, results=dict(zip(scene.results, found, strict=True)))


def _solve_jointly(
    independent: IndependentSolve, images: _Images, out: Collection[int], *, own: bool = True
) -> _JointSolve | None:
    """The joint solve without some vehicles; None where there is nothing to solve together, or it gave up.

    `own` says whether with the caller's factors.
    """
    known, options = images.camera, images.setup.options
    solved = {number: one for number, one in independent.solved.items() if number not in out}
    standing = _standing(solved, images)
    if not solved or not (standing or known.focal_sigma or images.extra):
        return None
    priors: list[gtsam.NonlinearFactor] = []
    others = gtsam.Values()
    for one_ground in standing.values():
        others.insert(one_ground.key, np.zeros(3))
        priors.append(one_ground.prior)
    if known.focal_sigma:
        others.insert(F(0), np.zeros(1))
        priors.append(focal_prior(known, independent.camera))
    models = [one.problem.model for one in solved.values() if is_any_fleets(one.problem.model, options)]
    if models and models[0].prior.dimension:
        others.insert(S(), np.zeros(3))
        priors.append(fleet_prior(models[0]))
    parts: list[GraphObservation] = []
    for number, one in solved.items():
        priors += one.box_factors(number)
        problem = one.problem.on(None) if images.image_of[number] in standing else one.problem
        parts.append(GraphObservation(problem, vehicle=number))
    states = [one.adjusted.optimum.state for one in solved.values()]
    state = State(
        poses=[state.poses[0] for state in states],
        shapes={number: state.shapes[0] for number, state in zip(solved, states, strict=True)},
        weights=[state.weights[0] for state in states],
        others=others,
    )
    extra = [*(contact for one in standing.values() for contact in one.contacts.values()), *priors]
    extra += images.extra_without(images.numbers - solved.keys()) if own else []
    graph = Graph(parts, state, pose_free=True, extra=extra)
    optimum = optimise(graph, state, steady=SCENE.joint_visibility_step)
    if optimum.failure is not None:
        return None
    return _JointSolve(independent, parts, graph, optimum, extra, standing)


def _standing(solved: dict[int, IndependentVehicle], images: _Images) -> dict[int, ImageGround]:
    """The ground of each image that has one, with its vehicles; not of one vehicle alone."""
    found: dict[int, ImageGround] = {}
    given, image_of = images.setup.ground, images.image_of
    if "ground" in images.setup.options.disabled_terms:
        return found
    for image in sorted({image_of[number] for number in solved}):
        poses = {number: one.pose for number, one in solved.items() if image_of[number] == image}
        nominal = observed_ground([*poses.values()]) if given is None else given
        if len(poses) > 1 and nominal is not None:
            found[image] = ImageGround.of(image, poses, nominal, given=given is not None)
    return found


def _estimate(best: _JointSolve, joint: Sequence[_JointSolve], known: Camera) -> _Estimate:
    """Results of the vehicles, the ground and the camera, with what is left open of both."""
    optimum, values = best.optimum, best.optimum.values
    marginalised = marginalise(best.graph, optimum)
    each = _vehicles(best, marginalised)
    marginals, camera = marginalised.marginals, best.independent.camera
    shared: tuple[str, ...] = ()
    lengths: tuple[tuple[float, float], ...] = ()
    grounds = {
        image: (ground, covariance_of(marginals, one_ground.key))
        for image, one_ground in best.standing.items()
        if (ground := one_ground.ground(values)) is not None
    }
    if known.focal_sigma:
        variance = covariance_of(marginals, F(0))
        sigma = known.focal_sigma if variance is None else float(np.sqrt(variance[0, 0]))
        camera = replace(best.camera, focal_sigma=min(sigma, known.focal_sigma))
        lengths = tuple(
            (float(one.camera.matrix[0, 0]), one.optimum.energy - optimum.energy)
            for one in sorted(joint, key=lambda one: one.optimum.energy)
        )
        shared = ("the focal length",)
    determined = marginals is not None and all(one.uncertainty.pose_covariance is not None for one in each.values())
    return _Estimate(best.independent, camera, each, grounds, distinct_lengths(lengths), shared, determined)


def _vehicles(best: _JointSolve, marginalised: Marginalised) -> dict[int, Reconstruction]:
    """The result of each vehicle of a joint solve, by number."""
    optimum, values = best.optimum, best.optimum.values
    solved = {one.vehicle: best.independent.vehicles[one.vehicle] for one in best.parts}
    poses = [pose.matrix() for pose in optimum.state.poses]
    alternatives = tuple(one.alternatives(pose) for one, pose in zip(solved.values(), poses, strict=True))
    adjusted = MultiStartResult(optimum, (SolvedStage("scene", best.graph, optimum.steps),), alternatives)
    begun = [one.start for one in solved.values()]
    if best.graph.options.keep_history:  # what led to each vehicle's pose independently; the scene's steps follow
        begun = [replace(one.start, history=pose_history(one.start, one.adjusted)) for one in solved.values()]
    facing = [one.facing(pose) for one, pose in zip(solved.values(), poses, strict=True)]
    found = results(best.parts, begun, adjusted, {}, best.extra, facing=facing, marginalised=marginalised)
    each = dict(zip(solved, found, strict=True))
    for one_ground in best.standing.values():
        for number in one_ground.contacts:
            off = one_ground.off_ground(each[number], solved[number].problem.ground, values)
            each[number] = weakened(each[number], off)
    return each
