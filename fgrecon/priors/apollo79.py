"""The default car prior, learnt from the 79 metric car models of ApolloCar3D.

The models come as one npz file (`apollo79_car14.npz`: 14 keypoints located on every model, and the models' meshes in
one topology). They are under ApolloScape's terms and are not part of fgrecon; the prior learnt from them is.
"""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.catalogue import load_category
from fgrecon.errors import InvalidInputError
from fgrecon.priors.half_mesh import mirrored_half
from fgrecon.priors.pca import SurfaceSamples, pca_prior
from fgrecon.priors.shape_prior import ShapePrior, Surface

__all__ = ["DUPLICATE", "Apollo79", "apollo79_prior", "load_apollo79"]

DUPLICATE = ("fengtian-puladuo-06", "guangqi-chuanqi-GS4-2015")
"""Two names of one and the same car: hold both out together. The second is never learnt from."""

_FILE = Path("apollo79") / "apollo79_car14.npz"
_ARRAYS = (
    *("car_names", "keypoints", "vertices", "faces", "mirror_vertex_ids", "mirror_bary"),
    *("dims", "body_width", "real_length_m", "scale_suspect"),
)
_DECIMALS = 6
"""The shipped prior is rounded to micrometres, so that another machine's linear algebra gives the same file."""


@dataclass(frozen=True)
class Apollo79:
    """The 79 car models, oversize ones brought to their real length. Object frame, metres.

    Attributes:
        names: Names of the models.
        keypoints: (79, 14, 3) keypoints in the order of `car14`, exactly symmetric.
        vertices: (79, 1352, 3) vertices of the meshes, symmetric in shape but not in topology.
        faces: (2700, 3) triangles, the same for all.
        size: (79, 3) length, width without mirrors, and height of each model's box.
        scale: (79,) factor by which the file's numbers were multiplied; 1 for all but four models.
    """

    names: tuple[str, ...]
    keypoints: NDArray[np.float64]
    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    size: NDArray[np.float64]
    scale: NDArray[np.float64]

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
    real length, keypoints and mesh alike. Vertices are averaged with the mirror image of the mesh.

    Raises:
        InvalidInputError: The file is missing, unreadable, or lacks an array.
    """
    path = Path(path)
    file = path / _FILE if path.is_dir() else path
    fix = "Give the folder with apollo79/apollo79_car14.npz, or that file."
    try:
        with np.load(file, allow_pickle=False) as archive:
            missing = [field for field in _ARRAYS if field not in archive.files]
            if missing:
                raise InvalidInputError(f"{file}: {missing[0]}", "no such array", fix)
            arrays = {field: archive[field] for field in _ARRAYS}
    except FileNotFoundError:
        raise InvalidInputError("data", str(file), fix) from None
    except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        if isinstance(error, InvalidInputError):
            raise
        raise InvalidInputError(str(file), f"unreadable: {error}", fix) from error
    size = np.column_stack([arrays["dims"][:, 0], arrays["body_width"], arrays["dims"][:, 2]])
    scale = np.where(arrays["scale_suspect"], arrays["real_length_m"] / size[:, 0], 1.0)
    vertices = arrays["vertices"].astype(np.float64)
    bary = arrays["mirror_bary"].astype(np.float64)
    image = np.einsum("mvca,vc->mva", vertices[:, arrays["mirror_vertex_ids"]], bary) * [1.0, 1.0, -1.0]
    return Apollo79(
        names=tuple(str(name) for name in arrays["car_names"]),
        keypoints=arrays["keypoints"] * scale[:, None, None],
        vertices=(vertices + image) / 2 * scale[:, None, None],
        faces=arrays["faces"],
        size=size * scale[:, None],
        scale=scale,
    )


def apollo79_prior(
    path: str | Path | Apollo79, basis: int = 5, exclude: Sequence[str] = (), symmetric: bool = True
) -> ShapePrior:
    """Learn the `car14` prior with surface from the models, without those named (for experiments on held-out cars).

    The second name of the one car that is there twice is always left out, and with the first name the car itself.

    Args:
        path: The npz file, the data folder, or the models as loaded.
        basis: Number of basis vectors.
        exclude: Names of models not to learn from.
        symmetric: Whether to impose left-right symmetry. The keypoints of the models are symmetric, so that without
            it the prior's keypoints are the same up to round-off and the surface keeps the original topology.

    Raises:
        InvalidInputError: The file cannot be used, a name is unknown, or too few models are left.
    """
    models = path if isinstance(path, Apollo79) else load_apollo79(path)
    skip = set(models.index(exclude).tolist()) | set(models.index(DUPLICATE[1:]).tolist())
    keep = [i for i in range(len(models.names)) if i not in skip]
    vertices, faces = models.vertices[keep], models.faces
    if symmetric:
        mesh = mirrored_half(vertices, faces)
        samples = SurfaceSamples(mesh.vertices, mesh.faces, mesh.mirror)
    else:
        samples = SurfaceSamples(vertices, faces)
    return pca_prior(
        load_category("car14"),
        models.keypoints[keep],
        basis=basis,
        symmetric=symmetric,
        surface=samples,
        name="car14",
        provenance={
            "source": f"{len(keep)} of the 79 car models of ApolloCar3D, 14 keypoints located on each",
            "terms": "ApolloScape terms (research); see the model card",
        },
    )


def rounded(prior: ShapePrior) -> ShapePrior:
    """The prior to the micrometre, its surface in single precision: what is shipped."""
    surface = prior.surface
    if surface is not None:
        mean, basis = (np.round(a, _DECIMALS).astype(np.float32) for a in (surface.mean, surface.basis))
        surface = Surface(mean.astype(np.float64), basis.astype(np.float64), surface.faces)
    fields = ("mean", "basis", "offset_sigma", "explained")
    arrays = {field: np.round(getattr(prior, field), _DECIMALS) + 0.0 for field in fields}
    return ShapePrior(prior.category, surface=surface, name=prior.name, provenance=prior.provenance, **arrays)
