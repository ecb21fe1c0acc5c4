"""The two worked images of the paper's authors' public release: our pose against the label, and both to be drawn.

What the release gives is used as it is: 36 network keypoints (their third number says nothing about the error, so there
is no confidence), the 2D box, a first guess of the azimuth, and the prior of 42 basis vectors. What is assumed beyond:

- **Noise.** Half a cell of the network's 64 x 64 grid over the box (its step), which is far finer in height than in
  width, and a pixel.
- **Box.** The projected 3D box, as KITTI's labels have it, to 2 pixels; the release's boxes are such.
- **Ground.** The car stands upright (0.6 degrees) on a level ground 1.65 m below the camera (0.1 m).
- **Size.** KITTI's cars: their mean and their spread of length, width and height take the place of the prior's own,
  which was learnt from normalised shapes; the rest of the prior's spread is three times as wide as learnt, since the
  shape must also take up the network's own idea of where a keypoint is.
- **Robust loss.** Huber: there is no confidence to tell wrong keypoints by, and no gross ones among the visible.

Two images cannot tell settings apart, and some were chosen on them; docs/explanation/method.md says how sensitive the
result is.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import MIRROR, rigid, yaw_rotation
from fgrecon.core.metrics import orientation_error
from fgrecon.core.observation import Observation
from fgrecon.core.options import BoxModel, BoxOptions, KeypointOptions, Options, SearchOptions, ShapeOptions
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.robust import StrategyName
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SIZE_PRIORS, SizePrior
from fgrecon.io.catalogue import load_category
from fgrecon.solve.pipeline import reconstruct

# The paper's authors' public release: their 36-point shape prior and two worked images, brought to our conventions.
#
# Nothing of the release comes with fgrecon. What its files mean was worked out from the files themselves and is checked
# by the tests against 79 real car models and the two labelled images:
#
# - **Side.** Points 1-18 are the vehicle's left (seen by the network in the image that shows a left side), 19-36 their
#   mirror images. The order is that of the category `car36`.
# - **Axes** of the mean shape: x forward, y up, z right.
# - **Basis.** Each row of `basisVectors.txt` is a unit vector of 36 x 3 numbers, point after point (x1 y1 z1 x2 ...).
# - **Coefficients.** `shapeCoefficientsInitial.txt` holds the variances (eigenvalues) along the vectors, not their
#   standard deviations: with the square root, real cars have coefficients of RMS 1.1 in the first ten vectors, with the
#   numbers as they are 23.
# - **Scale.** The mean shape has its own proportions; each axis is scaled so that the box is the authors' average car
#   (3.86 x 1.6362 x 1.5208 m). Their demo takes width and height from each other's columns, which is not repeated.
# - **Azimuth** is KITTI's rotation_y in radians. The visibility table is indexed by the degrees of *minus* the angle of
#   observation: its row 90 shows a rear.


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


EXAMPLES = ("01", "02")
"""The release's images."""

LABEL_OFFSET = np.array([0.0599, -0.0004, 0.0027])
"""From the frame of KITTI's labels to the colour camera's: K^-1 P2[:, 3] of both sequences, metres."""

GROUND = Ground(np.array([0.0, 1.0, 0.0]), 1.65, height_sigma=0.1, slope_sigma=1e-4, tilt_sigma=0.01)
_NOISE_CELLS = 0.5
_SPREAD = 3.0


@dataclass(frozen=True)
class Icra2017Result:
    """Our result on one image."""

    name: str  # name of the image
    example: Icra2017Example  # what was given
    reconstruction: Reconstruction  # what came out
    orientation_error: float  # difference from the labelled yaw, degrees
    centre_error: float  # distance between the centres of the estimated and the labelled box, metres
    milliseconds: dict[str, float]  # wall time of the stages, the best of several runs


def settings() -> Options:
    """The settings that the module describes."""
    return Options(
        strategy=StrategyName.HUBER,
        keypoints=KeypointOptions(sigma_relative=0.0),
        box=BoxOptions(BoxModel.CUBOID, sigma_relative=0.0, sigma_pixels=2.0),
        # 42 vectors leave nothing for offsets, and this prior is not symmetric. The search moves them as well.
        search=SearchOptions(basis_vectors=42),
        shape=ShapeOptions(free_offsets=False, own_fleet=True, symmetry_sigma=0.03, rectangularity_sigma=0.05),
        disabled_terms=["laplacian"],
    )


def with_sizes(prior: ShapePrior, size: SizePrior) -> ShapePrior:
    """The prior with a fleet's mean size and spread of sizes instead of its own.

    The three directions of lambda that change length, width and height are rescaled and turned among themselves until
    N(0, I) gives the fleet's spread; the directions that leave the size alone stay as they are.

    Args:
        prior: A prior of at least three basis vectors that change length, width and height independently.
    """
    prior = prior.for_fleet(size)
    change = np.tensordot(prior.category.dimension_operator, prior.basis, axes=((1, 2), (1, 2)))  # (3, N)
    own = np.linalg.cholesky(change @ change.T)
    directions = np.linalg.solve(own, change)  # orthonormal rows
    mix = np.eye(prior.dimension) + directions.T @ (np.linalg.solve(own, np.diag(size.sigma)) - np.eye(3)) @ directions
    surface = prior.surface
    if surface is not None:
        surface = replace(surface, basis=np.einsum("nva,nm->mva", surface.basis, mix))
    return replace(prior, basis=np.einsum("nka,nm->mka", prior.basis, mix), surface=surface)


def evaluate_icra2017(folder: str | Path, *, runs: int = 5, names: Sequence[str] = EXAMPLES) -> list[Icra2017Result]:
    """Reconstruct the cars of the release's images.

    Raises:
        InvalidInputError: A file is missing or has the wrong content.
    """
    learnt = import_icra2017(folder)
    prior = with_sizes(replace(learnt, basis=_SPREAD * learnt.basis), SIZE_PRIORS["kitti"])
    return [_evaluate(name, load_icra2017_example(folder, name), prior, settings(), runs) for name in names]


def true_pose(example: Icra2017Example) -> Array:
    """(4, 4) labelled pose in the colour camera's frame."""
    return rigid(yaw_rotation(example.rotation_y), example.location + LABEL_OFFSET)


def _evaluate(name: str, example: Icra2017Example, prior: ShapePrior, options: Options, runs: int) -> Icra2017Result:
    observation = example.observation
    covariance = np.diag(np.square(_NOISE_CELLS * example.cell))

    def solve(history: bool) -> Reconstruction:
        return reconstruct(
            observation.keypoints,
            example.camera,
            box=observation.box,
            covariance=np.broadcast_to(covariance, (len(observation.keypoints), 2, 2)),
            prior=prior,
            ground=GROUND,
            initial=example.azimuth,
            options=replace(options, keep_history=history),
        )

    timed = [solve(history=False).diagnostics.milliseconds for _ in range(runs)]
    result = solve(history=True)
    labelled = _centre(true_pose(example), example.size)
    return Icra2017Result(
        name=name,
        example=example,
        reconstruction=result,
        orientation_error=float(orientation_error([result.rotation_y], [example.rotation_y])[0]),
        centre_error=float(np.linalg.norm(_centre(result.camera_T_object, result.box_size) - labelled)),
        milliseconds={stage: min(times[stage] for times in timed) for stage in result.diagnostics.milliseconds}
        if timed
        else {},
    )


def _centre(camera_T_object: Array, size: Array) -> Array:
    """(3,) centre of a box standing on the object's origin, camera frame."""
    return camera_T_object[:3, 3] - camera_T_object[:3, 1] * size[2] / 2.0
