"""Masks of an image's vehicles from files: images of ids, and COCO's annotations or results."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.mask import Mask
from fgrecon.io.arrays import read_limited
from fgrecon.io.boxes import coco_entries

MASKS = (".png", ".json")
"""Endings of files of masks."""

_IGNORED = 10_000  # the id of regions that nobody labelled, in KITTI's and MOTS's images of ids
_FIX = "Give a PNG of ids (8 or 16 bits, 0 where no vehicle is), or COCO JSON with a `segmentation` for each."


def read_masks(file: Path, image: Path, size: tuple[int, int] | None = None) -> list[Mask]:
    """The masks of an image, none where the file has none of it.

    Args:
        file: A PNG whose pixels have the id of what they show, 0 for nothing (KITTI's and MOTS's 10000 as well), or
            COCO JSON: annotations or results, with polygons or run lengths.
        image: The image's file, or its name, by which COCO's are chosen.
        size: Width and height of the image, which COCO's results without a list of images do not state.

    Raises:
        InvalidInputError: The file cannot be used; names the field.
    """
    if file.suffix.lower() == ".json":
        return _of_coco(file, image, size)
    import cv2  # on use: importing fgrecon must not import OpenCV

    content = np.frombuffer(read_limited(file, "masks"), dtype=np.uint8)
    try:
        ids: Any = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if len(content) else None
    except cv2.error:
        ids = None
    if ids is None or ids.ndim != 2:
        value = f"{file}: no image" if ids is None else f"{file}: {ids.shape[2]} channels"
        raise InvalidInputError("masks", value, _FIX)
    return [Mask(ids == one) for one in np.unique(ids).tolist() if one not in (0, _IGNORED)]


def _of_coco(file: Path, image: Path, size: tuple[int, int] | None) -> list[Mask]:
    found = []
    for fields, stated in coco_entries(file, image):
        given = fields.data.get("segmentation")
        if not given:
            continue
        whole = stated or size
        try:
            if isinstance(given, Mapping):
                found.append(Mask.of_rle(given))
            elif whole is not None:
                found.append(Mask.of_polygons(given, whole))
            else:
                raise InvalidInputError("masks", f"{file}: polygons without an image's size", "Give `images` as well.")
        except InvalidInputError as error:
            raise InvalidInputError(f"{fields.where}segmentation", error.value, error.fix) from error
    return found
