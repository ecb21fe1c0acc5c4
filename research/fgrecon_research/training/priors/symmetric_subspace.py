"""The linear subspace of mirror-symmetric shapes: fewer unknowns, and symmetry for every coefficient."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_MIRROR = np.diag([1.0, 1.0, -1.0])
_MEDIAL = np.eye(3)[:, :2]


@dataclass(frozen=True)
class Orbit:
    """Keypoints that share their unknowns: a mirrored pair, a point on the medial plane, or one free point."""

    keypoints: NDArray[np.intp]  # (P,) their indices
    maps: NDArray[np.float64]  # (P, 3, D) from the D shared unknowns to each keypoint's coordinates

    @property
    def size(self) -> int:
        """Number of shared unknowns D."""
        return int(self.maps.shape[2])


@dataclass(frozen=True)
class SymmetricSubspace:
    """Shapes (K, 3) that equal their own mirror image about z = 0; every shape where symmetry is not imposed.

    A pair has the unknowns (x, y, z) of its left point, whose image is (x, y, -z); a keypoint without a partner lies
    on the medial plane and has (x, y). The rank of the mean and basis thus halves, and no coefficient can break the
    symmetry; mirrored copies of the data would impose it on the mean alone and cost twice the time.
    """

    orbits: tuple[Orbit, ...]  # the groups of keypoints, which together contain each keypoint once
    mirror: NDArray[np.intp] | None  # (K,) index of each keypoint's mirror image, or None where symmetry is not imposed

    @classmethod
    def of(cls, size: int, pairs: Sequence[tuple[int, int]], symmetric: bool) -> SymmetricSubspace:
        """The subspace for `size` keypoints and their pairs (left, right); without pairs nothing is imposed."""
        if not symmetric or not pairs:
            return cls(tuple(Orbit(np.array([k]), np.eye(3)[None]) for k in range(size)), None)
        mirror = np.arange(size)
        orbits = []
        for left, right in pairs:
            mirror[left], mirror[right] = right, left
            orbits.append(Orbit(np.array([left, right]), np.stack([np.eye(3), _MIRROR])))
        orbits += [Orbit(np.array([k]), _MEDIAL[None]) for k in range(size) if mirror[k] == k]
        return cls(tuple(orbits), mirror)

    @property
    def symmetric(self) -> bool:
        """Whether symmetry is imposed."""
        return self.mirror is not None

    def project(self, shapes: NDArray[np.float64]) -> NDArray[np.float64]:
        """The nearest shapes (..., K, 3) inside the subspace."""
        if self.mirror is None:
            return shapes
        return 0.5 * (shapes + shapes[..., self.mirror, :] @ _MIRROR)
