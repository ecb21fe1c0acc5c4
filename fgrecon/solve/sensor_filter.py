"""Constant error of a sensor over time: the shared error of its depth maps, such as a stereo rig's disparity offset.

    prior --- b(sensor) --- vehicle, by its size
                  +-------- vehicle, by its size
                  +-------- ...

How large a vehicle looks says how far it is, as surely as its size is known, and the map's pixels on it say the same
but for b. One vehicle hardly tells it, and all of its frames no more, for its size stays what it is: each is one factor
on b, by the frame that says most. Vehicles of another kind than they are taken for are outliers. The ground has no part
in it: where no other sensor says where it is, it was found by the same maps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fgrecon.core.depth_map import DepthMap
from fgrecon.core.errors import DegenerateProblemError
from fgrecon.core.evidence import Evidence
from fgrecon.solve.graph.covariance import marginals_of
from fgrecon.solve.graph.graph import Graph, GraphObservation, State
from fgrecon.solve.graph.optimise import optimise
from fgrecon.solve.graph.vehicle_part import ShapeValues
from fgrecon.solve.proposals.scaled_depth import ScaledDepth
from fgrecon.solve.result import common_weights
from fgrecon.solve.solve_settings import SENSOR_FILTER
from fgrecon.solve.time.frame import Frame


@dataclass(frozen=True)
class ErrorEstimate:
    """A sensor's shared error by one vehicle, inverse metres, and the time of it, seconds."""

    mean: float
    variance: float
    time: float


@dataclass(frozen=True)
class SharedError:
    """What is known of an error that all pixels of a sensor's maps have in common, inverse metres."""

    mean: float  # before any vehicle
    sigma: float  # standard deviation before any vehicle
    vehicles: Mapping[int, ErrorEstimate] = field(default_factory=dict)  # by their ids, the last one last

    def at(self, time: float) -> tuple[float, float]:
        """Mean and standard deviation at a time: the minimum of the graph, its vehicles' factors robust."""
        estimates = self.vehicles.values()
        means, variances = (np.array([getattr(one, name) for one in estimates]) for name in ("mean", "variance"))
        drift = np.abs([one.time - time for one in estimates]) / SENSOR_FILTER.drift_s
        variances = variances + self.sigma**2 * np.asarray(drift)
        found, variance = self.mean, self.sigma**2
        for _ in range(SENSOR_FILTER.reweighings):
            off = (means - found) ** 2 / variances
            weights = 1.0 / (1.0 + off / SENSOR_FILTER.loss_sigmas**2) / variances
            variance = 1.0 / (1.0 / self.sigma**2 + float(weights.sum()))
            found = variance * (self.mean / self.sigma**2 + float(weights @ means))
        least = SENSOR_FILTER.least_share * self.sigma
        return found, min(float(np.hypot(np.sqrt(variance), least)), self.sigma)

    def updated(self, vehicle: int, estimate: ErrorEstimate) -> SharedError:
        """The same with the estimate by one more vehicle, or by one of these once more, where that is surer."""
        before = self.vehicles.get(vehicle)
        kept = estimate if before is None or estimate.variance < before.variance else before
        others = [(name, one) for name, one in self.vehicles.items() if name != vehicle]
        return replace(self, vehicles=dict([*others, (vehicle, kept)][-SENSOR_FILTER.most_vehicles :]))


@dataclass(frozen=True)
class SensorFilter:
    """What is known of each sensor, by its name."""

    known: Mapping[str, SharedError] = field(default_factory=dict)

    def applied(self, evidence: Sequence[Evidence], time: float) -> tuple[Evidence, ...]:
        """Evidence of a time, its maps with what is known of their sensors."""
        return tuple(self._with_known(one, time) for one in evidence)

    def _with_known(self, one: Evidence, time: float) -> Evidence:
        known = self.known.get(_sensor(one))
        if known is None or not isinstance(one, DepthMap):
            return one
        mean, sigma = known.at(time)
        return replace(one, shared_mean=mean, shared_sigma=sigma)

    def over(self, frame: Frame) -> Frame:
        """A vehicle's frame, its maps with what is known of their sensors; the same one where nothing is."""
        evidence = frame.given.observation.evidence
        if not any(_sensor(one) in self.known for one in evidence):
            return frame
        try:
            return frame.sensing(self.applied(evidence, frame.time))
        except DegenerateProblemError:  # so few keypoints that it stands by the pixels that it had
            return frame

    def later(
        self, time: float, evidence: Sequence[Evidence], vehicles: Mapping[int, tuple[Frame, ShapeValues]]
    ) -> SensorFilter:
        """Take a frame.

        Args:
            time: Of it, seconds.
            evidence: Of the frame, with what was known before (`applied`).
            vehicles: Each as it was looked at, and its shape, by id.
        """
        maps = {_sensor(one): one for one in evidence if isinstance(one, DepthMap) and _sensor(one)}
        if not maps:
            return self
        known = {name: SharedError(one.shared_mean, one.shared_sigma) for name, one in maps.items()} | dict(self.known)
        for vehicle, (frame, shape) in vehicles.items():
            for name, (mean, variance) in _estimates(frame, shape).items():
                if name in known:
                    known[name] = known[name].updated(vehicle, ErrorEstimate(mean, variance, time))
        return SensorFilter(known)


def _sensor(one: Evidence) -> str:
    """Name of what made a map in metres whose shared error is its constant; else empty."""
    if not (isinstance(one, DepthMap) and one.shared_sigma) or one.known is None or np.any(one.known.covariance):
        return ""
    return one.sensor


def _estimates(frame: Frame, shape: ShapeValues) -> dict[str, tuple[float, float]]:
    """Shared errors of a frame's sensors by one vehicle: mean and variance, by name.

    It is what its graph, without a ground, has of each beyond what was known before.
    """
    if not any(_sensor(one) for one in frame.problem.observation.evidence):
        return {}
    state = State([frame.pose], {0: shape}, [frame.weights])
    graph = Graph([GraphObservation(frame.problem.on(None))], state, pose_free=True)
    sensors = {k: one for k, one in graph.shared.known.items() if isinstance(one, ScaledDepth) and _sensor(one.given)}
    optimum = optimise(graph, state, SENSOR_FILTER.iterations) if sensors else None
    if optimum is None or optimum.failure is not None:
        return {}
    graph.look(optimum.values)
    weights = optimum.state.weights
    whole = marginals_of(graph, optimum.values, weights, sensors.keys(), as_assumed=True)
    counted = marginals_of(graph, optimum.values, common_weights(graph, weights), sensors.keys())
    if whole is None or counted is None:
        return {}
    found: dict[str, tuple[float, float]] = {}
    for key, one in sensors.items():
        before = 1.0 / float(one.covariance[1, 1])
        solved, sure = (1.0 / float(spread.joint([key])[1, 1]) for spread in (whole, counted))
        if min(solved, sure) > (1.0 + SENSOR_FILTER.least_gain) * before:
            off = float(optimum.values.atVector(key)[1]) * solved / (solved - before)
            found[one.given.sensor] = one.given.shared_mean + off, 1.0 / (sure - before)
    return found
