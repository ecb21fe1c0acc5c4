"""A reconstruction in words: the text log and summary of a recording, the titles and caption of a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import ne

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.geometry import position_covariance, view_azimuth
from fgrecon.core.observation import Observation
from fgrecon.core.reconstruction import TRUSTED, Iteration, Reconstruction
from fgrecon.core.text import markdown_row
from fgrecon.core.track_reconstruction import TrackReconstruction
from fgrecon.viz.subjects import ORIENTATION_ERROR, SHAPE_ERROR, TRANSLATION_ERROR, SolvedVehicle, Truth

LEVEL = 0.95
"""Probability with which the true values are within the bounds and regions that are shown."""
SIGMAS = 1.96  # standard deviations of that, in one dimension
_SETTLED = 1e-2  # weights that change by less look settled to a reader


def total_energy(iteration: Iteration) -> float:
    """What the solver minimises at this step: the sum of the energies of all terms."""
    return float(sum(iteration.energies.values()))


def weight_updates(history: Sequence[Iteration]) -> NDArray[np.int64]:
    """(n,) index of the weight update that each step belongs to, counted across all stages from 0."""
    updates = [(step.stage, step.irls) for step in history]
    return np.cumsum([False, *map(ne, updates[1:], updates)][: len(updates)], dtype=np.int64)


def median_residual(observation: Observation, projections: Array, weights: Array) -> float:
    """Median distance in pixels from the trusted keypoints (weight at least 0.5, else all) to projections (K, 2)."""
    across, down = (observation.keypoints - projections).T
    distances = np.hypot(across, down)
    usable = np.isfinite(distances)
    trusted = usable & (weights >= TRUSTED)
    chosen = np.sort(distances[trusted if trusted.any() else usable])
    count = len(chosen)  # numpy's median costs as much as all of the rest, and this is computed at every update
    return float((chosen[(count - 1) // 2] + chosen[count // 2]) / 2) if count else float("nan")


def describe_update(steps: Sequence[Iteration], residual: float) -> str:
    """One line about the steps of one weight update: energy before and after, trusted keypoints, what they miss by."""
    first, last = steps[0], steps[-1]
    before, after = total_energy(first), total_energy(last)
    change = f"{after:.4g}" if len(steps) == 1 else f"{before:.4g} to {after:.4g} in {len(steps)} steps"
    trusted = f"{np.count_nonzero(last.weights >= TRUSTED)} of {len(last.weights)} trusted"
    return f"{last.stage} {last.irls}: energy {change}; {trusted}, off by {residual:.1f} px"


def describe_stop(before: Iteration | None, steps: Sequence[Iteration]) -> str:
    """Why a stage stopped: how much its last weight update still changed.

    Args:
        before: Last step of the weight update before, or None where there is none.
        steps: Steps of the last weight update.
    """
    last = steps[-1]
    if before is None or before.stage != last.stage:
        return f"{last.stage} ended after one weight update"
    change = float(np.abs(last.weights - before.weights).max())
    energy = total_energy(last) - total_energy(before)
    verdict = "weights settled" if change < _SETTLED else f"weights still changed by {change:.2g}"
    return f"{last.stage} ended after update {last.irls}: {verdict}, energy by {energy:+.2g}"


def describe_errors(truth: Truth, camera_T_object: Array, keypoints: Array) -> str:
    """The distance of an estimate from the truth in one line: yaw, translation and, where known, shape."""
    errors = truth.errors(camera_T_object, keypoints)
    parts = [f"yaw {errors[ORIENTATION_ERROR]:.1f}°", f"position {errors[TRANSLATION_ERROR]:.2f} m"]
    if SHAPE_ERROR in errors:
        parts.append(f"shape {100 * errors[SHAPE_ERROR]:.1f} cm")
    return ", ".join(parts)


def bounds_of(result: Reconstruction) -> tuple[float, float] | None:
    """Distance in metres and yaw in degrees are known to within these with the probability `LEVEL`; None: not known."""
    covariance = result.uncertainty.pose_covariance
    if covariance is None or not np.isfinite(covariance).all():
        return None
    towards = result.location / max(float(np.linalg.norm(result.location)), 1e-9)
    along = np.sqrt(towards @ position_covariance(result.camera_T_object, covariance) @ towards)
    return SIGMAS * float(along), SIGMAS * float(np.degrees(np.sqrt(covariance[1, 1])))  # yaw about its y axis


def describe_bounds(result: Reconstruction) -> str:
    """The same in words; empty where it is not known."""
    bounds = bounds_of(result)
    return "" if bounds is None else f"{100 * LEVEL:.0f} %: ± {bounds[0]:.1f} m, ± {bounds[1]:.0f}°"


def summary_table(vehicle: SolvedVehicle) -> str:
    """The result as a Markdown table."""
    result, truth = vehicle.reconstruction, vehicle.truth
    length, width, height = result.box_size
    x, y, z = result.location
    residual = median_residual(vehicle.observation, result.pose.wireframe_uv, result.diagnostics.weights)
    rows = [
        ("Status", f"**{result.status.value}**: {result.message}"),
        *([("Detection", vehicle.detection)] if vehicle.detection else []),
        ("Prior", f"{result.shape.prior} ({result.shape.category})"),
        ("Yaw (rotation_y)", f"{np.degrees(result.rotation_y):.1f}°"),
        ("Position in the camera frame", f"{x:.2f}, {y:.2f}, {z:.2f} m"),
        ("Length, width, height", f"{length:.2f}, {width:.2f}, {height:.2f} m"),
        ("Median residual of trusted keypoints", f"{residual:.2f} px"),
        ("Other poses that the search ended in", _alternatives(result)),
        (
            "Time",
            ", ".join(f"{stage} {ms:.1f} ms" for stage, ms in result.diagnostics.milliseconds.items())
            or "not measured",
        ),
    ]
    if truth is not None:
        rows.append(("Error against the truth", describe_errors(truth, result.camera_T_object, result.wireframe)))
    return "".join(["| | |\n|---|---|\n", *map(markdown_row, rows)])


def scene_table(vehicles: Sequence[tuple[str, SolvedVehicle]]) -> str:
    """The results of a scene, by title, as a Markdown table."""
    rows, detected = [], any(vehicle.detection for _, vehicle in vehicles)
    for title, vehicle in vehicles:
        result = vehicle.reconstruction
        cells = [title, *([vehicle.detection] if detected else []), result.status.value]
        if np.isfinite(result.camera_T_object).all():
            cells += [
                ", ".join(f"{metres:.2f}" for metres in result.location),
                f"{np.degrees(result.rotation_y):.1f}",
                ", ".join(f"{metres:.2f}" for metres in result.box_size),
            ]
        rows.append(markdown_row(cells))
    heading = ("", *(["detection"] if detected else []), "status", "x, y, z [m]", "yaw [°]", "l, w, h [m]")
    return markdown_row(heading) + f"|{'---|' * len(heading)}\n" + "".join(rows)


def track_table(track: TrackReconstruction, errors: Sequence[Mapping[str, float]]) -> str:
    """The result of a track as a Markdown table, with mean and median of the frames' errors where they are known."""
    length, width, height = track.box_size
    rows = [
        ("Status", f"**{track.status.value}**: {track.message}"),
        ("Prior", f"{track.frames[0].shape.prior} ({track.frames[0].shape.category})"),
        ("Images", f"{len(track.frames)} solved, {len(track.refused)} refused"),
        ("Length, width, height", f"{length:.2f}, {width:.2f}, {height:.2f} m"),
        ("Time", ", ".join(f"{stage} {ms:.0f} ms" for stage, ms in track.milliseconds.items())),
    ]
    for name, measure, unit in (("Yaw error", ORIENTATION_ERROR, "°"), ("Position error", TRANSLATION_ERROR, " m")):
        if errors:
            values = [error[measure] for error in errors]
            rows.append((name, f"mean {np.mean(values):.2f}{unit}, median {np.median(values):.2f}{unit}"))
    return "".join(["| | |\n|---|---|\n", *map(markdown_row, rows)])


def _alternatives(reconstruction: Reconstruction) -> str:
    excesses = [other.excess for other in reconstruction.uncertainty.alternatives if np.isfinite(other.excess)]
    count = str(len(reconstruction.uncertainty.alternatives))
    return f"{count}, the best {min(excesses):.1f} nats worse" if excesses else count


def state_in_words(what: str, camera_T_object: Array) -> str:
    """A status or stage, and whether the camera observes the vehicle's front or its rear."""
    azimuth = float(view_azimuth(camera_T_object[:3, :3], camera_T_object[:3, 3]))
    return f"{what}, {'front' if abs(azimuth) < np.pi / 2 else 'rear'}"
