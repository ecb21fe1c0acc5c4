"""Evidence beside keypoints: of one vehicle with its observation, of all vehicles of an image with the call."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.checks import as_either, as_finite, as_list, as_rigid, as_shape, own
from fgrecon.core.choices import ClassScheme
from fgrecon.core.depth_map import DepthMap
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.mask import Mask
from fgrecon.core.repr import brief_repr
from fgrecon.core.settings import one_of

_ROUNDED = 1e-3  # by how much probabilities may exceed one


@dataclass(frozen=True, eq=False, init=False, repr=False)
class VehicleClass:
    """Which class of vehicle it is: its size is that of the class, or a mix where the class is not sure.

    Attributes:
        probabilities: Of each class, by its name in the scheme (whatever the case); or a single name for a class that
            is sure. What is missing to one is any class, as often as each is among all.
        scheme: Whose names these are; the package's own are `car`, `van`, `lorry`, `bus` and `tram`.
    """

    probabilities: Mapping[str, float]
    scheme: ClassScheme = ClassScheme.FGRECON

    def __init__(
        self, probabilities: Mapping[str, float] | str, scheme: ClassScheme | str = ClassScheme.FGRECON
    ) -> None:
        """Check the numbers; whether a scheme has the names is checked with the sizes of its classes.

        Raises:
            InvalidInputError: They are no probabilities, or there is no such scheme.
        """
        named = {probabilities: 1.0} if isinstance(probabilities, str) else probabilities
        fix = "Give a name, or probabilities by name that sum to at most one."
        if not isinstance(named, Mapping) or not named or not all(isinstance(name, str) for name in named):
            raise InvalidInputError("vehicle_class", probabilities, fix)
        numbers = as_finite("vehicle_class", list(named.values()), (len(named),), fix)
        if (numbers < 0.0).any() or numbers.sum() > 1.0 + _ROUNDED:
            raise InvalidInputError("vehicle_class", dict(named), fix)
        object.__setattr__(self, "probabilities", dict(zip(named, numbers.tolist(), strict=True)))
        object.__setattr__(self, "scheme", one_of(ClassScheme, "vehicle_class.scheme", scheme))

    def __repr__(self) -> str:
        """The names with their probabilities."""
        shares = ", ".join(f"{name} {value:.2f}" for name, value in self.probabilities.items())
        return f"{type(self).__name__}({shares}; {self.scheme.value})"


@dataclass(frozen=True, eq=False)
class StereoPair:
    """The right image of a pair, whose left one shows the vehicles.

    Attributes:
        image: (H, W, 3) RGB, or grey; 8 or 16 bits; as large as the left one.
        camera: The right camera, or its matrix (3, 3), or (fx, fy, cx, cy).
        right_T_left: (4, 4) from the left camera's frame to the right one's, metres: (-baseline, 0, 0) of a rectified
            pair.
    """

    image: NDArray[Any]
    camera: Camera
    right_T_left: NDArray[np.float64]

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        """Check the camera and the motion.

        Raises:
            InvalidInputError: The camera is none, the motion is not rigid, or the right camera is not to the right.
        """
        object.__setattr__(self, "image", np.asarray(self.image))
        object.__setattr__(self, "camera", Camera.of(self.camera))
        motion = as_rigid("right_T_left", self.right_T_left)
        if not motion[0, 3] < 0.0 or abs(motion[0, 3]) < np.abs(motion[1:3, 3]).max():
            fix = "Give the motion from the left camera's frame to the right one's: (-baseline, 0, 0) where rectified."
            raise InvalidInputError("right_T_left", motion[:3, 3].tolist(), fix)
        object.__setattr__(self, "right_T_left", own(motion))


_LEAST_SIGMA, _LARGEST_SIGMA = 1e-4, 100.0  # metres
_FARTHEST = 1e5  # metres: no sensor measures farther
_MOST_UNSURE = 0.2, 1.0  # radians and metres by which a sensor's place is unsure: beyond, nobody knows where it is
_FASTEST = 200.0  # metres per second: no vehicle drives faster


@dataclass(frozen=True, eq=False)
class Points:
    """Measured points, of a whole scan or of one vehicle: LiDAR, RGB-D, stereo.

    Which of them are a vehicle's is decided in its graph; ground, neighbours and what is seen through glass need not be
    taken out.

    Attributes:
        points: (N, 3) in the camera's frame (x right, y down, z forward), metres; rows that are not finite are left
            out. An array or a tensor.
        sigma: Standard deviation of a point along its ray, metres: one, or one for each point.
        origin: (3,) where the sensor is in the camera's frame, metres: which sides of a vehicle it saw.
        place_sigma: How unsure it is where the sensor is and how it is turned, which all of its points have wrong
            together: standard deviations of the turn about each axis in radians, and of the shift along it in metres.
            The vehicles of an image then tell it (`Diagnostics.place_errors`).
    """

    points: NDArray[np.float64]
    sigma: float | NDArray[np.float64] = 0.02
    origin: ArrayLike = (0.0, 0.0, 0.0)
    place_sigma: tuple[float, float] = (0.0, 0.0)

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidInputError: They are no points, are farther than any sensor measures, or a standard deviation is
                none.
        """
        fix = "Give (N, 3) metres in the camera's frame; of more columns, such as intensities, points[:, :3]."
        points = as_shape("points", self.points, (None, 3), fix)
        fix = "Give standard deviations in metres, one, or one for each point."
        sigma = as_either("points.sigma", self.sigma, [(), (len(points),)], fix)
        finite = np.isfinite(points).all(axis=1)
        if not ((sigma >= _LEAST_SIGMA) & (sigma <= _LARGEST_SIGMA)).all():
            raise InvalidInputError("points.sigma", float(np.ravel(sigma)[0]), fix)
        kept = points[finite]
        if len(kept) and np.abs(kept).max() > _FARTHEST:
            raise InvalidInputError("points", float(np.abs(kept).max()), "Give metres in the camera's frame.")
        object.__setattr__(self, "points", own(kept))
        object.__setattr__(self, "sigma", float(sigma) if sigma.ndim == 0 else own(sigma[finite]))
        object.__setattr__(self, "origin", own(as_finite("points.origin", self.origin, (3,))))
        fix = "Give standard deviations, radians and metres, such as (0.01, 0.05)."
        place = as_finite("points.place_sigma", self.place_sigma, (2,), fix)
        if (place < 0.0).any() or (place > _MOST_UNSURE).any():
            raise InvalidInputError("points.place_sigma", place.tolist(), fix)
        object.__setattr__(self, "place_sigma", (float(place[0]), float(place[1])))

    def thinned(self, every: int) -> Points:
        """Each so-many-th of the points."""
        return self.chosen(slice(None, None, every))

    def chosen(self, which: slice | NDArray[np.bool_]) -> Points:
        """Some of the points."""
        sigma = self.sigma if isinstance(self.sigma, float) else self.sigma[which]
        return Points(self.points[which], sigma, self.origin, self.place_sigma)


@dataclass(frozen=True, eq=False)
class Range:
    """How far away one vehicle is, as a radar, a range finder or an ultrasonic sensor says.

    Attributes:
        metres: From the sensor to the nearest point of the vehicle, or to its middle.
        sigma: Its standard deviation, metres.
        origin: (3,) where the sensor is in the camera's frame, metres.
        to_centre: Whether it is measured to the middle of the vehicle's 3D box.
    """

    metres: float
    sigma: float
    origin: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    to_centre: bool = False

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidInputError: The range is not above zero, or the standard deviation is none.
        """
        _keep(self, "range", "metres", "Give metres, above zero.", (1e-3, _FARTHEST))
        _keep_sensor(self, "range", "metres")


@dataclass(frozen=True, eq=False)
class RangeRate:
    """How fast one vehicle comes or goes, along the ray from a radar.

    It is about its velocity: a `Tracker` uses it, a single image has none.

    Attributes:
        metres_per_second: Positive where it goes away.
        sigma: Its standard deviation, metres per second.
        origin: (3,) where the radar is in the camera's frame, metres.
        over_ground: Whether the radar's own motion is taken off; else the rate is relative to it.
    """

    metres_per_second: float
    sigma: float
    origin: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    over_ground: bool = False

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidInputError: The rate is no number that a vehicle has, or the standard deviation is none.
        """
        fix = "Give metres per second, positive where the vehicle goes away."
        _keep(self, "range_rate", "metres_per_second", fix, (-_FASTEST, _FASTEST))
        _keep_sensor(self, "range_rate", "metres per second")


def _keep(evidence: Range | RangeRate, kind: str, name: str, fix: str, limits: tuple[float, float]) -> None:
    value = float(as_finite(f"{kind}.{name}", getattr(evidence, name), (), fix))
    if not limits[0] <= value <= limits[1]:
        raise InvalidInputError(f"{kind}.{name}", value, fix)
    object.__setattr__(evidence, name, value)


def _keep_sensor(evidence: Range | RangeRate, kind: str, unit: str) -> None:
    """Check how sure the sensor is, in a unit, and where it is."""
    _keep(evidence, kind, "sigma", f"Give a standard deviation in {unit}.", (_LEAST_SIGMA, _LARGEST_SIGMA))
    object.__setattr__(evidence, "origin", own(as_finite(f"{kind}.origin", evidence.origin, (3,))))


Evidence = Points | DepthMap | StereoPair | VehicleClass | Range | RangeRate | Mask
"""What may be given as evidence."""


def as_evidence(given: Any) -> tuple[Evidence, ...]:
    """Evidence of any kinds as a tuple.

    Raises:
        InvalidInputError: It is no sequence of evidence, or has the same twice, or the same measurements.
    """
    if isinstance(given, tuple) and not given:  # of most vehicles there is none
        return given
    found = as_list("evidence", given)
    known: dict[Any, list[NDArray[Any]]] = {}
    for number, one in enumerate(found):
        if not isinstance(one, Evidence):
            names = ", ".join(f"`{kind.__name__}`" for kind in get_args(Evidence))
            raise InvalidInputError(f"evidence[{number}]", one, f"Give any of {names}.")
        again = any(one is other for other in found[:number])
        name = _MEASURED.get(type(one))
        if name is not None and len(found) > 1:
            numbers: NDArray[Any] = getattr(one, name)
            alike = known.setdefault((type(one), numbers.shape, *getattr(one, "corner", ())), [])
            again |= any(_is_same(numbers, other) for other in alike)
            alike.append(numbers)
        if again:
            fix = "Give each once: it would count twice."
            raise InvalidInputError(f"evidence[{number}]", "what is given before", fix)
    return tuple(found)


# Where measurements are so many that no two sensors have the same; two of the same range may well be two radars'.
_MEASURED = {Points: "points", DepthMap: "depth", StereoPair: "image", Mask: "pixels"}


def _is_same(one: NDArray[Any], other: NDArray[Any]) -> bool:
    """Whether two arrays of the same shape hold the same numbers, if any."""
    some = slice(None, None, max(1, len(one) // 8))  # which tell most others
    of_floats = one.dtype.kind == "f"
    if not np.array_equal(one[some], other[some], equal_nan=of_floats):
        return False
    return np.array_equal(one, other, equal_nan=of_floats) and bool(np.isfinite(one).any())
