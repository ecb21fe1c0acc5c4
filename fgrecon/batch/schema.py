"""The columns of the tables: of tasks, which a run hands to its workers, and of results."""

from __future__ import annotations

from typing import Any

import pyarrow as pa

SCHEMA_VERSION = 2
FORMAT = f"fgrecon.batch/{SCHEMA_VERSION}"

REFUSED, ERROR, EMPTY, LEFT_OUT = "refused", "error", "empty", "left_out"
"""Statuses of rows beside those of results: bad input, anything unforeseen, an image without a vehicle, and vehicles of
an image that the category does not cover."""

_TEXT, _NUMBER, _NUMBERS = pa.string(), pa.float64(), pa.list_(pa.float64())

_ALTERNATIVE = pa.struct(
    [("camera_T_object", _NUMBERS), ("coefficients", _NUMBERS), ("excess", _NUMBER), ("probability", _NUMBER)]
)


def task_schema() -> Any:
    """Columns of the tables that a run hands to its workers.

    row_id; source, the file it is from; frame, of a video; and one of: instance, the JSON text of an instance of a
    keypoint file; image, a file, with camera, the JSON text of the camera's fields, where it is known; problem, why the
    row could not be read.
    """
    texts = ("row_id", "source", "instance", "image", "camera", "problem")
    return pa.schema([*((name, _TEXT) for name in texts), ("frame", pa.int64())])


def result_schema() -> Any:
    """The columns of results (docs/reference/batch-table.md says what is in them), with the format in the metadata."""
    fields = [
        *((name, _TEXT) for name in ("row_id", "source")),
        ("frame", pa.int64()),
        *((name, _TEXT) for name in ("image", "kind")),
        ("track", pa.int64()),
        ("vehicle", pa.int32()),
        *((name, _TEXT) for name in ("id", "status", "error_type", "error_field", "error", "message")),
        *((name, _TEXT) for name in ("category", "prior")),
        *((name, _NUMBER) for name in ("rotation_y", "x", "y", "z", "length", "width", "height")),
        *((name, _NUMBER) for name in ("sigma_rotation", "sigma_translation")),
        *((name, _NUMBERS) for name in ("camera_T_object", "coefficients", "offsets")),
        ("keypoints", pa.list_(_TEXT)),
        *((name, _NUMBERS) for name in ("wireframe", "wireframe_uv", "weights", "sigmas", "visibility")),
        *((name, _NUMBERS) for name in ("pose_covariance", "coefficients_covariance", "size_covariance")),
        ("alternatives", pa.list_(_ALTERNATIVE)),
        ("facing_probability", _NUMBER),
        ("reasons", pa.list_(_TEXT)),
        ("regions", _TEXT),
        *((name, _NUMBERS) for name in ("camera_matrix", "distortion")),
        ("distortion_model", _TEXT),
        ("image_size", pa.list_(pa.int32())),
        ("box", _NUMBERS),
        ("score", _NUMBER),
        ("box_excess", _NUMBER),
        ("input_warning", _TEXT),
        ("left_out", pa.list_(_TEXT)),
        ("focal_sigma", _NUMBER),
        ("milliseconds", _NUMBER),
    ]
    return pa.schema(fields, metadata={"fgrecon.format": FORMAT})
