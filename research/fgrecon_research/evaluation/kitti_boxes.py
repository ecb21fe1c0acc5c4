"""The 3D boxes of KITTI's images that `evaluation.kitti_images` reconstructed, against the labelled ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fgrecon.io.export.dataset_results import kitti_objects
from fgrecon.io.export.results import NamedResult
from fgrecon.io.kitti_files import Objects
from fgrecon_research.evaluation.boxes3d import LabelledBox, scored_box
from fgrecon_research.evaluation.boxes_summary import (
    OverlapSummary,
    Precision,
    by_distance,
    precisions,
    summarise_group,
)
from fgrecon_research.evaluation.kitti_devkit import REGIMES
from fgrecon_research.evaluation.kitti_images import Car, ImageFrame


@dataclass(frozen=True, eq=False)
class ImageBoxes:
    """Boxes of some images."""

    results: Mapping[str, Objects]  # what was found as KITTI's results, by frame; none in frames where nothing was
    vehicles: Sequence[LabelledBox]  # every car that counts in some regime, with its box
    # summaries of the regimes, which are cumulative, and of the last one by distance
    groups: Mapping[str, OverlapSummary]
    # average precision by regime. There are no boxes but those of labelled cars, and so none that are wrong.
    curves: Sequence[Precision]


def score_boxes(frames: Sequence[ImageFrame], cars: Sequence[Car]) -> ImageBoxes:
    """Set the boxes of the cars beside the labelled ones; images err apart from one another.

    Args:
        frames: The images.
        cars: All of their cars that count (`fgrecon_research.evaluation.kitti_images.score_frame`).
    """
    by_name = {frame.name: frame for frame in frames}
    named: dict[str, list[NamedResult]] = {name: [] for name in by_name}
    vehicles = []
    for car in cars:
        frame, box = by_name[car.frame], None
        if car.found is not None and car.found.result is not None:
            offset = frame.calibration.label_offset
            one = NamedResult("", car.found.result, car.box, offset, score=car.score)
            named[car.frame].append(one)
            box = kitti_objects([one]) if one.solved else None
        label = frame.labels.take(np.array([car.index]))
        folder = frame.image.parent.parent.name
        vehicles.append(scored_box(folder, frame.name, car.index, frame.name, label, box))
    results = {name: kitti_objects(found) for name, found in named.items()}
    groups = {
        regime.name: [one for car, one in zip(cars, vehicles, strict=True) if car.regimes[row]]
        for row, regime in enumerate(REGIMES)
    }
    last = REGIMES[-1].name
    groups |= by_distance(last, groups[last])
    summaries = {name: summarise_group(members) for name, members in groups.items() if members}
    curves = precisions({name: frame.labels for name, frame in by_name.items()}, results)
    return ImageBoxes(results, vehicles, summaries, curves)
