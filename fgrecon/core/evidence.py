"""What is known beside keypoints: of one vehicle with its observation, of all vehicles of an image with the call."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.checks import as_either, as_finite, as_list, as_shape, own
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.repr import brief_repr
from fgrecon.core.vehicle_class import VehicleClass

_LEAST_SIGMA, _LARGEST_SIGMA = 1e-4, 100.0  # metres
_FARTHEST = 1e5  # metres: no sensor measures farther


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
    """

    points: NDArray[np.float64]
    sigma: float | NDArray[np.float64] = 0.02
    origin: ArrayLike = (0.0, 0.0, 0.0)

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidInputError: They are no points, lie farther than any sensor measures, or a standard deviation is
                none.
        """
        points = as_shape("points", self.points, (None, 3), "Give (N, 3) metres in the camera's frame.")
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

    def thinned(self, every: int) -> Points:
        """Each so-many-th of the points."""
        sigma = self.sigma if isinstance(self.sigma, float) else self.sigma[::every]
        return Points(self.points[::every], sigma, self.origin)


Evidence = Points | VehicleClass
"""What may be given as evidence."""


def as_evidence(given: Any) -> tuple[Evidence, ...]:
    """Evidence of any kinds as a tuple.

    Raises:
        InvalidInputError: It is no sequence of evidence.
    """
    found = as_list("evidence", given)
    for number, one in enumerate(found):
        if not isinstance(one, Points | VehicleClass):
            raise InvalidInputError(f"evidence[{number}]", one, "Give `Points`, or a `VehicleClass`.")
    return tuple(found)
