"""What was fitted to a keypoint detector: how far to trust its keypoints together, and its directions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

from fgrecon.core.options import KeypointOptions, Options
from fgrecon.core.settings import check_settings, number

__all__ = ["DetectorCalibration"]

_DEFAULT = KeypointOptions()


@dataclass(frozen=True)
class DetectorCalibration:
    """Settings of `fgrecon.KeypointOptions` that belong to a detector, from vehicles whose boxes are known.

    Attributes:
        common_factor: By how much its keypoints and box say less than if their errors were independent.
        facing_bias: Of the log odds of a facing.
        facing_slope: What the detector's own log odds count.
        provenance: What it was fitted to, and how well it holds; plain values.
    """

    common_factor: float = number(_DEFAULT.common_factor, least=1.0)
    facing_bias: float = number(_DEFAULT.facing_bias, least=-20.0, most=20.0)
    facing_slope: float = number(_DEFAULT.facing_slope, least=0.0, most=20.0)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the numbers (`InvalidInputError`)."""
        check_settings(self, "calibration")

    @property
    def numbers(self) -> dict[str, float]:
        """The settings by name."""
        return {entry.name: getattr(self, entry.name) for entry in fields(self) if entry.name != "provenance"}

    def applied(self, options: Options) -> Options:
        """The options with these settings in the place of their own."""
        return replace(options, keypoints=replace(options.keypoints, **self.numbers, fitted=True))
