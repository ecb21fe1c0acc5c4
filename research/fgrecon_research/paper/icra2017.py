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

Two images cannot tell settings apart, and some were chosen on them; docs/method.md says how sensitive the result is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Ground
from fgrecon.core.metrics import orientation_error
from fgrecon.core.options import BoxModel, BoxOptions, KeypointOptions, Options, SearchOptions, ShapeOptions
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.robust import StrategyName
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SIZE_PRIORS, SizePrior
from fgrecon.solve.pipeline import reconstruct
from fgrecon_research.paper.icra2017_release import Icra2017Example, import_icra2017, load_icra2017_example

Array = NDArray[np.float64]

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
        size: The fleet.
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


def evaluate_icra2017(
    folder: str | Path, options: Options | None = None, *, runs: int = 5, names: Sequence[str] = EXAMPLES
) -> list[Icra2017Result]:
    """Reconstruct the cars of the release's images.

    Args:
        folder: Folder of the release.
        options: Settings; `settings` where None.
        runs: How often each is timed.
        names: Which images.

    Raises:
        InvalidInputError: A file is missing or has the wrong content.
    """
    learnt = import_icra2017(folder)
    prior = with_sizes(replace(learnt, basis=_SPREAD * learnt.basis), SIZE_PRIORS["kitti"])
    options = settings() if options is None else options
    return [_evaluate(name, load_icra2017_example(folder, name), prior, options, runs) for name in names]


def true_pose(example: Icra2017Example) -> Array:
    """(4, 4) labelled pose in the colour camera's frame."""
    cosine, sine = np.cos(example.rotation_y), np.sin(example.rotation_y)
    pose = np.eye(4)
    pose[:3, :3] = [[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]]
    pose[:3, 3] = example.location + LABEL_OFFSET
    return pose


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
    return Icra2017Result(
        name=name,
        example=example,
        reconstruction=result,
        orientation_error=float(orientation_error([result.rotation_y], [example.rotation_y])[0]),
        centre_error=float(np.linalg.norm(_centre(result.camera_T_object, result.box_size) - _label_centre(example))),
        milliseconds={stage: min(times[stage] for times in timed) for stage in result.diagnostics.milliseconds}
        if timed
        else {},
    )


def _centre(camera_T_object: Array, size: Array) -> Array:
    """(3,) centre of a box standing on the object's origin, camera frame."""
    centre: Array = camera_T_object[:3, 3] - camera_T_object[:3, 1] * size[2] / 2.0
    return centre


def _label_centre(example: Icra2017Example) -> Array:
    return _centre(true_pose(example), example.size)
