"""The surfaces that results files leave out, made again from prior, size and coefficients."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior
from fgrecon.io.catalogue import load_prior
from fgrecon.solve.vehicle.model import prepare

__all__ = ["Surfaces"]

_SAME = 2e-6
"""Metres by which wireframes may differ that were rounded to micrometres."""


class Surfaces:
    """Gives results their surfaces again.

    A result keeps its wireframe, so a prior that is not the one that it was solved with gives itself away: the result
    then stays without a surface, as where the prior is not to be found.
    """

    def __init__(self, settings: Mapping[str, Any], prior: ShapePrior | str | Path | None = None) -> None:
        """Find the prior.

        Args:
            settings: The results file's.
            prior: The prior; None for the one that the settings name.

        Raises:
            InvalidInputError: A prior was given that cannot be read, or the size prior is malformed.
        """
        size = settings.get("size_prior")
        self._size = None if size is None else SizePrior(size["name"], np.array(size["mean"]), np.array(size["sigma"]))
        self._prior = _found(settings) if prior is None else load_prior(prior)

    def complete(self, result: Reconstruction) -> Reconstruction:
        """The result with its surface, where that can be had and it has none yet."""
        count, prior = len(result.coefficients), self._prior
        if result.surface_vertices is not None or prior is None or prior.surface is None or count > prior.dimension:
            return result
        model = prepare(prior, self._size, None if count == prior.dimension else count).prior
        shape = model.keypoints(result.coefficients, result.offsets)
        if shape.shape != result.wireframe.shape or not np.abs(shape - result.wireframe).max() < _SAME:
            return result
        assert model.surface is not None
        vertices = model.surface.vertices(result.coefficients)
        return replace(result, surface_vertices=vertices, surface_faces=model.surface.triangles)


def _found(settings: Mapping[str, Any]) -> ShapePrior | None:
    """The prior that settings name; None where its file is gone."""
    try:
        return load_prior(settings.get("prior_file") or str(settings["prior"]))
    except InvalidInputError:
        return None
