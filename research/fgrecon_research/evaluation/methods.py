"""Registry of all methods that the tables compare, by name.

A method is bound once to what is known about the scene (shape prior, ground plane, fleet size) and then maps an
observation and a camera to a pose. The part of a name after `+` says what the method is given: `+size` the mean size of
the fleet, `+ground` the ground plane; a method without them is not shown these values. A robust strategy may follow
after a colon (`fgrecon+ground+size:paper`): see `fgrecon.core.robust`; `none` keeps the first weights (Eq. 4).

The baselines fit the prior's mean shape, scaled per axis to the fleet's mean size where they are given it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
import poselib
from numpy.typing import NDArray

from fgrecon.calibration.labelled_frames import SceneKnowledge
from fgrecon.core.camera import Camera
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.evidence import VehicleClass
from fgrecon.core.geometry import rigid
from fgrecon.core.input_warnings import summed_up
from fgrecon.core.observation import Observation
from fgrecon.core.options import BoxModel, Options
from fgrecon.core.reconstruction import Reconstruction, Status
from fgrecon.core.robust import RobustStrategy, StrategyName, strategy
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.solve.pipeline import reconstruct
from fgrecon.solve.proposals.aspnp import aspnp
from fgrecon.solve.vehicle.conditioning import of_fleet
from fgrecon.solve.vehicle.model import prepare

CONFIDENT = 0.3
"""Confidence above which `sqpnp_confident` uses a point."""

RANSAC_TOLERANCE = 0.12
"""Inlier threshold of the RANSAC baseline relative to the longer side of the box: on real network keypoints the best of
0.05 to 0.2, so that the baseline is not handicapped (0.1, the tolerance of the APK, costs it two flips in 76)."""

NO_UPDATES = "none"
"""Name of the strategy that keeps the paper's first weights (Eq. 4): no IRLS."""

_OURS = "fgrecon"
_MINIMUM = 4  # fewer points leave several poses


@dataclass(frozen=True)
class Estimate:
    """What a method found."""

    camera_T_object: NDArray[np.float64]  # (4, 4) pose, maps object coordinates into the camera frame
    milliseconds: Mapping[str, float]  # wall time by stage, `pose` and, where the method has that stage, `shape`


Solver = Callable[[Observation, Camera], Estimate]
"""A bound method. It refuses by raising; whoever scores it counts that as a failure."""


@dataclass(frozen=True)
class Method:
    """A named method."""

    name: str  # key in the registry and in every table
    summary: str  # what it does, in a few words
    # makes the solver for a scene; slow imports happen here, outside the time that is measured
    bind: Callable[[SceneKnowledge], Solver]
    prior_name: Callable[[SceneKnowledge], str]  # which shapes it fits, for the tables
    # for recordings: solves as the solver does, but keeps the history and gives the whole result; None for a baseline,
    # which has a pose alone
    reconstruct: Callable[[SceneKnowledge, Observation, Camera], Reconstruction] | None = None


def select(names: Iterable[str] | None = None) -> tuple[Method, ...]:
    """The methods of the given names in this order without repetitions, or all of them.

    Raises:
        InvalidInputError: There is no method, or no robust strategy, of a name.
    """
    chosen: dict[str, Method] = {}
    for name in METHODS if names is None else names:
        method, _, robust = name.partition(":")
        if method not in METHODS or (robust and not method.startswith(_OURS)):
            fix = f"Use one of {', '.join(METHODS)}; after {_OURS}... also a robust strategy, as in {_OURS}:paper."
            raise InvalidInputError("method", name, fix)
        chosen[name] = METHODS[method]
        if robust:
            known = method.split("+")
            chosen[name] = _fgrecon(name, ground="ground" in known, size="size" in known, robust=named_strategy(robust))
    return tuple(chosen.values())


def named_strategy(name: str) -> RobustStrategy:
    """A robust strategy by its name, or `NO_UPDATES`.

    Raises:
        InvalidInputError: There is none of that name.
    """
    return RobustStrategy(name=StrategyName.PAPER, updates=0) if name == NO_UPDATES else strategy(name)


Shape = NDArray[np.float64]
PnP = Callable[[Shape, Observation, Camera], NDArray[np.float64]]
"""Object points (K, 3), undistorted observation, camera -> camera_T_object (4, 4)."""


def _use_all(observation: Observation) -> NDArray[np.intp]:
    return np.flatnonzero(observation.measured)


def _use_confident(observation: Observation) -> NDArray[np.intp]:
    """Points above `CONFIDENT`, or the four most confident ones where there are fewer."""
    confident = np.flatnonzero(observation.confidence > CONFIDENT)
    if len(confident) >= _MINIMUM:
        return confident
    measured = np.flatnonzero(observation.measured)
    best: NDArray[np.intp] = measured[np.argsort(-observation.confidence[measured], kind="stable")[:_MINIMUM]]
    return np.sort(best)


def _opencv(flag: str, points: Callable[[Observation], NDArray[np.intp]]) -> Callable[[], PnP]:
    def load() -> PnP:
        def solve(shape: Shape, observation: Observation, camera: Camera) -> NDArray[np.float64]:
            used = _enough(points(observation))
            found, rotation, translation = cv2.solvePnP(
                shape[used], observation.keypoints[used], camera.matrix, None, flags=getattr(cv2, flag)
            )
            if not found:
                raise FgreconError(f"OpenCV found no pose from {len(used)} points.")
            return rigid(cv2.Rodrigues(rotation)[0], np.ravel(translation))

        return solve

    return load


load_sqpnp = _opencv("SOLVEPNP_SQPNP", _use_all)
"""Makes OpenCV's SQPnP on all points."""


def _poselib() -> PnP:
    def solve(shape: Shape, observation: Observation, camera: Camera) -> NDArray[np.float64]:
        used = _enough(_use_all(observation))
        # normalised by K, so that a skewed camera is no special case; PoseLib takes thresholds in pixels of its camera
        focal = float(np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]))
        pinhole = {"model": "SIMPLE_PINHOLE", "width": 0, "height": 0, "params": [focal, 0.0, 0.0]}
        pixels = focal * camera.rays(observation.keypoints[used])[:, :2]
        options = {"max_reproj_error": RANSAC_TOLERANCE * observation.extent, "seed": 0}
        pose, info = poselib.estimate_absolute_pose(pixels, shape[used], pinhole, options, {})
        if not info["num_inliers"]:
            raise FgreconError(f"PoseLib found no pose from {len(used)} points.")
        return rigid(pose.R, np.ravel(pose.t))

    return solve


def _aspnp() -> PnP:
    def solve(shape: Shape, observation: Observation, camera: Camera) -> NDArray[np.float64]:
        used = _enough(_use_all(observation))
        return aspnp(shape[used], camera.rays(observation.keypoints[used])[:, :2])[0].camera_T_object

    return solve


def _enough(points: NDArray[np.intp]) -> NDArray[np.intp]:
    if len(points) < _MINIMUM:
        raise InvalidInputError("keypoints", f"{len(points)} measured", f"Give at least {_MINIMUM}.")
    return points


def _baseline(name: str, summary: str, load: Callable[[], PnP], *, size: bool) -> Method:
    def prior(scene: SceneKnowledge) -> ShapePrior:
        return of_fleet(scene.prior, scene.size) if size else scene.prior

    def bind(scene: SceneKnowledge) -> Solver:
        shape, pnp = np.ascontiguousarray(prior(scene).mean), load()

        def solve(observation: Observation, camera: Camera) -> Estimate:
            start = time.perf_counter()
            if camera.distortion is not None:
                observation = replace(observation, keypoints=camera.undistort(observation.keypoints))
                camera = camera.with_distortion(None)
            camera_T_object = pnp(shape, observation, camera)
            return Estimate(camera_T_object, {"pose": 1e3 * (time.perf_counter() - start)})

        return solve

    full_name = f"{name}+size" if size else name
    return Method(full_name, summary, bind, lambda scene: f"mean shape of {prior(scene).name}")


def _fgrecon(name: str, *, ground: bool, size: bool, robust: RobustStrategy | None = None) -> Method:
    @summed_up()  # what an evaluation solves is measured, not warned of
    def result_of(
        scene: SceneKnowledge, observation: Observation, camera: Camera, *, keep_history: bool
    ) -> Reconstruction:
        # KITTI's 2D boxes are its 3D boxes projected, to within 1 % of their size.
        strategy = robust or RobustStrategy()
        return reconstruct(
            observation,
            camera,
            prior=scene.prior,
            ground=scene.ground if ground else None,
            size_prior=scene.size if size else None,
            options=Options(strategy=strategy, box=BoxModel.CUBOID, keep_history=keep_history),
            evidence=[VehicleClass("car")] if size else (),  # as rivals are given the size of cars
        )

    def bind(scene: SceneKnowledge) -> Solver:
        def solve(observation: Observation, camera: Camera) -> Estimate:
            result = result_of(scene, observation, camera, keep_history=False)
            if result.status is Status.FAILED:
                raise FgreconError(result.message)
            return Estimate(result.camera_T_object, result.diagnostics.milliseconds)

        return solve

    def prior_name(scene: SceneKnowledge) -> str:
        return prepare(scene.prior, scene.size if size else None).prior.name

    summary = "pose and shape by factor-graph optimisation"
    return Method(name, summary, bind, prior_name, partial(result_of, keep_history=True))


_BASELINES: tuple[tuple[str, str, Callable[[], PnP]], ...] = (
    ("epnp", "OpenCV EPnP on all points", _opencv("SOLVEPNP_EPNP", _use_all)),
    ("sqpnp", "OpenCV SQPnP on all points", load_sqpnp),
    (
        "sqpnp_confident",
        f"OpenCV SQPnP, confidence > {CONFIDENT}",
        _opencv("SOLVEPNP_SQPNP", _use_confident),
    ),
    ("poselib_ransac", "PoseLib LO-RANSAC on all points", _poselib),
    ("aspnp", "ASPnP on all points, without IRLS", _aspnp),
)

METHODS: Mapping[str, Method] = {
    method.name: method
    for method in (
        *(_baseline(*baseline, size=False) for baseline in _BASELINES),
        *(_baseline(*baseline, size=True) for baseline in _BASELINES),
        _fgrecon("fgrecon", ground=False, size=False),
        _fgrecon("fgrecon+size", ground=False, size=True),
        _fgrecon("fgrecon+ground+size", ground=True, size=True),
    )
}
"""Every method by its name, in the order of the tables."""
