"""The default car prior, learnt from the 79 metric car models of ApolloCar3D.

The models come as one npz file (`apollo79_car14.npz`: 14 keypoints located on every model, and the models' meshes in
one topology). They are under ApolloScape's terms and are not part of fgrecon; the prior learnt from them is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.checks import as_shape
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import MIRROR
from fgrecon.core.shape_prior import ShapePrior, Surface
from fgrecon.io.arrays import read_arrays
from fgrecon.io.catalogue import load_category
from fgrecon.solve.vehicle.conditioning import express
from fgrecon_research.training.priors.pca import SurfaceSamples, pca_prior

# A mesh topology that is exactly mirror-symmetric about z = 0, from one that is so only approximately.
#
# The left half is cut off along z = 0 of the mean shape and its mirror image becomes the right half. The cut is made
# once, in the topology: the same cut fits every shape, so linear models of the vertices stay linear.


_SEAM_WIDTH = 0.01  # metres; vertices nearer to z = 0 in the mean are moved onto it, which avoids slivers


@dataclass(frozen=True)
class SymmetricMesh:
    """Shapes in one topology that is its own mirror image."""

    vertices: Array  # (M, V, 3) vertices of each shape; z = 0 on the seam
    faces: NDArray[np.int32]  # (F, 3) triangles, the first half on the left (z >= 0)
    mirror: NDArray[np.intp]  # (V,) index of each vertex's mirror image; its own index on the seam


def mirrored_half(vertices: Array, faces: NDArray[np.int32]) -> SymmetricMesh:
    """Cut shapes (M, V, 3) of one topology (F, 3) along z = 0 of their mean and mirror the left half.

    Args:
        vertices: Vertices of each shape, nearly symmetric about z = 0, left is +z, metres.
    """
    height = vertices.mean(axis=0)[:, 2]
    height = np.where(np.abs(height) < _SEAM_WIDTH, 0.0, height)
    cuts: dict[tuple[int, int], int] = {}
    left = [part for face in faces for part in _clip(tuple(int(i) for i in face), height, cuts)]
    extended = np.concatenate([vertices, *(_cut_points(vertices, height, cuts))], axis=1)
    extended_height = np.concatenate([height, np.zeros(len(cuts))])
    used, index = np.unique(np.array(left), return_inverse=True)
    half = extended[:, used].copy()
    seam = extended_height[used] == 0.0
    half[:, seam, 2] = 0.0
    count = len(used)
    partner = np.arange(count)
    partner[~seam] = count + np.arange((~seam).sum())
    left_faces = index.reshape(-1, 3)
    right_faces = partner[left_faces][:, ::-1]  # the mirror image turns the other way round
    return SymmetricMesh(
        vertices=np.concatenate([half, half[:, ~seam] * MIRROR], axis=1),
        faces=np.concatenate([left_faces, right_faces]).astype(np.int32),
        mirror=np.concatenate([partner, np.flatnonzero(~seam)]),
    )


def _clip(face: tuple[int, ...], height: Array, cuts: dict[tuple[int, int], int]) -> list[tuple[int, int, int]]:
    """The part of a triangle with height >= 0, as 0 to 2 triangles; cut edges get new vertices, noted in `cuts`."""
    if (height[list(face)] > 0).sum() == 0:
        return []
    polygon: list[int] = []
    for a, b in zip(face, (*face[1:], face[0]), strict=True):
        if height[a] >= 0:
            polygon.append(a)
        if height[a] * height[b] < 0:
            edge = (min(a, b), max(a, b))
            polygon.append(cuts.setdefault(edge, len(height) + len(cuts)))
    return [(polygon[0], polygon[i], polygon[i + 1]) for i in range(1, len(polygon) - 1)]


def _cut_points(vertices: Array, height: Array, cuts: dict[tuple[int, int], int]) -> list[Array]:
    if not cuts:
        return []
    a, b = np.array(list(cuts)).T
    share = (height[a] / (height[a] - height[b]))[:, None]
    return [vertices[:, a] * (1 - share) + vertices[:, b] * share]


DUPLICATE = ("fengtian-puladuo-06", "guangqi-chuanqi-GS4-2015")
"""Two names of one and the same car: it is learnt from once, and held out by either name."""

_FILE = Path("apollo79") / "apollo79_car14.npz"
_ARRAYS = (
    *("car_names", "keypoints", "keypoints_mesh", "vertices", "faces", "mirror_vertex_ids", "mirror_bary"),
    *("dims", "body_width", "real_length_m", "scale_suspect"),
)
_DECIMALS = 6
"""The shipped prior is rounded to micrometres, so that another machine's linear algebra gives the same file."""


@dataclass(frozen=True)
class Apollo79:
    """The 79 car models, oversize ones brought to their real length. Object frame, metres."""

    names: tuple[str, ...]  # names of the models
    # (79, 14, 3) keypoints in the order of `car14`, located on every model, exactly symmetric
    keypoints: NDArray[np.float64]
    # (79, 14, 3) the same keypoints as fixed points of the common topology: 2 cm from `keypoints` on average, left and
    # right differ by 2 to 3 cm RMS
    keypoints_mesh: NDArray[np.float64]
    vertices: NDArray[np.float64]  # (79, 1352, 3) vertices of the meshes; the topology is not symmetric
    # (79, 1352, 3) the point that each vertex's mirror image about z = 0 should be: interpolated on the opposite side
    # of the same mesh and reflected
    mirrored: NDArray[np.float64]
    faces: NDArray[np.int32]  # (2700, 3) triangles, the same for all
    size: NDArray[np.float64]  # (79, 3) length, width without mirrors, and height of each model's box
    scale: NDArray[np.float64]  # (79,) factor by which the file's numbers were multiplied; 1 for all but four models

    def index(self, names: Sequence[str]) -> NDArray[np.intp]:
        """Indices of models by name.

        Raises:
            InvalidInputError: There is no model of that name.
        """
        for name in names:
            if name not in self.names:
                raise InvalidInputError("exclude", name, f"Use names of the models, such as {self.names[0]}.")
        return np.array([self.names.index(name) for name in names], dtype=np.intp)


def load_apollo79(path: str | Path) -> Apollo79:
    """Read the models from the npz file, or from the data folder that has it at `apollo79/apollo79_car14.npz`.

    Four models (`scale_suspect` in the file) are 10 to 17 % longer than the real car; they are divided by length over
    real length, keypoints and mesh alike.

    Raises:
        InvalidInputError: The file is missing, unreadable, or lacks an array.
    """
    path = Path(path)
    file = path / _FILE if path.is_dir() else path
    fix = "Give the folder with apollo79/apollo79_car14.npz, or that file."
    try:
        arrays = read_arrays(file, str(file), fix, _ARRAYS)
    except FileNotFoundError:
        raise InvalidInputError("data", str(file), fix) from None
    missing = [field for field in _ARRAYS if field not in arrays]
    if missing:
        raise InvalidInputError(f"{file}: {missing[0]}", "no such array", fix)
    size = np.column_stack([arrays["dims"][:, 0], arrays["body_width"], arrays["dims"][:, 2]])
    scale = np.where(arrays["scale_suspect"], arrays["real_length_m"] / size[:, 0], 1.0)
    vertices = arrays["vertices"].astype(np.float64)
    bary = arrays["mirror_bary"].astype(np.float64)
    image = np.einsum("mvca,vc->mva", vertices[:, arrays["mirror_vertex_ids"]], bary) * [1.0, 1.0, -1.0]
    return Apollo79(
        names=tuple(str(name) for name in arrays["car_names"]),
        keypoints=arrays["keypoints"] * scale[:, None, None],
        keypoints_mesh=arrays["keypoints_mesh"] * scale[:, None, None],
        vertices=vertices * scale[:, None, None],
        mirrored=image * scale[:, None, None],
        faces=arrays["faces"],
        size=size * scale[:, None],
        scale=scale,
    )


def apollo79_prior(
    models: Apollo79, basis: int = 5, exclude: Sequence[str] = (), weights: ArrayLike | None = None
) -> ShapePrior:
    """Learn the `car14` prior with surface from the models, without those named (for experiments on held-out cars).

    The keypoints located on every model are symmetric, and the surface is cut along the medial plane and mirrored, so
    that the prior is symmetric for every lambda.

    Args:
        exclude: Names of models not to learn from; either name of the car that has two takes it out.
        weights: (79,) how much each model counts, such as how frequent it is; equal by default.

    Raises:
        InvalidInputError: A name is unknown, or too few models are left.
    """
    keep = kept_models(models, exclude)
    return pca_prior(
        load_category("car14"),
        models.keypoints[keep],
        basis=basis,
        weights=None if weights is None else as_shape("weights", weights, (len(models.names),))[keep],
        surface=surface_samples(models, keep),
        name="car14",
        provenance={
            "source": f"{len(keep)} of the 79 car models of ApolloCar3D, 14 keypoints located on each",
            "terms": "ApolloScape terms (research); see the model card",
        },
    )


@dataclass(frozen=True)
class LeaveOneOut:
    """How well the first N vectors express a car that they were not learnt from (least-squares coefficients)."""

    basis: int  # number N of vectors
    explained: float  # fraction of the variance that they explain in the data itself
    keypoint_rms: float  # root mean square distance of a keypoint, metres
    keypoint_median: float  # median distance of a keypoint, metres
    vertex_rms: float  # root mean square distance of a vertex of the surface, metres


def leave_one_out(
    models: Apollo79, counts: Sequence[int], advance: Callable[[int, int], None] = lambda *_: None
) -> list[LeaveOneOut]:
    """Hold out each model in turn, learn the symmetric prior from the others, and express the one held out."""
    category = load_category("car14")
    keep = kept_models(models, ())
    shapes, samples, most = models.keypoints[keep], surface_samples(models, keep), max(counts)
    explained = np.cumsum(pca_prior(category, shapes, basis=most).explained)
    keypoint = np.zeros((len(counts), len(keep), category.size))
    vertex = np.zeros((len(counts), len(keep), samples.vertices.shape[1]))
    for i in range(len(keep)):
        rest = np.arange(len(keep)) != i
        surface = replace(samples, vertices=samples.vertices[rest])
        prior = pca_prior(category, shapes[rest], basis=most, surface=surface)
        for row, count in enumerate(counts):
            part = prior.truncated(count)
            coefficients, residual = express(part, shapes[i : i + 1])
            keypoint[row, i] = np.linalg.norm(residual[0], axis=1)
            if part.surface is not None:
                vertex[row, i] = np.linalg.norm(part.surface.vertices(coefficients[0]) - samples.vertices[i], axis=1)
        advance(i + 1, len(keep))
    return [
        LeaveOneOut(
            basis=count,
            explained=float(explained[count - 1]) if count else 0.0,
            keypoint_rms=float(np.sqrt((keypoint[row] ** 2).mean())),
            keypoint_median=float(np.median(keypoint[row])),
            vertex_rms=float(np.sqrt((vertex[row] ** 2).mean())),
        )
        for row, count in enumerate(counts)
    ]


def kept_models(models: Apollo79, exclude: Sequence[str]) -> NDArray[np.intp]:
    """Indices of the models to learn from: all but those named, and of the car with two names one.

    Raises:
        InvalidInputError: A name is unknown.
    """
    twice = [name for name in DUPLICATE if name in models.names]
    skip = {*exclude, *(twice if set(exclude) & set(twice) else twice[1:])}
    kept = np.ones(len(models.names), dtype=bool)
    kept[models.index(sorted(skip))] = False
    return np.flatnonzero(kept)


def surface_samples(models: Apollo79, keep: NDArray[np.intp]) -> SurfaceSamples:
    """Surfaces of some models, cut along the medial plane and mirrored."""
    mesh = mirrored_half((models.vertices[keep] + models.mirrored[keep]) / 2, models.faces)
    return SurfaceSamples(mesh.vertices, mesh.faces, mesh.mirror)


def rounded(prior: ShapePrior) -> ShapePrior:
    """The prior to the micrometre, its surface in single precision: what is shipped."""
    surface = prior.surface
    if surface is not None:
        mean, basis = (np.round(a, _DECIMALS).astype(np.float32) for a in (surface.mean, surface.basis))
        surface = Surface(mean.astype(np.float64), basis.astype(np.float64), surface.faces)
    fields = ("mean", "basis", "offset_sigma", "explained")
    arrays = {field: np.round(getattr(prior, field), _DECIMALS) + 0.0 for field in fields}
    return ShapePrior(prior.category, surface=surface, name=prior.name, provenance=prior.provenance, **arrays)
