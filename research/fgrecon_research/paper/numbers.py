"""What the paper prints (Murthy et al., ICRA 2017, Tables I to IV), for the rows beside ours.

The paper's instances, keypoints and initial boxes are not public, so these rows stand beside ours and not against them:
14,327 cars of 3,424 validation images there, with keypoints of its own network.
"""

from __future__ import annotations

from collections.abc import Mapping

Nine = tuple[float, float, float, float, float, float, float, float, float]
Three = tuple[float, float, float]

PRINTED_AOP: Mapping[str, Nine] = {
    "ObjProp3D (stereo)": (40.04, 81.37, 91.83, 36.76, 77.41, 89.31, 33.98, 73.22, 85.81),
    "Mono3D": (42.20, 84.59, 92.90, 38.52, 80.60, 90.08, 35.78, 76.27, 86.67),
    "ASPnP": (1.06, 6.18, 27.26, 1.59, 6.35, 25.40, 2.87, 6.90, 25.29),
    "Pose adjustment": (53.62, 90.44, 95.95, 48.50, 85.67, 94.44, 44.72, 80.98, 89.08),
}
"""Table I: percent within 5, 15, 30 degrees on Easy, Moderate, Hard."""

PRINTED_APK: Mapping[str, Three] = {
    "Initialization": (47.31, 51.65, 43.17),
    "Pose adjustment": (62.42, 62.72, 59.89),
    "Shape adjustment": (80.72, 81.81, 71.39),
}
"""Table II: APK on Easy, Moderate, Hard, percent."""

PRINTED_HAUSDORFF: Mapping[str, Three] = {
    "Initialization": (0.00, 0.00, 0.00),
    "Pose adjustment": (3.71, 4.64, 4.79),
    "Shape adjustment": (3.75, 4.69, 4.83),
    "Between pose and shape adjustment": (0.27, 0.28, 0.04),
}
"""Table II: Hausdorff distance from the mean shape where the initialisation puts it (no unit is printed)."""

PRINTED_MAE: Mapping[str, Three] = {
    "ObjProp3D (stereo)": (17.32, 21.86, 26.87),
    "Mono3D": (15.14, 15.15, 17.82),
    "ASPnP": (98.17, 98.82, 98.83),
    "Pose adjustment": (8.79, 12.57, 16.19),
}
"""Table III: mean absolute orientation error, degrees."""

PRINTED_MS: Mapping[str, float] = {"pose adjustment": 9.97, "keypoint network (GPU)": 200.79, "shape adjustment": 52.0}
"""Table IV: milliseconds an instance."""
