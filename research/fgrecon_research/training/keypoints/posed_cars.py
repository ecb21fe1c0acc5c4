"""Photographs of cars with measured poses, grouped by shape: what the keypoint networks learn from.

The folder holds `annotations.json` and `images/`. Every photograph shows one car and is cropped to it; its pose is
relative to a 3D model of the car whose box is centred at the origin and has a diagonal of one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import view_azimuth
from fgrecon.io.json_fields import read_json, read_records
from fgrecon.perception.keypoints.layout import KINDS
from fgrecon_research.training.keypoints.deform import UNKNOWN_KIND

Progress = Callable[[Sequence[Any], str], Iterable[Any]]
"""Goes through the items of a loop and shows, under a description, how many are done."""


def no_progress(items: Sequence[Any], _description: str) -> Iterable[Any]:
    """Goes through the items and shows nothing."""
    return items


@dataclass(frozen=True)
class PosedCar:
    """One photograph."""

    image: Path  # its file
    size: tuple[int, int]  # (width, height) in pixels; the car fills it
    cad_id: str  # name of the 3D model that the pose was measured with; the same one does for several models of cars
    matrix: NDArray[np.float64]  # (3, 3) intrinsics
    rotation: NDArray[np.float64]  # (3, 3) of camera_T_object; object frame x forward, y down, z left
    translation: NDArray[np.float64]  # (3,) of camera_T_object, in diagonals of the car's box
    name: str = ""  # of the car's model, with the kind of its body, such as `Audi TTS Coupe 2012`; empty if unknown

    @property
    def shape(self) -> str:
        """Name of its shape: photographs with the same name show nearly the same shape."""
        return f"{self.cad_id} {self.name}".rstrip()

    @property
    def kind(self) -> int:
        """Number of its kind (`KINDS`), by its name; unknown for what is between two kinds: minivans and pickups."""
        words = set(self.name.split())
        if not words or words & {"Minivan", "Cab", "SuperCab", "Pickup"}:
            return UNKNOWN_KIND
        return KINDS.index("van" if "Van" in words else "car")

    @property
    def box(self) -> NDArray[np.float64]:
        """(4,) outline of the car x1, y1, x2, y2: the edges of the photograph, in pixels."""
        return np.array([-0.5, -0.5, self.size[0] - 0.5, self.size[1] - 0.5])

    @property
    def azimuth(self) -> float:
        """Direction from the car to the camera about the car's vertical axis, radians; 0 ahead, pi / 2 to its left."""
        return float(view_azimuth(self.rotation, self.translation))

    def silhouette(self, folder: Path) -> Path:
        """The file of its silhouette in a folder of them."""
        return folder / f"{self.image.stem}.png"

    def resized(self, scale: float, size: tuple[int, int], corner: ArrayLike = (-0.5, -0.5)) -> PosedCar:
        """The photograph resized by a factor, to so many pixels (width, height), from an upper left corner (2,) on."""
        u, v = -np.asarray(corner, dtype=np.float64) * scale - 0.5  # pixel centres are at integers
        to_image = np.array([[scale, 0.0, u], [0.0, scale, v], [0.0, 0.0, 1.0]])
        return replace(self, matrix=to_image @ self.matrix, size=size)

    def zoomed(self, factor: float) -> PosedCar:
        """The car from `factor` times the distance, in the same direction and as large in the image (a dolly zoom)."""
        matrix = self.matrix.copy()
        matrix[:2, :2] *= factor
        matrix[:2, 2] -= (factor - 1.0) * (self.project(np.zeros(3)) - self.matrix[:2, 2])
        return replace(self, matrix=matrix, translation=self.translation * factor)

    def project(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Pixels (..., 2) of points (..., 3) in the object frame."""
        camera = points @ self.rotation.T + self.translation
        return (camera @ self.matrix.T)[..., :2] / camera[..., 2:]


def read_posed_cars(folder: Path) -> list[PosedCar]:
    """Read the annotations of a folder; the images are not opened.

    Raises:
        InvalidInputError: The annotations are missing or malformed; names the field.
    """
    return [
        PosedCar(
            image=folder / "images" / fields.get("image", str),
            size=(fields.get("width", int), fields.get("height", int)),
            cad_id=fields.get("cad_id", str),
            matrix=fields.numbers("K", (3, 3)),
            rotation=_nearest_rotation(fields.numbers("R", (3, 3))),
            translation=fields.numbers("t", (3,)),
            name=fields.get("model_name", str) if "model_name" in fields else "",
        )
        for fields in read_records(folder / "annotations.json", "a list of photographs")
    ]


def read_validation_ids(path: Path) -> frozenset[str]:
    """Names of the shapes that are kept apart for validation.

    Raises:
        InvalidInputError: The file is not a list of names.
    """
    names = read_json(path)
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise InvalidInputError(str(path), type(names).__name__, "Give a list of names.")
    return frozenset(names)


def groups(cars: Sequence[PosedCar]) -> dict[str, list[int]]:
    """Indices of the photographs of each shape, by name in alphabetical order."""
    found: dict[str, list[int]] = {}
    for index, car in enumerate(cars):
        found.setdefault(car.shape, []).append(index)
    return dict(sorted(found.items()))


def _nearest_rotation(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """The file's six digits leave rotations slightly off."""
    u, _, vt = np.linalg.svd(matrix)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
