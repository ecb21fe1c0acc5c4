"""The result of reconstructing all vehicles of an image together: each of them, and the ground they stand on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import FgreconError
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.text import counted


@dataclass(frozen=True, eq=False)
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
        camera: The camera; with a focal length that was solved for, at its value and with the standard deviation that
            is left in `focal_sigma`.
        focal_lengths: Focal lengths fx in pixels that explain the image, the best first, and how many nats worse each
            is: more than one where the vehicles leave open which. Empty where it was known.
        message: What was done, in a sentence.
        milliseconds: Wall time by stage.
    """

    numbers: tuple[int, ...]
    vehicles: tuple[Reconstruction, ...]
    refused: Mapping[int, FgreconError]
    ground: Ground | None
    ground_covariance: NDArray[np.float64] | None
    camera: Camera
    focal_lengths: tuple[tuple[float, float], ...]
    message: str
    milliseconds: Mapping[str, float]

    def __repr__(self) -> str:
        """A few lines: the ground, and a line for each vehicle."""
        vehicles = counted(len(self.vehicles), "vehicle")
        lines = [f"SceneReconstruction: {vehicles}, {len(self.refused)} refused. {self.message}"]
        if self.focal_lengths:
            focal = f"{self.camera.matrix[0, 0]:.0f} px, known to {100 * self.camera.focal_sigma:.0f} %"
            others = ", ".join(
                f"{pixels:.0f} px is {excess:.1f} nats worse" for pixels, excess in self.focal_lengths[1:]
            )
            lines.append(f"  focal length {focal}{f' ({others})' if others else ''}")
        if self.ground is not None:
            pitch, roll = np.degrees(np.arctan2(self.ground.normal[[2, 0]], self.ground.normal[1]))
            lines.append(f"  ground {self.ground.distance:.2f} m below, pitch {pitch:.1f} and roll {roll:.1f} degrees")
        for number, vehicle in zip(self.numbers, self.vehicles, strict=True):
            x, y, z = vehicle.location
            lines.append(f"  {number}: {vehicle.status.value} at ({x:.1f}, {y:.1f}, {z:.1f}) m")
        return "\n".join(lines)
