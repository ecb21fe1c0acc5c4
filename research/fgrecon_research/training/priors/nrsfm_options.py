"""How NRSfM is to learn, and what it tells while it does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from fgrecon.core.errors import InvalidInputError

__all__ = ["NrsfmOptions", "NrsfmProgress", "ProgressCallback"]


@dataclass(frozen=True)
class NrsfmOptions:
    """How to learn.

    Attributes:
        basis: Number N of basis vectors.
        symmetric: Keep mean and basis mirror-symmetric (the category's pairs); without pairs nothing is imposed.
        perspective: Estimate the cameras' common distance and take perspective out of the annotations to first order;
            else it appears as a mode that tells front from rear views.
        dof: Degrees of freedom of Student's t noise, which bears wrong annotations; None for Gaussian noise.
        restricted: Estimate noise and shape by the restricted likelihood, which allows for the fitted cameras; else
            by the plain likelihood of Torresani et al.
        min_visible: Images with fewer annotated keypoints are left out.
        restarts: Random starts; the one that ends at the best likelihood is kept.
        iterations: Most EM iterations of the last stage.
        tolerance: It ends when the bound rises by less, in nats per keypoint and iteration.
        start_images: Restarts use at most so many images.
        rotations: Starts of the global search for each camera.
        seed: Seed of everything random.
        bootstrap: Draws of the vehicles by which the mean's standard deviation is estimated; 0 for none. They change
            nothing else.
    """

    basis: int = 5
    symmetric: bool = True
    perspective: bool = False
    dof: float | None = 2.0
    restricted: bool = True
    min_visible: int = 8
    restarts: int = 3
    iterations: int = 600
    tolerance: float = 5e-6
    start_images: int = 2000
    rotations: int = 24
    seed: int = 0
    bootstrap: int = 12

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidInputError: A number is out of its range.
        """
        for field, lowest in (("basis", 0), ("min_visible", 4), ("restarts", 1), ("iterations", 2), ("rotations", 0)):
            if getattr(self, field) < lowest:
                raise InvalidInputError(f"options.{field}", getattr(self, field), f"Give at least {lowest}.")
        if self.bootstrap < 0 or self.bootstrap == 1:
            raise InvalidInputError("options.bootstrap", self.bootstrap, "Give 0, or 2 draws and more.")
        if self.dof is not None and not self.dof > 0:
            raise InvalidInputError("options.dof", self.dof, "Give a positive number, or None for Gaussian noise.")
        if not self.tolerance > 0:
            raise InvalidInputError("options.tolerance", self.tolerance, "Give a positive number.")


@dataclass(frozen=True)
class NrsfmProgress:
    """How far learning has come.

    Attributes:
        stage: What is being done, in words.
        fraction: Share of all the work that is behind, an estimate.
        iteration: Iteration within the stage.
        bound: Log likelihood (or its lower bound) per keypoint, nats.
    """

    stage: str
    fraction: float
    iteration: int
    bound: float


ProgressCallback = Callable[[NrsfmProgress], None]
