"""What a worker makes of boxes that were drawn: vehicles with keypoints by the networks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fgrecon.app.requested import Requested
from fgrecon.app.solving import without_folder
from fgrecon.app.view import instance_of
from fgrecon.batch.vehicle_tasks import KeypointRequest, image_tasks
from fgrecon.io.cameras.camera_source import CameraSource
from fgrecon.io.catalogue import load_prior
from fgrecon.io.images import read_image
from fgrecon.perception.boxes import GivenBoxes


def instances_in_boxes(
    folder: Path, photograph: str, boxes: Sequence[Sequence[float]], requested: Requested
) -> list[dict[str, Any]]:
    """A vehicle in each box x1, y1, x2, y2 of a photograph, as a keypoint file has it.

    Raises:
        InvalidInputError: The photograph or a box cannot be used.
    """
    path = folder / photograph
    with without_folder(folder):
        how = KeypointRequest(load_prior(requested.prior or "car14").category)
        pixels = read_image(path)
        tasks = image_tasks(path, CameraSource(image=pixels), GivenBoxes(boxes).of_image(path, pixels).cars, how)
        return [instance_of(task.instance) for task in tasks]
