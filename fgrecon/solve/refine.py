"""Refinement of a detector's 3D box by a vehicle's solve; the same box where the image says little."""

from __future__ import annotations

import numpy as np

from fgrecon.core.box3d import Box3D, BoxErrors
from fgrecon.core.errors import FgreconError
from fgrecon.core.geometry import position_covariance
from fgrecon.core.reconstruction import TRUSTED, Reconstruction
from fgrecon.core.refined_box import RefinedBox
from fgrecon.solve.solve_settings import SCENE


def refined(given: Box3D, errors: BoxErrors, result: Reconstruction | None, error: FgreconError | None) -> RefinedBox:
    """What becomes of a box.

    Args:
        errors: How far it is off.
        result: The vehicle that was solved with it (`fgrecon.reconstruct_scene`), or None where it was refused.
        error: Why it was refused, or None.
    """
    if result is None:
        return RefinedBox(given, given, f"Unchanged: {error}")
    weak = _weak(result) or _contradiction(given, errors, result)
    covariance, size = result.uncertainty.pose_covariance, result.uncertainty.size_covariance
    if weak is not None or covariance is None or size is None:
        return RefinedBox(given, given, f"Unchanged: {weak or result.message}", result)
    return RefinedBox(
        given=given,
        box=Box3D(result.location, result.rotation_y, result.box_size),
        message=result.message,
        result=result,
        location_covariance=position_covariance(result.camera_T_object, covariance),
        yaw_sigma=float(np.sqrt(covariance[1, 1])),
        size_covariance=size,
    )


def _weak(result: Reconstruction) -> str | None:
    """Why a result says nothing; None where it says something."""
    if not result.status.determined:
        return result.message
    trusted = int(np.count_nonzero(result.diagnostics.weights >= TRUSTED))
    return (
        None
        if trusted >= SCENE.refined_keypoints
        else f"{trusted} keypoints are trusted; it takes {SCENE.refined_keypoints}."
    )


def _contradiction(given: Box3D, errors: BoxErrors, result: Reconstruction) -> str | None:
    """What speaks against a result being the box's vehicle; None where nothing does."""
    farther = float(result.location[2] / given.location[2]) - 1.0
    if abs(farther) > SCENE.refined_contradiction_sigmas * errors.depth:
        return f"The keypoints show it {100.0 * abs(farther):.0f} % {'farther' if farther > 0.0 else 'nearer'}."
    off = abs(float(np.arctan(np.tan(result.rotation_y - given.rotation_y))))  # modulo half a turn
    if off > SCENE.refined_contradiction_sigmas * errors.yaw:
        return f"The keypoints show it turned by {np.rad2deg(off):.0f} degrees against the box."
    return None
