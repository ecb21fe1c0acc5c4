"""How a reconstruction ends, and what its covariances rest on."""

from __future__ import annotations

from enum import StrEnum

__all__ = ["Regions", "Status"]


class Status(StrEnum):
    """How a reconstruction ended."""

    CONVERGED = "converged"
    WEAK = "weak"
    """It converged, but little carries it, or it is at odds with what was told: see `reasons`."""
    AMBIGUOUS = "ambiguous"
    """Another pose explains the keypoints nearly as well (see `alternatives`), or another focal length the image."""
    DEGENERATE = "degenerate"
    """The keypoints leave a direction undetermined, or nearly so: see `message` and the covariances."""
    FAILED = "failed"
    """The optimisation gave up, and this is the state before: see `message`."""

    @property
    def settled(self) -> bool:
        """Whether one pose was found, and a minimum there."""
        return self in (Status.CONVERGED, Status.WEAK)

    @property
    def determined(self) -> bool:
        """Whether the keypoints determine a pose, be it one of several."""
        return self.settled or self is Status.AMBIGUOUS


class Regions(StrEnum):
    """What the covariances of a result rest on."""

    ASSUMED = "assumed"
    """The keypoints bring none: errors of `KeypointOptions.sigma_relative` and `sigma_pixels` are assumed."""
    SHIPPED = "shipped"
    """Those of the keypoints, counted as the shipped networks' are (`KeypointOptions.common_factor`)."""
    FITTED = "fitted"
    """Those of the keypoints, counted as `fgrecon calibrate` found for their detector."""
