"""What can be set about a reconstruction, with the defaults and where they come from."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import ClassVar

import numpy as np

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.robust import RobustStrategy
from fgrecon.core.robust import strategy as named_strategy

__all__ = ["BoxModel", "Options"]


class BoxModel(StrEnum):
    """What a 2D box encloses."""

    SURFACE = "surface"
    """The vehicle's outline, as detectors draw it (the prior's surface; without one, its 3D box)."""
    CUBOID = "cuboid"
    """The projected corners of the vehicle's 3D box, as KITTI's labels and detectors trained on them have it."""
    OFF = "off"
    """The box places the start and scales the noise, but is no evidence."""


@dataclass(frozen=True)
class Options:
    """Settings of `fgrecon.reconstruct`.

    Attributes:
        strategy: Robust strategy, or its name (see `fgrecon.core.robust`).
        joint: Let pose and shape move together after the shape stage; else the pose stage's pose stays.
        free_offsets: Let each keypoint leave the subspace by a small offset with its own Gaussian prior.
        basis_vectors: Use the first so many basis vectors; None uses all.
        sigma_relative: Standard deviation of a keypoint per axis, as a fraction of the box's longer side: detector
            noise plus the difference between annotators' and models' idea of a keypoint (KITTI: 2 to 4 %).
        sigma_pixels: The same in pixels, added in quadrature: what even a large image leaves.
        confidence_midpoint: Confidence at which a point is as likely right as wrong; the probability of being right is
            c^2 / (c^2 + midpoint^2). Likelihood peaks of keypoint networks are underconfident; 0.1 to 0.3 do alike.
        box_model: What the 2D box encloses.
        box_sigma_relative: Standard deviation of a box edge as a fraction of the longer side.
        box_sigma_pixels: The same in pixels, added in quadrature.
        azimuths: Start azimuths of the pose search, evenly spaced.
        planarity_sigma: Distance of a keypoint from its face's plane, 1 sigma, metres.
        symmetry_sigma: Distance of a keypoint from its twin's mirror image, 1 sigma, metres.
        rectangularity_sigma: Deviation of a face from a rectangle, 1 sigma, metres.
        parallel_sigma: Angle between a ground-parallel face and the ground, 1 sigma, radians.
        laplacian_sigma: Deviation of a keypoint from its place among its neighbours, 1 sigma, metres.
        literal_laplacian: Take the paper's Laplacian literally: weights not normalised, residuals not relative to the
            mean shape's (`factors.laplacian` says what that does).
        plane_penalty: Weight mu of the penalty mu (1 - n'n)^2 on a plane's normal, square metres; None has unit normals
            by construction.
        disabled_terms: Names of energy terms to leave out (ablation): `planarity`, `symmetry`, `rectangularity`,
            `dimensions`, `laplacian`, `box`, `ground`. The size of a single vehicle is in the prior, not a term.
        ambiguity_margin: Energy (nats) within which another pose makes the result ambiguous.
        keep_history: Record every iteration.
    """

    strategy: RobustStrategy = field(default_factory=RobustStrategy)
    joint: bool = True
    free_offsets: bool = False
    basis_vectors: int | None = None
    sigma_relative: float = 0.035
    sigma_pixels: float = 1.0
    confidence_midpoint: float = 0.2
    box_model: BoxModel = BoxModel.SURFACE
    box_sigma_relative: float = 0.02
    box_sigma_pixels: float = 1.5
    azimuths: int = 24
    planarity_sigma: float = 0.03
    symmetry_sigma: float = 0.03
    rectangularity_sigma: float = 0.05
    parallel_sigma: float = 0.03
    laplacian_sigma: float = 0.5
    literal_laplacian: bool = False
    plane_penalty: float | None = None
    disabled_terms: frozenset[str] = frozenset()
    ambiguity_margin: float = 3.0
    keep_history: bool = True

    TERMS: ClassVar[tuple[str, ...]] = (
        "planarity",
        "symmetry",
        "rectangularity",
        "dimensions",
        "laplacian",
        "box",
        "ground",
    )

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidInputError: A setting is out of range.
        """
        for name, lowest in (
            ("sigma_relative", 0.0),
            ("box_sigma_relative", 0.0),
            ("ambiguity_margin", 0.0),
            ("sigma_pixels", 1e-3),
            ("box_sigma_pixels", 1e-3),
            ("confidence_midpoint", 1e-6),
            ("planarity_sigma", 1e-6),
            ("symmetry_sigma", 1e-6),
            ("rectangularity_sigma", 1e-6),
            ("parallel_sigma", 1e-6),
            ("laplacian_sigma", 1e-6),
        ):
            value = getattr(self, name)
            if not lowest <= value < np.inf:
                raise InvalidInputError(f"options.{name}", value, f"Give a finite number of at least {lowest}.")
        if self.basis_vectors is not None and self.basis_vectors < 0:
            raise InvalidInputError("options.basis_vectors", self.basis_vectors, "Give a number from 0, or None.")
        if self.plane_penalty is not None and not 0.0 < self.plane_penalty < np.inf:
            raise InvalidInputError("options.plane_penalty", self.plane_penalty, "Give a positive number, or None.")
        if not 1 <= self.azimuths <= 360:
            raise InvalidInputError("options.azimuths", self.azimuths, "Give a number from 1 to 360.")
        unknown = set(self.disabled_terms) - set(self.TERMS)
        if unknown:
            raise InvalidInputError("options.disabled_terms", sorted(unknown)[0], f"Use {', '.join(self.TERMS)}.")
        if self.box_model not in list(BoxModel):
            raise InvalidInputError("options.box_model", self.box_model, f"Use one of {', '.join(BoxModel)}.")
        object.__setattr__(self, "strategy", named_strategy(self.strategy))
        object.__setattr__(self, "box_model", BoxModel(self.box_model))
        object.__setattr__(self, "disabled_terms", frozenset(self.disabled_terms))
