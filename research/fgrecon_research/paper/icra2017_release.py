"""The paper's authors' public release: their 36-point shape prior and two worked images, brought to our conventions.

Nothing of the release comes with fgrecon. What its files mean was worked out from the files themselves and is checked
by the tests against 79 real car models and the two labelled images:

- **Side.** Points 1-18 are the vehicle's left (seen by the network in the image that shows a left side), 19-36 their
  mirror images. The order is that of the category `car36`.
- **Axes** of the mean shape: x forward, y up, z right.
- **Basis.** Each row of `basisVectors.txt` is a unit vector of 36 x 3 numbers, point after point (x1 y1 z1 x2 ...).
- **Coefficients.** `shapeCoefficientsInitial.txt` holds the variances (eigenvalues) along the vectors, not their
  standard deviations: with the square root, real cars have coefficients of RMS 1.1 in the first ten vectors, with the
  numbers as they are 23.
- **Scale.** The mean shape has its own proportions; each axis is scaled so that the box is the authors' average car
  (3.86 x 1.6362 x 1.5208 m). Their demo takes width and height from each other's columns, which is not repeated.
- **Azimuth** is KITTI's rotation_y in radians. The visibility table is indexed by the degrees of *minus* the angle of
  observation: its row 90 shows a rear.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import MIRROR
from fgrecon.core.observation import Observation
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.io.catalogue import load_category

Array = NDArray[np.float64]

AVERAGE_CAR = SizePrior("icra2017", np.array([3.86, 1.6362, 1.5208]), np.array([0.44, 0.11, 0.14]))
"""The authors' average car, with the spreads of KITTI's labels."""

_POINTS, _VECTORS, _CELLS = 36, 42, 64
_TO_OBJECT = np.array([1.0, -1.0, -1.0])
_MIDPOINT = -0.007
"""Midpoint between the keypoints of front and rear, ahead of the box's centre, divided by the box's length: mean over
78 car models (standard deviation 0.009)."""


@dataclass(frozen=True)
class Icra2017Example:
    """One of the two images of the release, with what is known about the car in it."""

    # 36 keypoints and the box, in pixels. Every confidence is 1: the network's third number says nothing about the
    # error.
    observation: Observation
    camera: Camera  # the intrinsics that the release gives
    azimuth: float  # first guess of rotation_y, radians
    cell: Array  # (2,) width and height of one cell of the network's 64 x 64 grid in pixels: what it resolves
    image: Path  # the photograph
    # (3,) labelled centre of the box's bottom face in the frame of KITTI's labels, metres. The colour camera's frame,
    # to which keypoints and `camera` belong, has it 6 cm further to the right.
    location: Array
    rotation_y: float  # labelled yaw, radians
    size: Array  # (3,) labelled length, width and height, metres


def import_icra2017(folder: str | Path) -> ShapePrior:
    """Bring the release's 36-point prior into the object frame, with lambda ~ N(0, I) and metres.

    Args:
        folder: Folder with `meanShape.txt`, `basisVectors.txt` and `shapeCoefficientsInitial.txt`.

    Returns:
        A symmetric `car36` prior with 42 basis vectors and a box of the authors' average car; use
        `ShapePrior.for_fleet` for another size. `explained` is relative to the variance within the 42 vectors.
        `offset_sigma` bounds what they leave out: 12 directions of at most the last vector's variance.

    Raises:
        InvalidInputError: A file is missing or has the wrong content; names it.
    """
    folder = Path(folder)
    category = load_category("car36")
    mean = _numbers(folder / "meanShape.txt", (_POINTS, 3)) * _TO_OBJECT
    basis = _numbers(folder / "basisVectors.txt", (_VECTORS, _POINTS * 3)).reshape(_VECTORS, _POINTS, 3) * _TO_OBJECT
    variance = _numbers(folder / "shapeCoefficientsInitial.txt", (_VECTORS,))
    if (variance <= 0).any():
        raise InvalidInputError(
            str(folder / "shapeCoefficientsInitial.txt"), variance.min(), "Give the release's file."
        )
    # The files are symmetric to their six decimals.
    mean = (mean + mean[category.mirror] * MIRROR) / 2
    basis = (basis + basis[:, category.mirror] * MIRROR) / 2 * np.sqrt(variance)[:, None, None]
    size = np.tensordot(category.dimension_operator, mean, axes=2)
    length, width, height = AVERAGE_CAR.mean / size
    scale = np.array([length, height, width])
    mean = mean * scale
    left_out = _POINTS * 3 // 2 - _VECTORS
    sigma = np.sqrt(variance.min() * left_out / (_POINTS * 3)) * float(np.cbrt(scale.prod()))
    return ShapePrior(
        category=category,
        mean=mean - _origin(mean),
        basis=basis * scale,
        offset_sigma=np.full(_POINTS, sigma),
        explained=variance / variance.sum(),
        name="icra2017",
        provenance={
            "source": "public release of Krishna Murthy et al., ICRA 2017 (36 points, 42 vectors)",
            "terms": "the authors' and KITTI's; not part of fgrecon",
            "method": "imported; scaled per axis to the authors' average car",
        },
    )


def load_icra2017_example(folder: str | Path, name: str) -> Icra2017Example:
    """Read one of the release's two images, `01` or `02`.

    Keypoints come in cells of a 64 x 64 grid over the box, counted from one as the authors' demo does:
    u = x - 1 + k w / 64.

    Raises:
        InvalidInputError: A file is missing or has the wrong content; names it.
    """
    folder = Path(folder)
    example = folder / "examples" / name
    x, y, width, height = _numbers(example / "bbox.txt", (4,))
    cell = np.array([width, height]) / _CELLS
    cells = _numbers(example / "keypoints.txt", (_POINTS * 3,)).reshape(_POINTS, 3)[:, :2]
    truth = _truth(folder / "examples" / "ground_truth.json", name)
    return Icra2017Example(
        observation=Observation(
            keypoints=np.array([x, y]) - 1 + cells * cell,
            confidence=np.ones(_POINTS),
            box=np.array([x, y, x + width, y + height]),
        ),
        camera=Camera(_numbers(folder / "intrinsics.txt", (3, 3))),
        azimuth=float(_numbers(example / "azimuth.txt", ())),
        cell=cell,
        image=example / "image.png",
        location=np.array(truth["location"], dtype=np.float64),
        rotation_y=float(truth["rotation_y"]),
        size=np.array([truth["length"], truth["width"], truth["height"]], dtype=np.float64),
    )


def _origin(mean: Array) -> Array:
    """Centre of the bottom face of the box that belongs to the mean keypoints."""
    category = load_category("car36")
    length, _, height = AVERAGE_CAR.mean
    along = category.dimensions[0]
    middle = (mean[list(along.plus), 0].mean() + mean[list(along.minus), 0].mean()) / 2
    wheels = mean[list(category.ground_keypoints), 1].mean()
    return np.array([middle - _MIDPOINT * length, wheels + category.ground_ratio * height, 0.0])


def _numbers(file: Path, shape: tuple[int, ...]) -> Array:
    fix = "Give the folder of the authors' release (data/icra2017)."
    try:
        numbers = np.array([float(word) for word in file.read_text().split()])
    except OSError as error:
        raise InvalidInputError(str(file), error.strerror or str(error), fix) from error
    except ValueError as error:
        raise InvalidInputError(str(file), f"no numbers: {error}", fix) from error
    if numbers.size != np.prod(shape) or not np.isfinite(numbers).all():
        raise InvalidInputError(str(file), f"{numbers.size} numbers", f"It should hold {int(np.prod(shape))}. {fix}")
    return numbers.reshape(shape)


def _truth(file: Path, name: str) -> Mapping[str, Any]:
    try:
        entry: Mapping[str, Any] = json.loads(file.read_text())[name]
    except OSError as error:
        raise InvalidInputError(str(file), error.strerror or str(error), "Give the release's folder.") from error
    except (ValueError, KeyError) as error:
        raise InvalidInputError(str(file), f"no entry {name}", "Use 01 or 02.") from error
    return entry
