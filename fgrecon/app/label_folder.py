"""A folder of photographs whose labels are corrected: their order, and the file that they are saved to."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fgrecon.app.labelling import Judgement, judge
from fgrecon.app.requested import Requested
from fgrecon.app.solving import Uploaded
from fgrecon.app.visit import Upload
from fgrecon.app.workers import BusyError, Workers
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.io.catalogue import load_category
from fgrecon.io.coco_keypoints import SEEN, VehicleLabel, VehicleLabels, read_coco_keypoints, write_coco_keypoints
from fgrecon.io.images import IMAGES

LABELS = "labels.json"
"""Name of the file in the folder."""

_CATEGORY = "car14"
_RIGHTED = "righted"  # among what made the labels: the names of images that somebody has been through
_GIVEN = "given.json"


class LabelFolder:
    """Images by name, their labels so far, and what the graph says of them.

    Attributes:
        images: The names.
        righted: Those that somebody has been through.
        judged: What the graph says of those that it has looked at.
    """

    def __init__(self, folder: Path) -> None:
        """Read what there is."""
        if not folder.is_dir():
            raise InvalidInputError("label", str(folder), "Give a folder of images.")
        self.folder = folder
        self.images = sorted(path.name for path in folder.iterdir() if path.suffix.lower() in IMAGES)
        if not self.images:
            raise InvalidInputError("label", str(folder), f"Give a folder with images ({', '.join(IMAGES)}).")
        category = load_category(_CATEGORY)
        self._all = VehicleLabels(category.name, category.keypoints, category.edges, ())
        if (folder / LABELS).exists():
            self._all = replace(read_coco_keypoints(folder / LABELS), faces=None)
            if self._all.category != category.name:
                fix = f"Give labels of {category.name}."
                raise InvalidInputError(f"{folder / LABELS}: category", self._all.category, fix)
        self.righted = set(json.loads(self._all.info.get(_RIGHTED, "[]")))
        self.judged: dict[str, Judgement] = {}

    @property
    def order(self) -> list[str]:
        """The images: what the graph disagrees with most first, those that were righted last."""
        unknown = Judgement(-1.0, "")
        return sorted(self.images, key=lambda n: (n in self.righted, -self.judged.get(n, unknown).disagreement, n))

    def labels(self, name: str) -> list[VehicleLabel]:
        """Those of an image."""
        place = (self.folder / name).resolve()
        return [label for label in self._all.vehicles if label.image.path.resolve() == place]

    def upload(self, name: str) -> Upload:
        """An image as an upload, with its labels as given keypoints where it has any."""
        path, labels = self.folder / name, self.labels(name)
        if not labels:
            return Upload(Uploaded(name), {name: path})
        first = labels[0].image
        given = {"K": first.matrix.tolist(), "image_size": [*first.size], "instances": [*map(_instance, labels)]}
        files: dict[str, bytes | Path] = {name: path, _GIVEN: json.dumps(given, allow_nan=False).encode()}
        return Upload(Uploaded(_GIVEN, photograph=name), files)

    async def judge_all(self, workers: Workers, requested: Requested) -> None:
        """Let workers look at every image; those that cannot be used come first, with the reason."""
        for name in self.images:
            upload = self.upload(name)
            try:
                with workers.place():
                    self.judged[name] = await workers(upload.files, judge, upload.names, requested)
            except BusyError:
                continue
            except FgreconError as error:
                self.judged[name] = Judgement(float("inf"), str(error))

    def save(self, name: str, labels: Sequence[VehicleLabel]) -> Path:
        """Put the labels of an image in the place of those it had, and write the file."""
        place, number = (self.folder / name).resolve(), self.images.index(name)
        path, drive = self.folder / name, self.folder.resolve().name
        kept = [label for label in self._all.vehicles if label.image.path.resolve() != place]
        new = [replace(label, image=replace(label.image, path=path, drive=drive, frame=number)) for label in labels]
        righted = {*self.righted, name}
        info = {**self._all.info, _RIGHTED: json.dumps(sorted(righted))}
        together = replace(self._all, vehicles=(*kept, *new), info=info)
        if together.vehicles:
            write_coco_keypoints(self.folder / LABELS, together)
        else:
            (self.folder / LABELS).unlink(missing_ok=True)
        self._all, self.righted = together, righted
        return self.folder / LABELS


def _instance(label: VehicleLabel) -> dict[str, Any]:
    """A label as a keypoint file has it; hidden keypoints are not measured."""
    measured = (label.probability >= SEEN) & np.isfinite(label.keypoints).all(axis=1)
    return {
        "id": str(label.track),
        "track": label.track,
        "kind": label.kind,
        "keypoints": [
            point if known else None for point, known in zip(label.keypoints.tolist(), measured, strict=True)
        ],
        "confidence": label.probability.tolist(),
        "confidence_midpoint": SEEN,
        "covariance": label.covariance.tolist(),
        "box": label.box.tolist(),
    }
