"""The ground of an image as the variable G(t), and its vehicles, each of which stands on it.

How far cars lie off a plane that is told beforehand (`Ground`) is mostly the plane's fault, pitch above all, and the
same for all of them; so that part of the plane's uncertainty is the prior's of G, and what is left is each vehicle's
own. A vehicle on another road or a kerb is an outlier of its contact alone. Without a ground the vehicles' own poses
say about where it is, and the prior is wide.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors.contact import GroundFrame, contact_factor
from factors.keys import G, X
from factors.losses import Loss, RobustLoss
from factors.noise import diagonal_noise
from fgrecon.core.camera import Ground
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.solve.weakness import off_ground

__all__ = [
    "LEAST_DOWN",
    "LEAST_HEIGHT",
    "OWN_TILT",
    "Standing",
    "ground_spread",
    "own_deviations",
    "seen_ground",
]

Array = NDArray[np.float64]

OWN_HEIGHT, OWN_SLOPE, OWN_TILT = 0.35, 0.15, 0.5
"""Shares of a told ground's deviations that are each vehicle's own; chosen on KITTI's video (docs/method.md).

Of a ground that is told more vaguely than `Ground` is by itself these are shares of what that has: vehicles lie as near
to their road, whatever is known of it."""
LEAST_HEIGHT = 0.2
"""Metres: a camera is above the road."""
LEAST_DOWN = 0.1
"""Of the normal of a ground: cameras look along it rather than at it, and none is rolled by a quarter turn."""
_WIDE = (0.5, 0.3, 0.1)  # metres, radians, radians: prior of height, pitch and roll where no ground is told
_OUTLYING = 3.0  # standard deviations from which on a contact counts less


@dataclass(frozen=True)
class Standing:
    """The vehicles of an image on its ground.

    Attributes:
        key: Of the ground's variable.
        nominal: About where the ground is.
        frame: Axes in which the variable changes it.
        contacts: The factor between ground and pose of each vehicle, by its number.
        spread: (3,) standard deviations of height, pitch and roll before the vehicles tell.
    """

    key: int
    nominal: Ground
    frame: GroundFrame
    contacts: Mapping[int, gtsam.CustomFactor]
    spread: Array

    @classmethod
    def of(cls, image: int, poses: Mapping[int, Array], nominal: Ground, *, is_told: bool = True) -> Standing:
        """The ground of an image with vehicles at poses (4, 4), by number, about where it was told or seen to be."""
        frame = GroundFrame.of(nominal.normal, nominal.distance)
        contacts = {
            number: contact_factor(X(number, 0), G(image), frame, _contact_noise(nominal, float(pose[2, 3])))
            for number, pose in poses.items()
        }
        return cls(G(image), nominal, frame, contacts, ground_spread(nominal if is_told else None))

    @property
    def prior(self) -> gtsam.PriorFactorVector:
        """What is known of the ground before the vehicles tell."""
        return gtsam.PriorFactorVector(self.key, np.zeros(3), diagonal_noise("ground", self.spread))

    def ground(self, values: gtsam.Values) -> Ground | None:
        """The ground at some values; None where that is none."""
        normal, distance = self.frame.plane(values.atVector(self.key))
        if normal[1] <= LEAST_DOWN:
            return None
        return replace(self.nominal, normal=normal, distance=max(distance, LEAST_HEIGHT))

    def doubt(self, result: Reconstruction, told: Ground | None, values: gtsam.Values) -> list[str]:
        """The clause of a vehicle that does not stand on the ground that was told, or else on that of the others."""
        depth = float(result.location[2])
        if told is not None:
            return off_ground(float(told.normal @ result.location - told.distance), told.height_sigma_at_depth(depth))
        normal, distance = self.frame.plane(values.atVector(self.key))
        return off_ground(float(normal @ result.location - distance), _own_height(self.nominal, depth))


def ground_spread(plane: Ground | None) -> Array:
    """(3,) standard deviations of height, pitch and roll before the vehicles tell; `plane` is what is told."""
    return np.array(_WIDE if plane is None else (plane.height_sigma, plane.slope_sigma, plane.slope_sigma))


def seen_ground(poses: Sequence[Array]) -> Ground | None:
    """The plane that vehicles' poses (4, 4) speak of: their median down axis and height; None where it is none."""
    down = np.median([pose[:3, 1] for pose in poses], axis=0)
    normal = down / np.linalg.norm(down)
    if normal[1] <= LEAST_DOWN:
        return None
    distance = float(np.median([pose[:3, 3] @ normal for pose in poses]))
    return Ground(normal, max(distance, LEAST_HEIGHT))


def _contact_noise(ground: Ground, depth: float) -> gtsam.noiseModel.Robust:
    """What is a vehicle's own of its deviation from the plane."""
    height, tilt = _own_height(ground, depth), OWN_TILT * min(ground.tilt_sigma, Ground.tilt_sigma)
    return RobustLoss.of(Loss.CAUCHY, _OUTLYING).wrap(diagonal_noise("contact", np.array([height, tilt, tilt, tilt])))


def own_deviations(ground: Ground, depth: float) -> tuple[float, float]:
    """How far a vehicle's origin lies off the ground of the others by its height and slope, metres (1 sigma each)."""
    height = OWN_HEIGHT * min(ground.height_sigma, Ground.height_sigma)
    return height, OWN_SLOPE * min(ground.slope_sigma, Ground.slope_sigma) * depth


def _own_height(ground: Ground, depth: float) -> float:
    """How far a vehicle's origin may lie off the ground of the others, metres (1 sigma)."""
    return float(np.hypot(*own_deviations(ground, depth)))
