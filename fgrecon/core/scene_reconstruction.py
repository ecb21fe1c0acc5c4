"""The result of reconstructing all vehicles of an image together: each of them, and the ground they stand on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Ground
from fgrecon.core.errors import FgreconError
from fgrecon.core.reconstruction import Reconstruction

__all__ = ["SceneReconstruction"]


@dataclass(frozen=True)
class SceneReconstruction:
    """The vehicles of one image on one ground.

    Attributes:
        numbers: Indices of the observations that were solved, in order.
        vehicles: Their results.
        refused: Why the other observations were refused, by index.
        ground: The plane that the vehicles stand on; the one that was given where fewer than two were solved, None
            where none was.
        ground_covariance: (3, 3) of its distance in metres, and of its pitch and roll in radians; None where it was not
            solved for.
        message: What was done, in a sentence.
        milliseconds: Wall time by stage.
    """

    numbers: tuple[int, ...]
    vehicles: tuple[Reconstruction, ...]
    refused: Mapping[int, FgreconError]
    ground: Ground | None
    ground_covariance: NDArray[np.float64] | None
    message: str
    milliseconds: Mapping[str, float]

    def __repr__(self) -> str:
        """A few lines: the ground, and a line for each vehicle."""
        lines = [f"SceneReconstruction: {len(self.vehicles)} vehicles, {len(self.refused)} refused. {self.message}"]
        if self.ground is not None:
            pitch, roll = np.degrees(np.arctan2(self.ground.normal[[2, 0]], self.ground.normal[1]))
            lines.append(f"  ground {self.ground.distance:.2f} m below, pitch {pitch:.1f} and roll {roll:.1f} degrees")
        for number, vehicle in zip(self.numbers, self.vehicles, strict=True):
            x, y, z = vehicle.location
            lines.append(f"  {number}: {vehicle.status.value} at ({x:.1f}, {y:.1f}, {z:.1f}) m")
        return "\n".join(lines)
