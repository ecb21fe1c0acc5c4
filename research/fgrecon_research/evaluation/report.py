"""Tables, Markdown and JSON of scored methods.

The JSON document: `methods` maps each method's name to `n`, `mae_deg`, `median_deg`, `aop` (percent of all frames
within 5, 15 and 30 degrees), `frames_within` (the same as counts), `median_translation_m` (null where half of the
frames or more failed), `ms` (mean wall time of the stages `pose` and `shape`, null for a stage that a method does not
have), `prior`, `summary` and `failures` (frame and reason). Beside it stand `units`, `machine`, `versions`, `files` and
`settings`.
"""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from fgrecon.calibration.labelled_frames import SceneKnowledge
from fgrecon.core.serialise import finite
from fgrecon.io.track_file import Track
from fgrecon_research.evaluation.measures import THRESHOLDS, instances_within, orientation_precision
from fgrecon_research.evaluation.run import MethodScores
from fgrecon_research.evaluation.text_table import TextTable, number_or_dash

FORMAT = "fgrecon_research.evaluation.tracks/1"
STAGES = ("pose", "shape")
_PACKAGES = ("fgrecon", "gtsam", "numpy", "scipy", "opencv-python-headless", "poselib")
_UNITS = {
    "mae_deg": "degrees, mean absolute orientation error; a failure counts 180",
    "median_deg": "degrees",
    "aop": "percent of all n frames with an orientation error of at most 5, 15 and 30 degrees",
    "median_translation_m": "metres between estimated and labelled origin; a failure counts as infinite",
    "ms": "milliseconds of wall time per frame, mean over the frames with a pose",
}


def summary(scores: MethodScores) -> dict[str, Any]:
    """The entry of one method in the JSON document."""
    errors = scores.orientation_errors
    return {
        "n": len(scores.frames),
        "mae_deg": float(errors.mean()),
        "median_deg": float(np.median(errors)),
        "aop": {str(t): 100.0 * orientation_precision(errors, t) for t in THRESHOLDS},
        "frames_within": {str(t): instances_within(errors, t) for t in THRESHOLDS},
        "median_translation_m": finite(float(np.median(scores.translation_errors))),
        "ms": {stage: scores.milliseconds(stage) for stage in STAGES},
        "prior": scores.prior,
        "summary": scores.summary,
        "failures": [{"frame": frame.frame, "reason": frame.failure} for frame in scores.failures],
    }


def document(
    scores: Sequence[MethodScores], files: Sequence[tuple[str, Track]], scene: SceneKnowledge, notes: Mapping[str, str]
) -> dict[str, Any]:
    """The JSON document of a run: every method, and under which conditions, with notes where the scene's are from."""
    return {
        "format": FORMAT,
        "methods": {entry.name: summary(entry) for entry in scores},
        "units": _UNITS,
        "machine": machine(),
        "versions": versions(),
        "files": [
            {
                "path": path,
                "frames": len(track.frames),
                "frames_without_keypoints": [f.name for f in track.frames if f.observation is None],
            }
            for path, track in files
        ],
        "settings": settings(scene, notes),
    }


def settings(scene: SceneKnowledge, notes: Mapping[str, str]) -> dict[str, Any]:
    """What the user knew about the scene, as plain values."""
    return {
        "prior": scene.prior.describe(),
        "ground": {"normal": scene.ground.normal.tolist(), "distance_m": scene.ground.distance},
        "size_prior": {
            "name": scene.size.name,
            "mean_m": scene.size.mean.tolist(),
            "sigma_m": scene.size.sigma.tolist(),
        },
        "notes": dict(notes),
    }


def frames_document(scores: Sequence[MethodScores]) -> dict[str, Any]:
    """Every frame's result by method and frame: errors, estimate in the label's frame, times, failure."""
    return {
        "format": f"{FORMAT}/frames",
        "methods": {
            entry.name: [
                {
                    "frame": frame.frame,
                    "orientation_deg": frame.orientation_error,
                    "translation_m": finite(frame.translation_error),
                    "rotation_y": frame.rotation_y,
                    "location": None if frame.location is None else frame.location.tolist(),
                    "ms": frame.milliseconds,
                    "failure": frame.failure,
                }
                for frame in entry.frames
            ]
            for entry in scores
        },
    }


def to_json(content: Mapping[str, Any]) -> str:
    """Indented JSON text; every number in it is finite."""
    return json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def table(scores: Sequence[MethodScores], *, narrow: bool = False) -> TextTable:
    """The table of all methods; a narrow one, for a terminal of 80 columns, is without prior and number of failures."""
    left_out = ("failed", "prior") if narrow else ()
    return TextTable.of([{name: cell for name, cell in _cells(one).items() if name not in left_out} for one in scores])


def machine() -> dict[str, Any]:
    """The machine that the times were measured on."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
    }


def versions() -> dict[str, str]:
    """Versions of the packages that the methods run on."""
    return {package: metadata.version(package) for package in _PACKAGES}


def _processor() -> str:
    try:  # `platform.processor` is empty on most Linux systems
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or "unknown"
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor() or "unknown"


def _cells(scores: MethodScores) -> dict[str, str]:
    """A row of the table, by its headings."""
    entry = summary(scores)
    return {
        "method": scores.name,
        "N": str(entry["n"]),
        "mean °": f"{entry['mae_deg']:.2f}",
        "median °": f"{entry['median_deg']:.2f}",
        **{f"AOP {threshold}° %": f"{value:.1f}" for threshold, value in entry["aop"].items()},
        "median m": number_or_dash(entry["median_translation_m"], ".2f"),
        **{f"ms {stage}": number_or_dash(entry["ms"][stage], ".2f") for stage in STAGES},
        "failed": str(len(entry["failures"])),
        "prior": scores.prior,
    }
