"""Annotations as labels that files hold."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from fgrecon.core.box3d import box_corners
from fgrecon.core.camera import MIN_DEPTH
from fgrecon.core.category import Category
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.geometry import transform
from fgrecon.core.reconstruction import rotation_y
from fgrecon_research.annotation.annotation import Annotation
from fgrecon_research.annotation.silhouette import silhouette
from fgrecon_research.io.coco_keypoints import LabelledImage, VehicleLabel, VehicleLabels


def vehicle_labels(
    annotations: Iterable[tuple[str, Annotation]], category: Category, info: Mapping[str, str], terms: str = ""
) -> VehicleLabels:
    """The labels of annotated vehicles.

    Args:
        annotations: The vehicles, each with the name of its drive.
        category: Their category.
        info: What made them, in words.
        terms: Of the images, in words.

    Returns:
        The labels; without triangles where the surfaces do not share them.

    Raises:
        InvalidInputError: An image's size is not known.
    """
    made = [(one, _label(drive, one)) for drive, one in annotations]
    faces = made[0][0].faces if made else np.zeros((0, 3), dtype=np.int64)
    alike = all(np.array_equal(faces, one.faces) for one, _ in made)  # hulls of different sizes are not
    return VehicleLabels(
        category=category.name,
        keypoints=category.keypoints,
        skeleton=category.edges,
        vehicles=tuple(label for _, label in made),
        faces=faces.astype(np.int64) if alike else None,
        info=info,
        terms=terms,
    )


def _label(drive: str, one: Annotation) -> VehicleLabel:
    if one.camera.image_size is None:
        raise InvalidInputError("annotation.camera.image_size", None, "Give the camera its image's size.")
    corners = transform(one.camera_T_object, box_corners(one.size))
    ahead = corners[:, 2] > MIN_DEPTH
    pixels = np.full((len(corners), 2), np.nan)
    pixels[ahead] = one.camera.distort(one.camera.project(corners[ahead]))
    return VehicleLabel(
        image=LabelledImage(one.frame.image, one.camera.image_size, one.camera.matrix, drive, one.frame.number),
        track=one.track,
        kind=one.kind,
        box=one.box,
        keypoints=one.keypoints,
        probability=one.visible,
        covariance=one.covariance,
        corners=pixels,
        location=one.camera_T_object[:3, 3],
        rotation_y=rotation_y(one.camera_T_object),
        size=one.size,
        azimuth=one.azimuth,
        agreement=one.agreement,
        silhouette=silhouette(one),
        vertices=one.vertices,
        boxed=one.boxed,
    )
