"""Options of a reconstruction, with their defaults and sources."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

from factors.shape_factor import SHAPE_TERMS
from fgrecon.core.choices import BoxModel, StrategyName, TrafficSide
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.robust import RobustStrategy
from fgrecon.core.robust import strategy as named_strategy
from fgrecon.core.settings import check_settings, choice, choice_or_none, count, flag, number, one_of

__all__ = ["BoxModel", "BoxOptions", "KeypointOptions", "Options", "SearchOptions", "ShapeOptions", "checked_options"]

_HALF = 0.5  # of a box: an edge that is further off is none of it
_RELATIVE, _PIXELS = 10.0, 1e5  # of a box, pixels: what is known no better says nothing
_METRES = 1e3  # or radians: the same


@dataclass(frozen=True)
class KeypointOptions:
    """How exactly keypoints are where they are measured.

    Attributes:
        sigma_relative: Standard deviation of a keypoint per axis, as a fraction of the box's longer side: detector
            noise plus the difference between annotators' and models' idea of a keypoint (KITTI: 2 to 4 %).
        sigma_pixels: The same in pixels, added in quadrature: what even a large image leaves.
        least_confidence: Keypoints of less confidence are taken as not measured.
        common_factor: Where the detector gives covariances, by how much keypoints and box say less in the covariances
            of the result than if their errors were independent: those of one vehicle go together. A `cuboid` box is no
            detector's, and counts whole. It moves no result. The default was chosen on drives 0002, 0009, 0010 and 0095
            of KITTI's video, in labelled boxes (3 alone) and in detected ones (9): both together hold as much as they
            claim on the mean. Networks had not learnt from the drive.
        facing_bias: Of a result that faces where the detector's directions give probability p, the log odds to face
            the right way are this, and `facing_slope` times those of p. Both by maximum likelihood from 1,246 boxes of
            KITTI's video, each found by networks that had not learnt from its drive; fitted without a drive and tested
            on it: expected calibration error 0.005. `fgrecon calibrate` fits them to other detectors.
        facing_slope: See `facing_bias`.
        fitted: Whether the last three were fitted to the keypoints' detector (`DetectorCalibration.applied` sets it);
            results say so (`Reconstruction.uncertainty.regions`).
    """

    sigma_relative: float = number(0.035, least=0.0, most=_RELATIVE)
    sigma_pixels: float = number(1.0, least=1e-3, most=_PIXELS)
    least_confidence: float = number(0.0, least=0.0, most=1.0)
    common_factor: float = number(7.0, least=1.0, most=1e6)
    facing_bias: float = number(-0.390, least=-20.0, most=20.0)
    facing_slope: float = number(0.976, least=0.0, most=20.0)
    fitted: bool = flag(default=False)

    def __post_init__(self) -> None:
        """Check the settings (`InvalidInputError`)."""
        check_settings(self, "options.keypoints")


@dataclass(frozen=True)
class BoxOptions:
    """What the 2D box says.

    Attributes:
        model: What the box encloses.
        sigma_relative: Standard deviation of an edge as a fraction of the longer side.
        sigma_pixels: The same in pixels, added in quadrature.
        left: By how much the left edge of a `detected` box is further right than the outline's, as a fraction of its
            width. The defaults are those of the package's detector on KITTI's video.
        upper: By how much its upper edge is lower, as a fraction of its height.
        right: The right edge, as the left one.
        lower: The lower edge, as the upper one.
    """

    model: BoxModel = choice(BoxModel.SURFACE)
    sigma_relative: float = number(0.02, least=0.0, most=_RELATIVE)
    sigma_pixels: float = number(1.5, least=1e-3, most=_PIXELS)
    left: float = number(-0.034, least=-_HALF, most=_HALF)
    upper: float = number(0.014, least=-_HALF, most=_HALF)
    right: float = number(0.034, least=-_HALF, most=_HALF)
    lower: float = number(0.010, least=-_HALF, most=_HALF)

    def __post_init__(self) -> None:
        """Check the settings (`InvalidInputError`)."""
        check_settings(self, "options.box")

    @property
    def edges(self) -> tuple[float, float, float, float]:
        """`left`, `upper`, `right`, `lower`."""
        return self.left, self.upper, self.right, self.lower


@dataclass(frozen=True)
class SearchOptions:
    """The search for poses.

    Attributes:
        azimuths: Start azimuths, evenly spaced.
        basis_vectors: Move the first so many of the basis vectors that the factor graph has; with none the search
            places the mean shape.
    """

    azimuths: int = count(24, least=1, most=360)
    basis_vectors: int = count(0, least=0)

    def __post_init__(self) -> None:
        """Check the settings (`InvalidInputError`)."""
        check_settings(self, "options.search")


@dataclass(frozen=True)
class ShapeOptions:
    """The factor graph of pose and shape.

    Attributes:
        joint: Let pose and shape move together; else the proposal's pose stays.
        free_offsets: Let each keypoint leave the subspace by a small offset with its own Gaussian prior, the two of a
            pair by the same where symmetry is on.
        basis_vectors: Use the first so many basis vectors; None uses all.
        own_fleet: Where no fleet is given, the vehicles are of the prior's; else of any.
        planarity_sigma: Distance of a keypoint from its face's plane, 1 sigma, metres.
        symmetry_sigma: Distance of a keypoint from its twin's mirror image, 1 sigma, metres.
        rectangularity_sigma: Deviation of a face from a rectangle, 1 sigma, metres.
        parallel_sigma: Angle between a ground-parallel face and the ground, 1 sigma, radians.
        laplacian_sigma: Deviation of a keypoint from its place among its neighbours, 1 sigma, metres.
        literal_laplacian: Take the paper's Laplacian literally: weights not normalised, residuals not relative to the
            mean shape's (`factors.laplacian` says what that does).
        common_error: Share of an image's errors (their variance) that all images of one vehicle have in common: a
            detector mistakes the same car in the same way, and boxes are off alike. T images count for the shape as
            T / (1 + (T - 1) common_error) independent ones.
        plane_penalty: Weight mu of the penalty mu (1 - n'n)^2 on a plane's normal, square metres; None has unit normals
            by construction.
    """

    joint: bool = flag(default=True)
    free_offsets: bool = flag(default=True)
    basis_vectors: int | None = count(None, least=0)
    own_fleet: bool = flag(default=False)
    planarity_sigma: float = number(0.03, least=1e-6, most=_METRES)
    symmetry_sigma: float = number(0.01, least=1e-6, most=_METRES)
    rectangularity_sigma: float = number(0.01, least=1e-6, most=_METRES)
    parallel_sigma: float = number(0.03, least=1e-6, most=_METRES)
    laplacian_sigma: float = number(0.5, least=1e-6, most=_METRES)
    literal_laplacian: bool = flag(default=False)
    common_error: float = number(1.0, least=0.0, most=1.0)
    plane_penalty: float | None = number(None, least=1e-12, most=1e6)

    def __post_init__(self) -> None:
        """Check the settings (`InvalidInputError`)."""
        check_settings(self, "options.shape")


OFF = ("laplacian", "planarity")
"""Energy terms that are off by default (`docs/explanation/method.md` has what they cost)."""

_KINDS: dict[str, Any] = {
    "keypoints": KeypointOptions,
    "box": BoxOptions,
    "search": SearchOptions,
    "shape": ShapeOptions,
}


@dataclass(frozen=True, init=False)
class Options:
    """Settings of `fgrecon.reconstruct`, grouped by what they are about.

    Attributes:
        strategy: Robust strategy (see `fgrecon.core.robust`).
        keypoints: Noise of the keypoints.
        box: What the 2D box says.
        search: The search for poses.
        shape: The factor graph of pose and shape.
        disabled_terms: Names of energy terms to leave out, of `Options.TERMS`: by default those that did not help on
            cars of known shape. The size of a single vehicle is in the prior, not a term.
        ambiguity_margin: Energy (nats) within which another pose makes the result ambiguous.
        keep_history: Record every iteration.
        traffic: The side that traffic keeps to, where the camera looks along the road: says which way vehicles face,
            beside what the keypoints' detector says of that. None where nobody says.
    """

    strategy: RobustStrategy
    keypoints: KeypointOptions
    box: BoxOptions
    search: SearchOptions
    shape: ShapeOptions
    disabled_terms: frozenset[str]
    ambiguity_margin: float = number(3.0, least=0.0)
    keep_history: bool = flag(default=True)
    traffic: TrafficSide | None = choice_or_none(TrafficSide)

    TERMS: ClassVar[tuple[str, ...]] = (
        *(name for name in SHAPE_TERMS if name not in {"coefficients", "offsets"}),
        "box",
        "ground",
        "direction",
        "points",
        "depth",
        "range",
        "mask",
    )

    def __init__(
        self,
        *,
        strategy: RobustStrategy | StrategyName | str = StrategyName.MIXTURE,
        keypoints: KeypointOptions | None = None,
        box: BoxOptions | BoxModel | str | None = None,
        search: SearchOptions | None = None,
        shape: ShapeOptions | None = None,
        disabled_terms: Iterable[str] = OFF,
        ambiguity_margin: float = 3.0,
        keep_history: bool = True,
        traffic: TrafficSide | str | None = None,
    ) -> None:
        """Check the settings; None is a group's defaults.

        Args:
            strategy: Robust strategy, or its name.
            keypoints: Noise of the keypoints.
            box: What the 2D box says, or just what it encloses.
            search: The search for poses.
            shape: The factor graph of pose and shape.
            disabled_terms: Energy terms to leave out.
            ambiguity_margin: In nats.
            keep_history: Record every iteration.
            traffic: Side that traffic keeps to (`right`, `left`), or None.

        Raises:
            InvalidInputError: A setting has the wrong type or is out of range.
        """
        given = {"keypoints": keypoints, "box": box, "search": search, "shape": shape}
        settings = {
            "strategy": named_strategy(strategy),
            **{name: _group(name, value) for name, value in given.items()},
            "disabled_terms": _terms(disabled_terms),
            "ambiguity_margin": ambiguity_margin,
            "keep_history": keep_history,
            "traffic": traffic,
        }
        for name, value in settings.items():
            object.__setattr__(self, name, value)
        check_settings(self, "options")


def checked_options(options: Options | None, *, joint: bool = False) -> Options:
    """The options, or the defaults for None.

    Args:
        options: As they are given.
        joint: Whether pose and shape have to move together.

    Raises:
        InvalidInputError: They are none, or have `joint` off where it is needed.
    """
    if options is None:
        return Options()
    if not isinstance(options, Options):
        raise InvalidInputError("options", options, "Give an `fgrecon.Options`.")
    if joint and not options.shape.joint:
        raise InvalidInputError("options.shape.joint", value=False, fix="Let pose and shape move: joint=True.")
    return options


@cache
def _defaults(kind: type) -> Any:
    """A group's defaults, which nobody can change."""
    return kind()


def _group(name: str, value: Any) -> Any:
    kind = _KINDS[name]
    if value is None:
        return _defaults(kind)
    if kind is BoxOptions and isinstance(value, str):
        return BoxOptions(model=one_of(BoxModel, "options.box", value))
    if not isinstance(value, kind):
        raise InvalidInputError(f"options.{name}", value, f"Give `{kind.__name__}`, or None for its defaults.")
    return value


def _terms(value: Iterable[str]) -> frozenset[str]:
    fix = f"Give names of terms: {', '.join(Options.TERMS)}."
    if isinstance(value, str) or not isinstance(value, Iterable):
        raise InvalidInputError("options.disabled_terms", value, fix)
    names = list(value)
    for name in names:
        if name not in Options.TERMS:
            raise InvalidInputError("options.disabled_terms", name, fix)
    return frozenset(names)
