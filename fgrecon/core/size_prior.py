"""Size prior: mean and spread of length, width and height of a fleet, a class, or a mix of classes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.checks import as_finite, as_shape, own
from fgrecon.core.errors import InvalidInputError

SHORTEST, LONGEST = 0.3, 30.0
"""Metres: what a vehicle's length, width and height are from and to."""

SIZES = f"length, width and height are {SHORTEST:g} to {LONGEST:g} m"
"""The same in words, for errors."""

_FOOT_M = 0.3048
_FEET = 2.2  # times the usual length, width and height at once: small cars in feet have 2.3, 2.9 and 2.9, lorries less
_KNOWN, _WIDEST = 1e-4, 1e6  # metres: a size is known no better, and may be anything


@dataclass(frozen=True, eq=False)
class SizePrior:
    """Gaussian prior on a vehicle's box.

    Attributes:
        name: Name of the fleet.
        mean: (3,) mean length, width and height, metres.
        sigma: (3,) their standard deviations, metres; near zero where the size is known, at least 0.0001 m.
        traffic: (3, 3) second moment about `mean` of all that is taken for one of the fleet, square metres: among cars
            there are vans. What covariances count, since one picture hardly distinguishes the two; None for that of the
            fleet.
        allowed: (3,) standard deviations that a solve allows, metres; None for `sigma`. Keypoints err together and
            count too much in a solve, so that less than the fleet's own may be best.
        classes: Of vehicles that it is the sizes of, or that are in the fleet's traffic, the usual one first.
        own: (3, 3) covariance within a class, about the class's own mean, square metres: what covariances count where
            another class is counted beside it; None for that of `sigma`.
        mixed: Whether all classes of the fleet count: of which a vehicle is, its image says
            (`fgrecon.solve.fitted_class`).
        coarse: Name of the shape that stands for that of these classes, where no prior of cars has it.
        class_sizes: Sizes and shares of the fleet's classes; None for the package's.
    """

    name: str
    mean: NDArray[np.float64]
    sigma: NDArray[np.float64]
    traffic: NDArray[np.float64] | None = None
    allowed: NDArray[np.float64] | None = None
    classes: tuple[str, ...] = ()
    own: NDArray[np.float64] | None = None
    mixed: bool = False
    coarse: str | None = None
    class_sizes: ClassSizes | None = None

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidInputError: A mean is no vehicle's size in metres, a spread is not positive and finite, or the
                traffic's moment no covariance.
        """
        for field in ("mean", "sigma") if self.allowed is None else ("mean", "sigma", "allowed"):
            array = as_finite(f"size_prior.{field}", getattr(self, field), (3,))
            if (array <= 0).any():
                raise InvalidInputError(f"size_prior.{field}", array.tolist(), "Give positive numbers in metres.")
            if field == "mean" and ((array < SHORTEST) | (array > LONGEST)).any():
                raise InvalidInputError("size_prior.mean", array.tolist(), f"Give metres: {SIZES}.")
            if field != "mean":
                if (array > _WIDEST).any():
                    raise InvalidInputError(f"size_prior.{field}", array.tolist(), f"Give metres, up to {_WIDEST:g}.")
                array = np.maximum(array, _KNOWN)
            object.__setattr__(self, field, own(array))
        for field in ("traffic", "own"):
            if getattr(self, field) is None:
                continue
            moment = as_finite(f"size_prior.{field}", getattr(self, field), (3, 3))
            wide = np.abs(moment).max() > _WIDEST**2
            if wide or not np.array_equal(moment, moment.T) or np.linalg.eigvalsh(moment)[0] <= 0.0:
                raise InvalidInputError(f"size_prior.{field}", moment.tolist(), "Give a covariance, square metres.")
            object.__setattr__(self, field, own(moment))

    @property
    def assumed_sigma(self) -> NDArray[np.float64]:
        """(3,) standard deviations that a solve assumes, metres."""
        return self.sigma if self.allowed is None else self.allowed

    @property
    def as_in_traffic(self) -> SizePrior:
        """The same with standard deviations in a solve that are those of `spread`."""
        return replace(self, allowed=np.sqrt(np.diag(self.spread)), own=self.spread)

    @property
    def spread(self) -> NDArray[np.float64]:
        """(3, 3) how far sizes are from `mean` in covariances, square metres: of the traffic, or else of the fleet."""
        return np.diag(self.sigma**2) if self.traffic is None else self.traffic

    @property
    def own_spread(self) -> NDArray[np.float64]:
        """(3, 3) the same of one class alone."""
        return np.diag(self.sigma**2) if self.own is None else self.own


_FLEETS = np.array([0.08, 0.09, 0.07])
_ALIKE = 0.9
"""Standard deviations of the logarithms of fleets' mean length, width and height, and their correlation: those of the
cars of KITTI, ApolloCar3D, nuScenes, Lyft and Waymo as published."""


def other_fleets(mean: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) how far the mean size of a fleet is from that of another one of mean size (3,), square metres."""
    correlation = _ALIKE + (1.0 - _ALIKE) * np.eye(3)
    return correlation * np.outer(_FLEETS * mean, _FLEETS * mean)


_HEIGHT_ALLOWED = 0.5  # of a class's spread of height, in a solve: as of the fleet `kitti`, on whose cars it was chosen


@dataclass(frozen=True)
class ClassOdds:
    """How probable a class is beside the usual one, nats, where a vehicle is solved as one of either."""

    fleet: float  # logarithm of its odds where nobody says more
    given: float = 0.0  # more where another program says of which class it is


@dataclass(frozen=True, eq=False)
class ClassSizes:
    """Sizes of vehicles by their class, and how classes of other programs are called."""

    name: str  # of the fleet that they were measured on
    mean: Mapping[str, NDArray[np.float64]]  # (3,) mean length, width and height of each class, the usual one first
    covariance: Mapping[str, NDArray[np.float64]]  # (3, 3) of each class, square metres
    share: Mapping[str, float]  # of each class among all, where nobody says which it is
    odds: Mapping[str, ClassOdds]  # of each class, where its image says too
    coarse: Mapping[str, str]  # name of the shape that stands for that of a class which no prior of cars has
    # probability of each class by another program's name for it, by its scheme and the name in lower case
    schemes: Mapping[str, Mapping[str, Mapping[str, float]]]
    # of a van against a car, in nats, by how much more the package's detector takes it for a truck: at 0, and for each
    detector_odds: tuple[float, float]

    @property
    def usual(self) -> str:
        """The class of which vehicles are where nobody says more: the one that shape priors are of."""
        return next(iter(self.mean))

    def detected(self, name: str, margin: float) -> dict[str, float]:
        """Probability of each class of a vehicle that the package's detector calls so, by COCO's names.

        Which share of the cars and vans is vans tells how much more than for a car it takes it for a truck.

        Args:
            name: What it calls it.
            margin: Its number (logit) of a truck less that of a car.
        """
        found = self.probabilities({name: 1.0}, "coco")
        either, (offset, slope) = found["car"] + found["van"], self.detector_odds
        van = either / (1.0 + math.exp(-(offset + slope * margin)))
        return {**found, "car": either - van, "van": van}

    def probabilities(self, named: Mapping[str, float], scheme: str) -> dict[str, float]:
        """Probability of each class where another program says with which probability a vehicle is what.

        What is missing to one is shared out as the classes are among all.

        Args:
            named: Probabilities by the program's names, whatever their case.
            scheme: Of these names.

        Raises:
            InvalidInputError: There is no such scheme, or a name is none of it.
        """
        if scheme not in self.schemes:
            raise InvalidInputError("vehicle_class.scheme", scheme, f"Give one of {', '.join(self.schemes)}.")
        known, found = self.schemes[scheme], dict.fromkeys(self.mean, 0.0)
        for name, probability in named.items():
            if (classes := known.get(name.lower())) is None:
                raise InvalidInputError("vehicle_class", name, f"Names of {scheme} are {', '.join(known)}.")
            for one, share in classes.items():
                found[one] += probability * share
        left = max(0.0, 1.0 - sum(found.values()))
        return {one: value + left * self.share[one] for one, value in found.items()}

    def of_one_shape(self, probabilities: Mapping[str, float]) -> dict[str, float]:
        """The probabilities of those classes that have the more probable shape."""
        shapes = dict.fromkeys((self.coarse.get(one) for one in self.mean), 0.0)
        for one, p in probabilities.items():
            shapes[self.coarse.get(one)] += p
        shape = max(shapes, key=shapes.__getitem__)
        return {one: p for one, p in probabilities.items() if self.coarse.get(one) == shape}

    def size(self, probabilities: Mapping[str, float], usual: SizePrior | None, *, any_fleet: bool) -> SizePrior:
        """The size of a vehicle that is of each class with a probability: mean and covariance of the mixture.

        One Gaussian for classes of similar size is what leaves the least error in the mean where the image does not
        tell them apart. Classes of different shapes it does: those of the more probable shape count alone.

        Args:
            probabilities: By class.
            usual: Sizes of the usual class, where they are given by others than these; None for these.
            any_fleet: Whether the vehicle may be of any fleet: what they differ by is added.
        """
        means, covariances = dict(self.mean), dict(self.covariance)
        if any_fleet:
            covariances = {one: value + other_fleets(means[one]) for one, value in covariances.items()}
        if usual is not None:
            means[self.usual], covariances[self.usual] = usual.mean, usual.spread
        likely = {one: p for one, p in self.of_one_shape(probabilities).items() if p > 0.0}
        total, shape = sum(likely.values()), self.coarse.get(next(iter(likely)))
        mean, covariance, within = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))
        for one, p in likely.items():
            mean += p / total * means[one]
            within += p / total * covariances[one]
        for one, p in likely.items():
            covariance += p / total * (covariances[one] + np.outer(means[one] - mean, means[one] - mean))
        sigma = np.sqrt(np.diag(covariance))
        name = ", ".join(f"{one} {p / total:.2f}" if len(likely) > 1 else one for one, p in likely.items())
        moment, own_moment = ((one + one.T) / 2.0 for one in (covariance, within))
        allowed = sigma * np.array([1.0, 1.0, _HEIGHT_ALLOWED])
        return SizePrior(name, mean, sigma, moment, allowed, tuple(likely), own_moment, coarse=shape)

    def fleet(self) -> SizePrior:
        """The fleet of these classes as often as each is: its size is that of the usual one, until an image says more.

        Those of another shape than the usual one's are in it where another program says so.
        """
        traffic = self.size(self.share, None, any_fleet=False)
        one = self.size({self.usual: 1.0}, None, any_fleet=False)
        moment = traffic.spread + np.outer(traffic.mean - one.mean, traffic.mean - one.mean)
        return replace(one, name=self.name, traffic=moment, classes=traffic.classes, mixed=True, class_sizes=self)


_KITTI = SizePrior(
    "kitti",
    # Measured: the 14,357 cars labelled in KITTI's object train split, and the boxes of the 78 ApolloCar3D models that
    # the default prior is learnt from (width without mirrors). Traffic: these cars and the 1,297 vans.
    np.array([3.89, 1.62, 1.53]),
    np.array([0.44, 0.11, 0.14]),
    np.array([[0.368, 0.055, 0.098], [0.055, 0.020, 0.022], [0.098, 0.022, 0.062]]),
    # Chosen on KITTI's video: what keypoints say of a car's height is what puts it nearer or farther. With half the
    # spread cars are 5 % less off on average (docs/history/size.md).
    np.array([0.44, 0.11, 0.07]),
    ("car", "van"),
)

SIZE_PRIORS = {
    "kitti": _KITTI,
    "kitti_traffic": replace(_KITTI, name="kitti_traffic", mixed=True),
    "apollo79": SizePrior("apollo79", np.array([4.57, 1.80, 1.59]), np.array([0.39, 0.09, 0.15])),
}
"""The named fleets."""

_FIX = f"Use {', '.join(SIZE_PRIORS)} or length,width,height[,sigma_l,sigma_w,sigma_h] in metres."


SizesLike = SizePrior | str | Sequence[float] | NDArray[np.float64]
"""A size prior, its name, or length, width and height in metres, with or without their standard deviations."""


def size_prior(value: SizesLike) -> SizePrior:
    """A size prior by its name (`SIZE_PRIORS`) or from length, width, height[, sigma_l, sigma_w, sigma_h].

    Without spreads, 2 % of each dimension is assumed: the size is then as good as known.

    Args:
        value: The name, the numbers in metres as a text with commas or as a sequence, or a size prior.

    Raises:
        InvalidInputError: It is neither a name nor three or six positive numbers.
    """
    if isinstance(value, SizePrior):
        return value
    if isinstance(value, str):
        return SIZE_PRIORS[value] if value in SIZE_PRIORS else _parsed(value)
    numbers = as_shape("size_prior", value, (None,), _FIX)
    if not np.isfinite(numbers).all():
        raise InvalidInputError("size_prior", value, _FIX)
    return _parsed(",".join(map(str, numbers.tolist())))


def check_size(field: str, size: NDArray[np.float64], usual: NDArray[np.float64]) -> None:
    """Refuse a size (3,) in feet, or in another order than length, width, height: KITTI's and nuScenes' differ.

    Args:
        field: What an error names.
        size: Length, width and height, metres.
        usual: (3,) those of the category's mean vehicle.

    Raises:
        InvalidInputError: The category is longest along its axis, and this is not; or no vehicle of any class has so
            many times each of its lengths, and in feet one has.
    """
    fix, given = "", size.tolist()
    if usual[0] > usual[1:].max() and size[0] < size[1:].max():
        fix = f"Give length, width, height, in metres and in this order: {_in_metres(usual)} is usual."
    elif (size > _FEET * usual).all() and (_FOOT_M * size < _FEET * usual).all():
        fix = f"Give length, width, height in metres: {_in_metres(usual)} is usual, and these feet are "
        fix += f"{_in_metres(_FOOT_M * size)}."
    if fix:
        raise InvalidInputError(field, given, fix)


def _in_metres(size: NDArray[np.float64]) -> str:
    return ", ".join(f"{metres:.2f}" for metres in size)


@lru_cache(maxsize=64)  # one object for one text, so that what is prepared for it is found again
def _parsed(text: str) -> SizePrior:
    try:
        numbers = np.array([float(part) for part in text.split(",")])
    except ValueError:
        numbers = np.empty(0)
    if len(numbers) not in (3, 6):
        raise InvalidInputError("size_prior", text, _FIX)
    mean = numbers[:3]
    return SizePrior(text, mean, numbers[3:] if len(numbers) == 6 else 0.02 * np.abs(mean))
