"""Results as a table, one row per vehicle."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.export.results import NamedResult

__all__ = ["csv_text", "parquet_bytes"]


def csv_text(results: Sequence[NamedResult]) -> str:
    """Comma-separated values with a header.

    A row has the scalars of `parquet_bytes`, then `lambda_1` and so on, then `<keypoint>_x`, `_y`, `_z` (object frame,
    metres), `_u`, `_v` (pixels), `_weight` and `_visibility`. Numbers read back to the last bit.

    Raises:
        InvalidInputError: The vehicles are of different categories or priors: their columns differ.
    """
    rows = [_flat(item) for item in results]
    if any(list(row) != list(rows[0]) for row in rows):
        raise InvalidInputError("results", "of different priors", "Write a table for each, or Parquet.")
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def parquet_bytes(results: Sequence[NamedResult]) -> bytes:
    """Parquet with lists for arrays, flattened row by row.

    Scalars: id, status, message, category, prior; rotation_y in radians; x, y, z of the origin in the camera frame and
    length, width, height in metres; the standard deviations of the pose's rotation (largest axis, radians) and
    translation (largest axis, metres), empty where not determined. Lists: camera_T_object (16), coefficients, keypoint
    names, wireframe (3 per keypoint), wireframe_uv (2 per keypoint), weights, visibility.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = [_scalars(item) | _lists(item) for item in results]
    sink = io.BytesIO()
    pq.write_table(pa.Table.from_pylist(rows), sink)
    return sink.getvalue()


def _scalars(item: NamedResult) -> dict[str, Any]:
    result = item.result
    x, y, z = result.location.tolist()
    length, width, height = result.box_size.tolist()
    covariance = result.pose_covariance
    parts = (None, None) if covariance is None else (covariance[:3, :3], covariance[3:, 3:])
    rotation, translation = (None if part is None else float(np.sqrt(np.linalg.eigvalsh(part).max())) for part in parts)
    return {
        "id": item.name,
        "status": result.status.value,
        "message": result.message,
        "category": result.category,
        "prior": result.prior,
        "rotation_y": result.rotation_y,
        "x": x,
        "y": y,
        "z": z,
        "length": length,
        "width": width,
        "height": height,
        "sigma_rotation": rotation,
        "sigma_translation": translation,
    }


def _lists(item: NamedResult) -> dict[str, Any]:
    result = item.result
    return {
        "camera_T_object": result.camera_T_object.ravel().tolist(),
        "coefficients": result.coefficients.tolist(),
        "keypoints": list(result.keypoint_names),
        "wireframe": result.wireframe.ravel().tolist(),
        "wireframe_uv": result.wireframe_uv.ravel().tolist(),
        "weights": result.weights.tolist(),
        "visibility": result.visibility.tolist(),
    }


def _flat(item: NamedResult) -> dict[str, Any]:
    result = item.result
    row = _scalars(item) | {f"lambda_{j + 1}": value for j, value in enumerate(result.coefficients.tolist())}
    columns = np.column_stack([result.wireframe, result.wireframe_uv, result.weights, result.visibility])
    for name, numbers in zip(result.keypoint_names, columns.tolist(), strict=True):
        suffixes = ("x", "y", "z", "u", "v", "weight", "visibility")
        row |= {f"{name}_{suffix}": number for suffix, number in zip(suffixes, numbers, strict=True)}
    return row
