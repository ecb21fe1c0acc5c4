"""Keypoints of one vehicle by a detector, with its other outputs: direction, class, score."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.checks import as_finite, own
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import view_azimuth
from fgrecon.core.metrics import wrap_angle
from fgrecon.core.observation import Observation, as_directions
from fgrecon.core.repr import brief_repr

_SUREST = 1e-6
_ROUNDED = 1e-3  # by how much probabilities may miss one


@dataclass(frozen=True, eq=False)
class Detection:
    """Keypoints of one vehicle, and from where it is seen.

    Attributes:
        observation: Keypoints, confidences, covariances and box, pixels of the image.
        azimuth: (A,) probability of each direction from the vehicle to the camera, as in `Observation`. None where the
            detector does not say.
        visible: (K,) probability of each keypoint to be visible, wherever it is; or None.
        kinds: Probability of each kind of vehicle (`car`, `van`, `lorry`), by name; None where the detector does not
            say. No evidence of the size unless it is requested (`reconstruct_image`, `classes`): where cars are many, a
            few per cent of a van put each of them farther away.
    """

    observation: Observation
    azimuth: NDArray[np.float64] | None = None
    visible: NDArray[np.float64] | None = None
    kinds: Mapping[str, float] | None = field(default=None, kw_only=True)

    __repr__ = brief_repr

    @property
    def evidence(self) -> Observation:
        """What a solver takes: the observation, which knows directions as well."""
        if self.azimuth is None or self.azimuth is self.observation.azimuth:
            return self.observation
        return replace(self.observation, azimuth=self.azimuth)

    @property
    def front_probability(self) -> float | None:
        """How probably the camera is ahead of the vehicle, and not behind it; None where no directions are given."""
        return None if self.azimuth is None else facing_probability(self.azimuth, 0.0)

    @property
    def left_probability(self) -> float | None:
        """How probably the camera is to the vehicle's left, and not its right; None where no directions are given."""
        return None if self.azimuth is None else facing_probability(self.azimuth, np.pi / 2.0)

    def __post_init__(self) -> None:
        """Check the arrays.

        Raises:
            InvalidInputError: The observation is none, or the directions or visibilities are no probabilities.
        """
        if not isinstance(self.observation, Observation):
            raise InvalidInputError("detection.observation", self.observation, "Give an `fgrecon.Observation`.")
        if self.azimuth is not None:
            object.__setattr__(self, "azimuth", as_directions("detection.azimuth", self.azimuth))
        if self.visible is not None:
            visible = as_finite("detection.visible", self.visible, (len(self.observation.keypoints),))
            if ((visible < 0) | (visible > 1)).any():
                raise InvalidInputError("detection.visible", visible.tolist(), "Give probabilities from 0 to 1.")
            object.__setattr__(self, "visible", own(visible))
        if self.kinds is not None:
            shares = as_finite("detection.kinds", list(self.kinds.values()), (None,))
            if (shares < 0).any() or abs(float(shares.sum()) - 1.0) > _ROUNDED:
                raise InvalidInputError("detection.kinds", dict(self.kinds), "Give probabilities that sum to one.")


def at_direction(values: NDArray[np.float64], azimuth: NDArray[np.float64]) -> NDArray[np.float64]:
    """(M,) values at azimuths (M,), radians, linearly between those (A,) of directions as in `Detection`."""
    bins = len(values)
    place = np.mod(azimuth, 2.0 * np.pi) / (2.0 * np.pi) * bins
    low, share = place.astype(int) % bins, place % 1.0
    return (1.0 - share) * values[low] + share * values[(low + 1) % bins]


def facing_probability(directions: NDArray[np.float64], azimuth: float) -> float:
    """Probability of the half of all directions around one.

    Args:
        directions: (A,) probability of each direction, as in `Detection`; even within its bin.
        azimuth: The direction, radians.
    """
    return float(half_around(azimuth, len(directions)) @ directions)


def pose_facing_probability(directions: NDArray[np.float64], camera_T_object: NDArray[np.float64]) -> float:
    """The same of the half around the direction from which a vehicle at a pose (4, 4) is seen."""
    return facing_probability(directions, float(view_azimuth(camera_T_object[:3, :3], camera_T_object[:3, 3])))


def half_around(azimuth: float, bins: int) -> NDArray[np.float64]:
    """(A,) share of each of A directions that is in the half of all around one, radians."""
    width = 2.0 * np.pi / bins
    off = np.abs(wrap_angle(width * np.arange(bins) - azimuth))
    return np.minimum(np.maximum((np.pi / 2.0 - off) / width + 0.5, 0.0), 1.0)


def calibrated_facing(probability: float, bias: float, slope: float) -> float:
    """How probably a result that chose a facing has the right one, for the probability that the network gives it.

    Less than the network says: a result that follows from the same image is wrong where the network is.

    Args:
        probability: The network's.
        bias: Of the log odds.
        slope: What the network's log odds count.
    """
    p = min(max(probability, _SUREST), 1.0 - _SUREST)
    odds = math.exp(bias + slope * math.log(p / (1.0 - p)))
    return odds / (1.0 + odds)
