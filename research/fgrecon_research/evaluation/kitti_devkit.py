"""KITTI's own measures: average precision (2D, bird's eye, 3D) and average orientation similarity.

The rules are those of the official object evaluation (2017, with the minimum-height fix): an object of the class, or of
its neighbouring class (Van for Car, Person_sitting for Pedestrian), that a regime leaves out may be found or missed
without consequence, and so may a detection below the regime's minimum height; a detection that lies in a `DontCare`
area by more than the least overlap is no false positive. Scores of the true positives give up to 41 thresholds at
evenly spaced recall, and at each of them labels are matched in the order of the file, each to the free detection of
largest overlap.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import shapely
from numpy.typing import NDArray

from fgrecon.calibration.labelled_boxes import MINIMUM_OVERLAP, box_overlap, shared_ratio
from fgrecon.core.arrays import Array
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.kitti_files import Objects


class Space(StrEnum):
    """Where overlaps are measured."""

    IMAGE = "image"
    GROUND = "ground"
    """Bird's eye view: the boxes' footprints."""
    VOLUME = "3d"


def overlap(space: Space, first: Objects, second: Objects, *, of_first: bool = False) -> Array:
    """Overlap (M, N) of every object with every other.

    Args:
        space: Where.
        of_first: Divide the intersection by the first object's own extent instead of the union.
    """
    if space is Space.IMAGE:
        return box_overlap(first.box, second.box, of_first=of_first)
    extent_first, extent_second = (objects.size[:, 0] * objects.size[:, 1] for objects in (first, second))
    inner = _footprint_intersection(first, second)
    if space is Space.VOLUME:
        top = np.maximum((first.location[:, 1] - first.size[:, 2])[:, None], second.location[:, 1] - second.size[:, 2])
        bottom = np.minimum(first.location[:, None, 1], second.location[:, 1])
        inner = inner * np.maximum(bottom - top, 0.0)
        extent_first, extent_second = extent_first * first.size[:, 2], extent_second * second.size[:, 2]
    return shared_ratio(inner, extent_first, extent_second, of_first=of_first)


def _footprint_intersection(first: Objects, second: Objects) -> Array:
    """Areas (M, N) that footprints share; none of an object without extent."""
    corners = [shapely.polygons(_footprints(objects)) for objects in (first, second)]
    solid = np.all(first.size > 0, axis=1)[:, None] & np.all(second.size > 0, axis=1)[None]
    return np.where(solid, shapely.area(shapely.intersection(corners[0][:, None], corners[1][None])), 0.0)


def _footprints(objects: Objects) -> Array:
    """(M, 4, 2) corners (x, z) of the footprints, one after the other."""
    cosine, sine = np.cos(objects.rotation_y), np.sin(objects.rotation_y)
    along = np.stack([cosine, -sine], axis=1) * objects.size[:, :1] / 2.0
    across = np.stack([sine, cosine], axis=1) * objects.size[:, 1:2] / 2.0
    corners = np.stack([along + across, along - across, -along - across, -along + across], axis=1)
    return corners + objects.location[:, None, [0, 2]]


Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Regime:
    """Which labels a regime counts."""

    name: str  # `Easy`, `Moderate` or `Hard`
    height: float  # 2D boxes must be higher than this, pixels
    occlusion: int  # largest occlusion
    truncation: float  # largest truncation


REGIMES = (Regime("Easy", 40, 0, 0.15), Regime("Moderate", 25, 1, 0.30), Regime("Hard", 25, 2, 0.50))

_NEIGHBOUR = {"Car": "van", "Pedestrian": "person_sitting"}
_SAMPLES = 41

LEAST_LABELS = _SAMPLES
"""Labels from which on average precision can come to 100 %: each gives a point of the curve at most."""


@dataclass(frozen=True)
class Curves:
    """One class in one space and one regime."""

    precision: Array  # (41,) precision at evenly spaced recall, each the largest from there on
    similarity: Array | None  # (41,) orientation similarity likewise, or None where a detection has no valid alpha
    labels: int  # number of labels that count

    @property
    def average_precision(self) -> tuple[float, float]:
        """Average precision over 11 and over 40 recall points, percent."""
        return _averages(self.precision)

    @property
    def orientation_similarity(self) -> tuple[float, float] | None:
        """Average orientation similarity (AOS) over 11 and over 40 recall points, percent."""
        return None if self.similarity is None else _averages(self.similarity)


def _averages(curve: Array) -> tuple[float, float]:
    return 100.0 * float(curve[::4].sum()) / 11.0, 100.0 * float(curve[1:].sum()) / 40.0


def regime_members(objects: Objects, regime: Regime) -> Mask:
    """(M,) which objects a regime counts, whatever their type."""
    height = objects.box[:, 3] - objects.box[:, 1]
    inside = (objects.occlusion <= regime.occlusion) & (objects.truncation <= regime.truncation)
    return inside & (height > regime.height)


def counted_cars(labels: Objects) -> tuple[NDArray[np.intp], Mask]:
    """(C,) positions of the cars that count in some regime, and (C, 3) in which."""
    members = np.array([regime_members(labels, regime) for regime in REGIMES]).T
    cars = np.array([kind == "Car" for kind in labels.kind], dtype=bool)
    chosen = np.flatnonzero(cars & members.any(axis=1))
    return chosen, members[chosen]


def evaluate(
    labels: Mapping[str, Objects],
    results: Mapping[str, Objects],
    kind: str = "Car",
    space: Space = Space.IMAGE,
    minimum_overlap: float | None = None,
) -> tuple[Curves, ...]:
    """Score results against labels, in each of `REGIMES`.

    Args:
        results: Detections with scores by frame. Only these frames are scored: give every frame, one without
            detections as well.
        space: Where overlaps are measured. The orientation similarity is defined in the image.
        minimum_overlap: Overlap that a match must exceed; KITTI's by default.

    Raises:
        InvalidInputError: The class is unknown, or a frame with results has no labels.
    """
    if kind not in MINIMUM_OVERLAP:
        raise InvalidInputError("kind", kind, f"Use one of {', '.join(MINIMUM_OVERLAP)}.")
    unknown = sorted(set(results) - set(labels))
    if unknown:
        raise InvalidInputError("results", unknown[0], "Give results of frames that have labels.")
    least = MINIMUM_OVERLAP[kind] if minimum_overlap is None else minimum_overlap
    frames = [_Frame.of(labels[name], results[name], kind, space, least) for name in results]
    oriented = space is Space.IMAGE and not any((found.alpha == -10.0).any() for found in results.values())
    return tuple(_curves(frames, regime, oriented=oriented) for regime in REGIMES)


@dataclass(frozen=True)
class _Frame:
    """What matching needs of a frame: labels of the class and its neighbour (G), all detections that may match (D).

    Small detections of any class are kept, since the devkit lets them take a label (which then is not counted).
    """

    counts: Mask  # (3, G) whether each regime counts the label
    valid: Mask  # (3, D) detections of the class and high enough
    ignored: Mask  # (3, D) detections below the minimum height
    meets: Array  # (G, D) overlaps, zero where too small
    dont_care: Mask  # (D,) whether a detection lies in a DontCare area
    score: Array  # (D,)
    similarity: Array  # (G, D) orientation similarity

    @classmethod
    def of(cls, labels: Objects, found: Objects, kind: str, space: Space, least: float) -> _Frame:
        names = np.char.lower(np.array(labels.kind, dtype=str)) if len(labels) else np.array([], dtype=str)
        own = names == kind.lower()
        relevant = own | (names == _NEIGHBOUR.get(kind, ""))
        areas = labels.take(names == "dontcare")
        height = np.trunc(np.abs(found.box[:, 1] - found.box[:, 3]))  # the devkit keeps it as an integer
        small = np.array([height < regime.height for regime in REGIMES])
        of_kind = np.array([name.lower() == kind.lower() for name in found.kind], dtype=bool)
        counted, gt = labels.take(relevant), own[relevant]
        shared = overlap(space, found, counted).T
        covered = overlap(space, found, areas, of_first=True) > least
        difference = counted.alpha[:, None] - found.alpha
        return cls(
            counts=np.array([gt & regime_members(counted, regime) for regime in REGIMES]),
            valid=of_kind & ~small,
            ignored=small,
            meets=np.where(shared > least, shared, 0.0),
            dont_care=np.asarray(np.any(covered, axis=1)),
            score=found.score,
            similarity=(1.0 + np.cos(difference)) / 2.0,
        )


def _curves(frames: Sequence[_Frame], regime: Regime, *, oriented: bool) -> Curves:
    r = REGIMES.index(regime)
    total = sum(int(frame.counts[r].sum()) for frame in frames)
    scores = np.concatenate([_true_positive_scores(frame, r) for frame in frames]) if frames else np.zeros(0)
    thresholds = _thresholds(scores, total)
    right, wrong, similar = (np.zeros(len(thresholds)) for _ in range(3))
    if len(thresholds):
        for frame in frames:
            matched = _match(frame, r, thresholds)
            right, wrong, similar = right + matched[0], wrong + matched[1], similar + matched[2]
    precision, similarity = np.zeros(_SAMPLES), np.zeros(_SAMPLES)
    precision[: len(thresholds)] = right / np.maximum(right + wrong, 1.0)
    similarity[: len(thresholds)] = similar / np.maximum(right + wrong, 1.0)
    precision, similarity = (np.maximum.accumulate(curve[::-1])[::-1] for curve in (precision, similarity))
    return Curves(precision, similarity if oriented else None, total)


def _true_positive_scores(frame: _Frame, r: int) -> Array:
    """Scores of the detections that find a counted label when each label takes the free one of highest score."""
    usable = (frame.meets > 0) & (frame.valid[r] | frame.ignored[r])
    free = np.ones(len(frame.score), dtype=bool)
    scores = []
    for g in np.flatnonzero(usable.any(axis=1)):
        candidates = np.flatnonzero(usable[g] & free)
        if len(candidates):
            best = candidates[frame.score[candidates].argmax()]
            free[best] = False
            if frame.counts[r, g] and not frame.ignored[r, best]:
                scores.append(frame.score[best])
    return np.array(scores)


def _thresholds(scores: Array, labels: int) -> Array:
    """Scores at which recall comes closest to 0, 1/40, 2/40 and so on."""
    chosen: list[float] = []
    ordered = np.sort(scores)[::-1]
    recall = 0.0
    for i, score in enumerate(ordered):
        last = i == len(ordered) - 1
        here, following = (i + 1) / labels, (i + 1 if last else i + 2) / labels
        if following - recall < recall - here and not last:
            continue
        chosen.append(float(score))
        recall += 1.0 / (_SAMPLES - 1.0)
    return np.array(chosen)


def _match(frame: _Frame, r: int, thresholds: Array) -> tuple[Array, Array, Array]:
    """True positives, false positives and summed orientation similarity at each threshold (T,)."""
    valid, ignored, counts = frame.valid[r], frame.ignored[r], frame.counts[r]
    free = frame.score >= thresholds[:, None]  # (T, D)
    right, similar = np.zeros(len(thresholds)), np.zeros(len(thresholds))
    rows = np.arange(len(thresholds))
    usable = (frame.meets > 0) & (valid | ignored)
    for g in np.flatnonzero(usable.any(axis=1)):
        candidates = usable[g] & free
        normal = candidates & valid
        has_normal = normal.any(axis=1)
        best = np.where(has_normal, (normal * frame.meets[g]).argmax(axis=1), candidates.argmax(axis=1))
        taken = candidates[rows, best]
        free[rows[taken], best[taken]] = False
        if counts[g]:
            right += has_normal
            similar += has_normal * frame.similarity[g, best]
    wrong = free & valid & ~frame.dont_care
    return right, wrong.sum(axis=1).astype(np.float64), similar
