"""Labels of all photographs: from boxes and silhouettes first, then corrected by what a network finds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.io.arrays import read_arrays, write_arrays
from fgrecon.io.catalogue import load_category
from fgrecon.io.files import MADE_AGAIN, stored
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon_research.training.keypoints.dataset import LAST, Photographs, check_prepared, prepare_photographs
from fgrecon_research.training.keypoints.labels import (
    Labels,
    ShapeFit,
    fit_shape,
    project_labels,
    unit_prior,
    unmodelled,
)
from fgrecon_research.training.keypoints.marks import read_given_marks
from fgrecon_research.training.keypoints.posed_cars import (
    PosedCar,
    Progress,
    groups,
    no_progress,
    read_posed_cars,
    read_validation_ids,
)
from fgrecon_research.training.keypoints.relabel import Found, relabel_shape, without_bias
from fgrecon_research.training.keypoints.silhouettes import Outline, contradicted, fit_outlines, read_outline
from fgrecon_research.training.priors.apollo79 import load_apollo79

_BATCH = 32


@dataclass(frozen=True)
class Source:
    """What the training reads."""

    cars: Sequence[PosedCar]  # all photographs
    learn: NDArray[np.intp]  # (N,) indices of those to learn from
    validate: NDArray[np.intp]  # indices of those set aside
    prior: ShapePrior  # model of the shapes in the unit of the photographs' poses
    # (M, K, 2) keypoints marked by hand in all M photographs, pixels; NaN where none is, None without any
    marks: Array | None = None

    @property
    def marked(self) -> int:
        """Number of keypoints marked by hand."""
        return 0 if self.marks is None else int(np.isfinite(self.marks).all(axis=-1).sum())


@dataclass(frozen=True)
class Labelling:
    """Labels of all photographs, and the shapes behind them."""

    labels: Labels  # keypoints in pixels of the files, and visibilities
    fits: dict[str, ShapeFit]  # the shapes by name
    cars: Sequence[PosedCar]  # the photographs with their poses as corrected so far
    trusted: NDArray[np.bool_]  # (M,) which photographs to learn from
    outlined: NDArray[np.bool_]  # (M,) which poses were corrected by a silhouette

    def samples(self, photographs: Photographs, among: NDArray[np.intp]) -> NDArray[np.intp]:
        """Rows of the trusted photographs among some, and of their distant ones."""
        return photographs.with_distant(among[self.trusted[among]])

    def save(self, path: Path) -> None:
        """Write to an npz file, whole or not at all."""
        names = sorted(self.fits)
        write_arrays(
            path,
            keypoints=self.labels.keypoints,
            visible=self.labels.visible,
            trusted=self.trusted,
            outlined=self.outlined,
            matrix=np.array([car.matrix for car in self.cars]),
            rotation=np.array([car.rotation for car in self.cars]),
            translation=np.array([car.translation for car in self.cars]),
            names=np.array(names),
            coefficients=np.array([self.fits[name].coefficients for name in names]),
            offsets=np.array([self.fits[name].offsets for name in names]),
        )

    @classmethod
    def open(cls, path: Path, cars: Sequence[PosedCar]) -> Labelling | None:
        """What was saved of the same photographs; None where the file is not there, or is damaged and put aside.

        Warns:
            DamagedFileWarning: It is damaged; names it.

        Raises:
            InvalidInputError: The file holds labels of others.
        """
        arrays = stored(path, lambda file: read_arrays(file, str(file), MADE_AGAIN))
        if arrays is None:
            return None
        if len(arrays["trusted"]) != len(cars):
            raise InvalidInputError(str(path), f"{len(arrays['trusted'])} photographs", "Train in an empty folder.")
        posed = [
            replace(car, matrix=k, rotation=r, translation=t)
            for car, k, r, t in zip(cars, arrays["matrix"], arrays["rotation"], arrays["translation"], strict=True)
        ]
        fits = {
            str(name): ShapeFit(c, o, np.zeros((0, 4)))
            for name, c, o in zip(arrays["names"], arrays["coefficients"], arrays["offsets"], strict=True)
        }
        labels = Labels(arrays["keypoints"], arrays["visible"])
        return cls(labels, fits, posed, arrays["trusted"], arrays["outlined"])


def read_source(data: Path, marks: Path | None = None) -> Source:
    """Read what the training needs from the data folder: `posed_cars`, `apollo79` and the validation shapes.

    Raises:
        InvalidInputError: A file is missing or malformed.
    """
    cars = read_posed_cars(data / "posed_cars")
    apart = read_validation_ids(data / "hand_labels" / "validation_cad_ids.json")
    held = np.array([car.cad_id in apart for car in cars])
    if not held.any():
        fix = "Name shapes that photographs are of: confidences are calibrated on those that are not learnt from."
        raise InvalidInputError("validation_cad_ids.json", "no photograph held out", fix)
    learn, prior, given = np.flatnonzero(~held), unit_prior(load_apollo79(data)), None
    if marks is not None:
        given = np.full((len(cars), prior.category.size, 2), np.nan)
        given[learn] = read_given_marks(marks, [cars[i].image.name for i in learn], prior.category)
    return Source(cars, learn, np.flatnonzero(held), prior, given)


def first_labelling(source: Source, silhouettes: Path | None = None, progress: Progress = no_progress) -> Labelling:
    """Labels from the shapes that explain the boxes and, where there are some, the silhouettes.

    Args:
        silhouettes: Folder of grey images, named as the photographs but png: white on the car. Where some are given,
            only photographs whose silhouette agrees with the shape are trusted.

    Raises:
        InvalidInputError: The folder holds no silhouettes of these cars, or a file in it is no image of the right size.
    """
    prior, cars = source.prior, list(source.cars)
    fits: dict[str, ShapeFit] = {}
    outlined = np.zeros(len(cars), dtype=bool)
    keypoints, visible = np.zeros((len(cars), prior.category.size, 2)), np.zeros((len(cars), prior.category.size))
    unknown = unmodelled(cars, prior.category)
    for name, rows in progress(list(groups(cars).items()), "Shapes of boxes and silhouettes"):
        mine = [cars[i] for i in rows]
        outlines = _outlines(silhouettes, mine)
        result = fit_outlines(prior, mine, outlines, fit_shape(prior, mine))
        fits[name], outlined[rows] = result.fit, result.used
        for row, car in zip(rows, result.cars, strict=True):
            cars[row] = car
        labels = project_labels(prior, result.fit, result.cars)
        keypoints[rows], visible[rows] = labels.keypoints, labels.visible
        believed = np.flatnonzero(result.used)
        unknown[rows] |= _contradicted(prior.category, [outlines[i] for i in believed], labels.keypoints[believed])
    if silhouettes is not None and not outlined.any():
        fix = "Fill it with `fgrecon keypoints silhouettes`: none of its silhouettes agrees with its car."
        raise InvalidInputError("silhouettes", str(silhouettes), fix)
    trusted = np.ones(len(cars), dtype=bool) if silhouettes is None else outlined.copy()
    return Labelling(_known(keypoints, visible, unknown), fits, cars, trusted, outlined)


def corrected(
    source: Source,
    first: Labelling,
    detector: KeypointCascade,
    photographs: Photographs,
    silhouettes: Path | None = None,
    progress: Progress = no_progress,
) -> Labelling:
    """Labels corrected by what the network finds in all photographs of each shape.

    What boxes and silhouettes say is the evidence in every round; the corrections of the last round are not built upon.
    With silhouettes, what the network has learnt to put aside in all shapes alike is taken off what it finds.
    """
    prior = source.prior
    found = _find(source.cars, detector, photographs, progress)
    known = np.asarray(np.isfinite(first.labels.keypoints).all(axis=-1), dtype=np.bool_)
    if first.outlined.any():
        sure = first.outlined[:, None] & known
        found = without_bias(prior, first.cars, [first.fits[c.shape] for c in first.cars], sure, found)
    fits: dict[str, ShapeFit] = {}
    cars, trusted = list(first.cars), np.ones(len(first.cars), dtype=bool)
    keypoints, visible = np.zeros(first.labels.keypoints.shape), np.zeros(known.shape)
    unknown = unmodelled(cars, prior.category)
    for name, rows in progress(list(groups(source.cars).items()), "Shapes of what was found"):
        chosen = Found(found.keypoints[rows], found.confidence[rows], found.covariance[rows])
        mine = [first.cars[i] for i in rows]
        given = np.logical_and.reduce(known[rows])
        marks = None if source.marks is None else source.marks[rows]
        result = relabel_shape(prior, mine, first.fits[name], chosen, first.outlined[rows], given, marks)
        unknown[rows] &= ~result.marked
        fits[name] = result.fit
        trusted[rows], keypoints[rows] = result.trusted, result.keypoints
        for row, car in zip(rows, result.cars, strict=True):
            cars[row] = car
        visible[rows] = project_labels(prior, result.fit, result.cars).visible
        believed = np.flatnonzero(first.outlined[rows])
        outlines = _outlines(silhouettes, [result.cars[i] for i in believed])
        unknown[rows] |= _contradicted(prior.category, outlines, result.keypoints[believed])
    return Labelling(_known(keypoints, visible, unknown), fits, cars, trusted, first.outlined)


def open_photographs(
    source: Source,
    labelling: Labelling,
    folder: Path,
    silhouettes: Path | None = None,
    progress: Progress = no_progress,
) -> Photographs:
    """The prepared photographs with these labels; prepares them where that has not been done.

    Warns:
        DamagedFileWarning: They are damaged, and are prepared again.
    """
    if stored(folder / LAST, lambda _: check_prepared(folder)) is None:
        fits = [labelling.fits[car.shape] for car in source.cars]
        drawn = None
        if silhouettes is not None:
            outlined = zip(source.cars, labelling.outlined, strict=True)
            drawn = [car.silhouette(silhouettes) if used else None for car, used in outlined]
        prepare_photographs(labelling.cars, fits, source.prior, folder, drawn, progress)
    return Photographs.load(folder, labelling.labels, labelling.cars)


def _known(keypoints: Array, visible: Array, unknown: NDArray[np.bool_]) -> Labels:
    """Labels without the keypoints (M, K) of unknown place."""
    return Labels(np.where(unknown[..., None], np.nan, keypoints), visible)


def _contradicted(category: Category, outlines: Sequence[Outline | None], keypoints: Array) -> NDArray[np.bool_]:
    """(K,) which keypoints of planar faces the silhouettes of their shape contradict; mirrors are too thin for that."""
    checked = np.isin(np.arange(category.size), category.off_faces, invert=True)
    return contradicted(outlines, keypoints, category.mirror) & checked


def _outlines(silhouettes: Path | None, cars: Sequence[PosedCar]) -> list[Outline | None]:
    return [None if silhouettes is None else read_outline(car.silhouette(silhouettes), car.size) for car in cars]


def _find(cars: Sequence[PosedCar], detector: KeypointCascade, photographs: Photographs, progress: Progress) -> Found:
    """Keypoints in all prepared photographs, in pixels of the files."""
    keypoints = np.zeros((len(cars), load_category(detector.category).size, 2))
    confidence, covariance = np.zeros(keypoints.shape[:2]), np.zeros((*keypoints.shape, 2))
    for start in progress(range(0, len(cars), _BATCH), "Keypoints in all photographs"):
        rows = range(start, min(start + _BATCH, len(cars)))
        images = [np.ascontiguousarray(photographs.view(i).image) for i in rows]
        boxes = np.array([[-0.5, -0.5, image.shape[1] - 0.5, image.shape[0] - 0.5] for image in images])
        for i, detection in zip(rows, detector.detect_batch(images, boxes), strict=True):
            observation, scale = detection.observation, float(photographs.scales[i])
            keypoints[i], confidence[i] = (observation.keypoints + 0.5) / scale - 0.5, observation.confidence
            covariance[i] = np.eye(2) if observation.covariance is None else observation.covariance / scale**2
    return Found(keypoints, confidence, covariance)
