"""Marginal covariances of the joint graph at its minimum."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.keys import decode_key
from factors.system import CompiledSystem, ordering_of
from fgrecon.core.arrays import Array
from fgrecon.core.errors import FactorCallbackError
from fgrecon.solve.graph.graph import Graph
from fgrecon.solve.graph.graph_settings import SETTINGS
from fgrecon.solve.graph.observation_part import ObservationPart, Weights

_UP = 4  # of a pose's local coordinates: along the vehicle's own vertical axis

_SMALL = 128
"""Numbers of variables up to which, without the kernels, all covariances at once are quicker than by GTSAM."""


@dataclass(frozen=True)
class Covariances:
    """Covariances of the result."""

    # (6, 6), GTSAM's local coordinates: rotation in radians, translation in metres, in the object's own frame
    pose: Array
    coefficients: Array  # (N, N)
    keypoints: Array  # (K, 3, 3) of each 3D keypoint in the object frame, square metres
    size: Array  # (3, 3) of the box's length, width and height, square metres

    def with_unseen_underside(self, sigma: float) -> Covariances:
        """The same where measured points leave by so much (metres) how high the vehicle stands."""
        pose = self.pose.copy()
        pose[_UP, _UP] += sigma**2
        return replace(self, pose=pose)


@dataclass(frozen=True)
class Spread:
    """Covariances of variables of a graph at its minimum.

    A solve takes sizes for surer than they are (`VehiclePart.size_error`). How far off that makes it is in them, but
    for what the sizes of others do where vehicles share the ground or the focal length.
    """

    solved: Callable[[Sequence[int]], Array]  # joint covariance by keys, if sizes were as sure as the solve takes them
    # of each vehicle by its number: the key of lambda, and how much more that moves the minimum
    sizes: Mapping[int, tuple[int, Array]] = field(default_factory=dict)

    @classmethod
    def by_gtsam(cls, marginals: gtsam.Marginals, sizes: Mapping[int, tuple[int, Array]] | None = None) -> Spread:
        """From GTSAM's marginals."""

        def joint(keys: Sequence[int]) -> Array:
            distinct = list(dict.fromkeys(keys))
            if len(distinct) == 1:
                return np.tile(marginals.marginalCovariance(distinct[0]), (len(keys), len(keys)))
            found = marginals.jointMarginalCovariance(gtsam.KeyVector(distinct))
            return np.concatenate([np.concatenate([found.at(a, b) for b in keys], axis=1) for a in keys])

        return cls(joint, {} if sizes is None else sizes)

    def joint(self, keys: Sequence[int]) -> Array:
        """Of several variables, in the order of their keys."""
        if not keys:
            return np.zeros((0, 0))
        numbers = {_vehicle(key) for key in keys}
        sizes = [one for number, one in self.sizes.items() if None in numbers or number in numbers]
        joint: Array | None = None
        added: Array | float = 0.0
        for key, error in sizes:
            try:
                whole = self.solved([*keys, key])
            except KeyError:  # nothing is about both
                continue
            joint, by_size = whole[: -len(error), : -len(error)], whole[: -len(error), -len(error) :]
            added = added + by_size @ error @ by_size.T
        return self.solved(keys) if joint is None else joint + added


def _covariance(information: Array, least: float) -> Callable[[NDArray[np.intp]], Array] | None:
    """As `factors.system.CompiledSystem.covariance`, from the information (D, D)."""
    diagonal = information.diagonal()
    if not (np.isfinite(diagonal).all() and diagonal.min(initial=np.inf) > 0.0):
        return None
    scale = np.sqrt(diagonal)
    try:
        root = np.linalg.cholesky(information / np.outer(scale, scale))
    except np.linalg.LinAlgError:
        return None
    if not root.diagonal().min(initial=1.0) ** 2 > least:
        return None
    half = np.linalg.inv(root) / scale
    covariance: Array = half.T @ half
    return lambda indices: covariance[indices[:, None], indices]


def marginals_of(
    graph: Graph,
    values: gtsam.Values,
    weights: Sequence[Weights],
    selected: Collection[int] | None = None,
    *,
    as_assumed: bool = False,
    silent: str | None = None,
) -> Spread | None:
    """What is known of a graph's variables at its minimum; None where it does not determine them.

    Args:
        values: Its minimum.
        weights: Weights of each observation there.
        selected: Keys of the variables that are needed; None for all.
        as_assumed: Whether sizes are as sure as the solve takes them.
        silent: Name of what other sensors say that counts for nothing.
    """
    system, least = graph.weighted(values, weights, silent=silent), SETTINGS.undetermined_share
    sizes = {} if as_assumed else _size_errors(graph)
    if isinstance(system, CompiledSystem):
        found = system.covariance(system.point(values), least, selected)
    elif selected is not None or system.size <= _SMALL:
        found = _covariance(system.information(values), least)
    else:
        try:
            return Spread.by_gtsam(gtsam.Marginals(system.linear(values)[0], values), sizes)
        except RuntimeError:  # GTSAM's only sign of an indeterminate system
            return None
    if found is None:
        return None
    of, places = found, system.places
    return Spread(lambda keys: of(np.concatenate([_indices(places[key]) for key in keys])), sizes)


def _size_errors(graph: Graph) -> dict[int, tuple[int, Array]]:
    found = {}
    for number, vehicle in graph.vehicles.items():
        key, error = vehicle.shape.coefficients_key, vehicle.size_error
        if key is not None and error is not None:
            found[number] = key, error
    return found


def _indices(place: slice) -> NDArray[np.intp]:
    return np.arange(place.start, place.stop)


def covariance_of(marginals: Spread | None, key: int) -> Array | None:
    """The covariance of a variable; None where there are no marginals, or it is not finite or cannot be had."""
    if marginals is None:
        return None
    try:
        covariance = marginals.joint([key])
    except FactorCallbackError:
        raise
    except (RuntimeError, np.linalg.LinAlgError):  # as in `read_covariances`: others may be determined, this one is not
        return None
    return covariance if np.isfinite(covariance).all() else None


def undetermined(graph: Graph, values: gtsam.Values, weights: Sequence[Weights]) -> set[int]:
    """Numbers of the vehicles that are left open by all that is known of them, and so leave the graph undetermined.

    Args:
        graph: The graph; every variable that belongs to no vehicle, such as the ground, has a prior.
        values: Its minimum.
        weights: Weights of each observation there.
    """
    built = graph.build(weights, for_covariances=True)
    factors = {number: gtsam.NonlinearFactorGraph() for number in graph.vehicles}
    for factor in map(built.at, range(built.size())):
        for number in set(map(_vehicle, factor.keys())):
            if number is not None:
                factors[number].add(factor)
    dims = values.zeroVectors()
    undetermined_vehicles = set()
    for number, own in factors.items():
        keys = sorted(own.keyVector(), key=lambda key: _vehicle(key) != number)  # the vehicle's own first
        count = sum(len(dims.at(key)) for key in keys if _vehicle(key) == number)
        information = np.linalg.eigvalsh(own.linearize(values).hessian(ordering_of(keys))[0][:count, :count])
        if information[0] <= SETTINGS.undetermined_share * information[-1]:
            undetermined_vehicles.add(number)
    return undetermined_vehicles


def _vehicle(key: int) -> int | None:
    """The vehicle of a variable; None of the ground, the focal length, depth maps and the fleet."""
    letter, vehicle, _ = decode_key(key)
    return None if letter in "DGFS" else vehicle


def read_covariances(
    part: ObservationPart,
    weights: Weights,
    values: gtsam.Values,
    marginals: Spread | None,
    shapes: dict[int, Array] | None = None,
) -> Covariances | None:
    """What the marginals say of an observation; None where they are not there, not finite, or cannot be had.

    Where an image counts for the shape by a share alone, since others err alike, the marginals spread its pose too
    widely: given the shape, the pose is as sure as all that the image says.

    Args:
        part: The observation's part of the graph, with the pose as a variable.
        values: The graph's minimum.
        marginals: Its marginals there.
        shapes: Covariances of the vehicles' shapes so far, by number: a vehicle is in many images.
    """
    if marginals is None:
        return None
    assert part.pose_key is not None
    shape, number = part.vehicle.shape, part.vehicle.number
    shapes = {} if shapes is None else shapes
    try:
        if number not in shapes:
            shapes[number] = marginals.joint(list(shape.keys))
        variables = shapes[number]
        if part.share < 1.0:
            pose = _given_shape(part, weights, values, marginals.joint([part.pose_key, *shape.keys]))
        else:
            pose = marginals.joint([part.pose_key])
    except FactorCallbackError:
        raise
    except (RuntimeError, np.linalg.LinAlgError):  # the only signs of an indeterminate system
        return None
    keypoints = shape.derivative @ variables @ shape.derivative.transpose(0, 2, 1)
    if not (np.isfinite(pose).all() and np.isfinite(keypoints).all()):
        return None
    by_variables = part.vehicle.size_derivative
    count = shape.dims[0] if shape.coefficients_key is not None else 0
    lambdas = variables[:count, :count].copy()  # not a view: results outlive the rest
    return Covariances(pose, lambdas, keypoints, by_variables @ variables @ by_variables.T)


def projected_covariances(part: ObservationPart, values: gtsam.Values, marginals: Spread) -> Array | None:
    """(K, 2, 2) covariances of an observation's projected keypoints, pose and shape together, square pixels.

    What pose and shape are unsure of is not independent: an image that leaves open which of them moves a keypoint may
    well determine where it is in the image.

    Args:
        part: The observation's part of the graph, with the pose as a variable.
        values: The graph's minimum.
        marginals: Its marginals there.

    Returns:
        The covariances; None where they are not finite or cannot be had.
    """
    try:
        joint = marginals.joint(list(part.keys))
    except FactorCallbackError:
        raise
    except RuntimeError:  # GTSAM's only sign of an indeterminate system
        return None
    jacobian = part.kernel.evaluate(values, jacobian=True).jacobian
    assert jacobian is not None
    covariances: Array = jacobian @ joint @ jacobian.transpose(0, 2, 1)
    return covariances if np.isfinite(covariances).all() else None


def _given_shape(part: ObservationPart, weights: Weights, values: gtsam.Values, joint: Array) -> Array:
    """(6, 6) covariance of a pose by all that its image says, for the joint one of pose and shape in the graph.

    What the graph leaves out of the image is added to the pose's information and to its dependence on the shape;
    factors of the caller's own, and through them other poses, are in the joint covariance.
    """
    jacobian = part.jacobian(values, weights)
    left_out = (1.0 - part.share) / part.share * (jacobian.T @ jacobian)
    shape = joint[6:, 6:]
    by_shape = np.linalg.solve(shape, joint[6:, :6]).T
    information = np.linalg.inv(joint[:6, :6] - by_shape @ joint[6:, :6])
    alone = np.linalg.inv(information + left_out[:6, :6])
    by_shape = alone @ (information @ by_shape - left_out[:6, 6:])
    return alone + by_shape @ shape @ by_shape.T
