"""The names of everything in a recording: entities, timelines and the components of the exact history.

| entity | what | when |
|---|---|---|
| `scene` | the 3D world: the camera's frame, x right, y down, z forward, metres | once |
| `scene/camera` | the pinhole camera; its image plane holds the next six | once |
| `.../image` | the photograph | once |
| `.../box` | the 2D box of the observation | once |
| `.../keypoints` | detected keypoints, colour and size by weight | every step |
| `.../wireframe/{left,right,across}` | projected wireframe | every step |
| `.../residuals` | line from each detected keypoint to its projection | every step |
| `.../truth` | the true box in the image | once |
| `scene/vehicle` | `camera_T_object`; what is below it is in the object frame | every step |
| `.../keypoints` | 3D keypoints, colour by weight | every step |
| `.../wireframe/{left,right,across}` | 3D wireframe | every step |
| `.../surface`, `.../box`, `.../uncertainty` | surface, box, one-sigma ellipsoids of the keypoints | at the result |
| `scene/truth`, `.../box`, `.../keypoints` | true pose, box and keypoints | once |
| `scene/ground` | grid on the ground | once |
| `energy/<term>`, `energy/total` | energy by term | every step |
| `weights`, `coefficients` | one series per keypoint, per coefficient | every step |
| `error/<measure>` | distance from the truth | every step |
| `log` | what happened, and why it stopped | each weight update |
| `summary` | the result as a table | once |
| `history` | every field of every `Iteration`, in full precision | every step |

Timelines: `step` counts the steps across all stages and `irls` the weight updates across all stages; one more per stage
(`initialisation`, `pose`, `shape`, `joint`, or `result` where no history was kept) counts the steps within it. Drawn
geometry is in single precision, as viewers want it; plots and `history` are in double, and `fgrecon.replay` reads them
back to the last bit.
"""

from __future__ import annotations

__all__ = [
    "BOX_2D",
    "CAMERA",
    "COEFFICIENTS",
    "ENERGY",
    "ERROR",
    "GROUND",
    "HISTORY",
    "HISTORY_ARCHETYPE",
    "IMAGE",
    "IRLS",
    "KEYPOINTS_2D",
    "KEYPOINTS_3D",
    "LOG",
    "RESIDUALS",
    "SCENE",
    "STEP",
    "SUMMARY",
    "SURFACE",
    "TOTAL",
    "TRUTH_2D",
    "TRUTH_3D",
    "UNCERTAINTY",
    "VEHICLE",
    "VEHICLE_BOX",
    "WEIGHTS",
    "WIREFRAME_2D",
    "WIREFRAME_3D",
]

STEP = "step"
IRLS = "irls"

SCENE = "scene"
CAMERA = "scene/camera"
IMAGE = "scene/camera/image"
BOX_2D = "scene/camera/box"
KEYPOINTS_2D = "scene/camera/keypoints"
WIREFRAME_2D = "scene/camera/wireframe"
RESIDUALS = "scene/camera/residuals"
TRUTH_2D = "scene/camera/truth"

VEHICLE = "scene/vehicle"
KEYPOINTS_3D = "scene/vehicle/keypoints"
WIREFRAME_3D = "scene/vehicle/wireframe"
SURFACE = "scene/vehicle/surface"
VEHICLE_BOX = "scene/vehicle/box"
UNCERTAINTY = "scene/vehicle/uncertainty"
TRUTH_3D = "scene/truth"
GROUND = "scene/ground"

ENERGY = "energy"
TOTAL = "total"
WEIGHTS = "weights"
COEFFICIENTS = "coefficients"
ERROR = "error"

LOG = "log"
SUMMARY = "summary"
HISTORY = "history"
HISTORY_ARCHETYPE = "fgrecon.Iteration"
