"""Rows of results: of what was solved, of what was refused, and back to a `Reconstruction`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from fgrecon.batch.pool import WorkerDiedError
from fgrecon.batch.schema import ERROR, REFUSED, result_schema
from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.category import Category
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.reconstruction import Alternative, Diagnostics, Pose, Reconstruction, Shape, Status, Uncertainty
from fgrecon.core.result_fields import Regions
from fgrecon.core.serialise import finite
from fgrecon.io.keypoint_file import Instance


def origin_of(task: Mapping[str, Any], position: int) -> dict[str, Any]:
    """What a row of results takes over from its task: `row_id` (else the position in the table), `source`, `frame`."""
    known = {name: task.get(name) for name in ("row_id", "source", "frame")}
    return known if known["row_id"] is not None else known | {"row_id": str(position)}


def id_in_image(row_id: str, vehicle: int) -> str:
    """The id of a vehicle that was found in the image that a row is; other vehicles have their own."""
    return f"{row_id}:{vehicle}"


def given_of(instance: Instance) -> dict[str, Any]:
    """What a row repeats of what was given of a vehicle: image, box, class, score and track."""
    given = {name: getattr(instance, name) for name in ("image", "kind", "score", "track")}
    return given | {"box": _flat(instance.box)}


def solved_row(
    origin: Mapping[str, Any],
    vehicle: int,
    name: str,
    result: Reconstruction,
    camera: Camera,
) -> dict[str, Any]:
    """The row of a result.

    Args:
        origin: What the row takes over from its task.
    """
    return {
        **origin,
        "vehicle": vehicle,
        **result.to_row(name, flat=False),
        "offsets": _flat(result.shape.offsets),
        "sigmas": _flat(result.diagnostics.sigmas),
        "pose_covariance": _flat(result.uncertainty.pose_covariance),
        "coefficients_covariance": _flat(result.uncertainty.coefficients_covariance),
        "alternatives": [
            {
                "camera_T_object": _flat(a.camera_T_object),
                "coefficients": _flat(a.coefficients),
                "excess": a.excess,
                "probability": finite(a.probability),
            }
            for a in result.uncertainty.alternatives
        ],
        "size_covariance": _flat(result.uncertainty.size_covariance),
        "facing_probability": finite(result.facing_probability),
        "reasons": list(result.reasons),
        "regions": result.uncertainty.regions.value,
        "camera_matrix": _flat(camera.matrix),
        "focal_sigma": camera.focal_sigma,
        "distortion": _flat(camera.distortion),
        "distortion_model": None if camera.distortion is None else camera.distortion_model,
        "image_size": camera.image_size,
        "box_excess": finite(result.diagnostics.box_excess),
        "own_shares": dict(result.diagnostics.own_shares) or None,
        "left_out": list(result.diagnostics.left_out),
        "milliseconds": sum(result.diagnostics.milliseconds.values()),
    }


def failed_row(
    origin: Mapping[str, Any], error: Exception, vehicle: int | None = None, name: str | None = None
) -> dict[str, Any]:
    """The row of a vehicle, or of a whole task, that gave an error instead of a result."""
    return {
        **origin,
        "vehicle": vehicle,
        "id": name,
        "status": REFUSED if isinstance(error, FgreconError) else ERROR,
        "error_type": type(error).__name__,
        "error_field": error.field if isinstance(error, InvalidInputError) else None,
        "error": str(error),
    }


def storable(row: Mapping[str, Any]) -> dict[str, Any]:
    """The row with texts that can be stored: JSON and names of files have half characters, UTF-8 has none."""
    return {
        name: value.encode(errors="backslashreplace").decode() if isinstance(value, str) else value
        for name, value in row.items()
    }


def table_of(rows: Sequence[Mapping[str, Any]]) -> Any:
    """Rows as a table; one that the columns cannot hold becomes a row that says so."""
    fitting = [storable(row) for row in rows]
    try:
        return pa.Table.from_pylist(fitting, schema=result_schema())
    except (pa.ArrowException, OverflowError, TypeError, ValueError):
        return pa.concat_tables([_table_of(row) for row in fitting])


def _table_of(row: Mapping[str, Any]) -> Any:
    try:
        return pa.Table.from_pylist([row], schema=result_schema())
    except (pa.ArrowException, OverflowError, TypeError, ValueError) as error:
        origin = {name: row.get(name) for name in ("row_id", "source")}
        return pa.Table.from_pylist([failed_row(origin, error, row.get("vehicle"))], schema=result_schema())


def single_tasks(tasks: Sequence[Mapping[str, Any]]) -> list[Sequence[Mapping[str, Any]]]:
    """Each task alone."""
    return [[task] for task in tasks]


def lost_rows(tasks: Sequence[Mapping[str, Any]], error: WorkerDiedError) -> Any:
    """The rows of tasks that were given up."""
    rows = [failed_row(origin_of(task, 0), error) | {"status": ERROR} for task in tasks]
    return pa.Table.from_pylist(rows, schema=result_schema())


def _flat(array: Array | None) -> list[float] | None:
    return None if array is None else np.asarray(array, dtype=np.float64).ravel().tolist()


def reconstruction_of(row: Mapping[str, Any], category: Category) -> Reconstruction | None:
    """The result that a row holds: without history, surface and energies, which rows do not have.

    Args:
        row: A row of a results table as plain values (`table.to_pylist()`).
        category: The category that it names (`fgrecon.load_category`, or that of the prior).

    Returns:
        The result; None where the row has none.

    Raises:
        InvalidInputError: The category is another one.
    """
    if row["camera_T_object"] is None:
        return None
    if list(category.keypoints) != row["keypoints"]:
        raise InvalidInputError("category", category.name, f"Give the category {row['category']}, which the row names.")

    def square(name: str) -> Array | None:
        numbers = row.get(name)  # earlier folders have no sizes'
        return None if numbers is None else np.array(numbers).reshape(math.isqrt(len(numbers)), -1)

    def vectors(name: str, length: int) -> Array:
        return np.array(row[name], dtype=np.float64).reshape(-1, length)

    return Reconstruction(
        status=Status(row["status"]),
        message=row["message"],
        reasons=tuple(row.get("reasons") or ()),
        pose=Pose(
            camera_T_object=vectors("camera_T_object", 4),
            wireframe_uv=vectors("wireframe_uv", 2),
        ),
        shape=Shape(
            category=row["category"],
            prior=row["prior"],
            keypoint_names=category.keypoints,
            coefficients=np.array(row["coefficients"], dtype=np.float64),
            offsets=vectors("offsets", 3),
            wireframe=vectors("wireframe", 3),
            edges=np.array(category.edges, dtype=np.int64).reshape(-1, 2),
            box_size=np.array([row["length"], row["width"], row["height"]]),
            faces={face.name: face.keypoints for face in category.faces},
            symmetric_pairs=np.array(category.symmetric_pairs, dtype=np.int64).reshape(-1, 2),
        ),
        uncertainty=Uncertainty(
            pose_covariance=square("pose_covariance"),
            coefficients_covariance=square("coefficients_covariance"),
            alternatives=tuple(map(_alternative, row["alternatives"])),
            facing_probability=_number(row.get("facing_probability")),
            size_covariance=square("size_covariance"),
            regions=Regions(row.get("regions") or Regions.ASSUMED),
        ),
        diagnostics=Diagnostics(
            weights=np.array(row["weights"], dtype=np.float64),
            sigmas=np.array(row["sigmas"], dtype=np.float64),
            visibility=np.array(row["visibility"], dtype=np.float64),
            milliseconds={"total": row["milliseconds"]},
            box_excess=_number(row.get("box_excess")),
            own_shares={kind: share for kind, share in (row.get("own_shares") or {}).items() if share is not None},
        ),
    )


def _number(value: float | None) -> float:
    """The number; NaN where none is known, as in earlier folders."""
    return float("nan") if value is None else value


def _alternative(data: Mapping[str, Any]) -> Alternative:
    pose = np.array(data["camera_T_object"], dtype=np.float64).reshape(4, 4)
    shape = np.array(data["coefficients"], dtype=np.float64)
    return Alternative(pose, shape, data["excess"], _number(data.get("probability")))
