"""Calibration of a keypoint detector: correlation of its keypoints' errors, and the weight of its directions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

from fgrecon.core.checks import as_instance
from fgrecon.core.options import BoxOptions, KeypointOptions, Options
from fgrecon.core.settings import check_settings, number

_DEFAULT = KeypointOptions()


@dataclass(frozen=True)
class BoxSource:
    """Where the edges of a vehicle detector's boxes lie, beside those of the outlines (`fgrecon.BoxOptions`)."""

    # by how much the left edge lies further right, as a fraction of the width
    left: float = number(BoxOptions().left, least=-0.5, most=0.5)
    # by how much the upper edge lies lower, as a fraction of the height
    upper: float = number(BoxOptions().upper, least=-0.5, most=0.5)
    right: float = number(BoxOptions().right, least=-0.5, most=0.5)  # the right edge, as the left one
    lower: float = number(BoxOptions().lower, least=-0.5, most=0.5)  # the lower edge, as the upper one
    # how far edges vary about that (1 sigma), as a fraction of the longer side. It is written and changes nothing:
    # boxes count by `BoxOptions.sigma_relative`
    spread: float = number(0.035, least=0.0, most=1.0)

    def __post_init__(self) -> None:
        """Check the numbers (`InvalidInputError`)."""
        check_settings(self, "calibration.boxes")

    def applied(self, options: Options) -> Options:
        """The options with these edges for boxes that are `detected`."""
        edges = {name: getattr(self, name) for name in ("left", "upper", "right", "lower")}
        return replace(options, box=replace(options.box, **edges))


@dataclass(frozen=True)
class DetectorCalibration:
    """Settings of `fgrecon.KeypointOptions` that belong to a detector, from vehicles whose boxes are known.

    Attributes:
        common_factor: By how much its keypoints and box say less than if their errors were independent; `cuboid`
            boxes count whole.
        facing_bias: Of the log odds of a facing.
        facing_slope: What the detector's own log odds count.
        provenance: What it was fitted to, and how well it holds; plain values.
        boxes: Where the edges of the boxes are that the keypoints were found in; None where that was not fitted.
    """

    common_factor: float = number(_DEFAULT.common_factor, least=1.0, most=1e6)
    facing_bias: float = number(_DEFAULT.facing_bias, least=-20.0, most=20.0)
    facing_slope: float = number(_DEFAULT.facing_slope, least=0.0, most=20.0)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    boxes: BoxSource | None = None

    def __post_init__(self) -> None:
        """Check the numbers (`InvalidInputError`)."""
        check_settings(self, "calibration")
        provenance = dict(as_instance("calibration.provenance", self.provenance, Mapping))
        object.__setattr__(self, "provenance", provenance)
        if self.boxes is not None:
            as_instance("calibration.boxes", self.boxes, BoxSource)

    @property
    def numbers(self) -> dict[str, float]:
        """The settings by name."""
        apart = ("provenance", "boxes")
        return {entry.name: getattr(self, entry.name) for entry in fields(self) if entry.name not in apart}

    def applied(self, options: Options) -> Options:
        """The options with these settings instead of their own; the default common factor counts as not fitted."""
        changed = options if self.boxes is None else self.boxes.applied(options)
        fitted = self.common_factor != _DEFAULT.common_factor
        return replace(changed, keypoints=replace(changed.keypoints, **self.numbers, fitted=fitted))
