"""Names in a recording: entities, timelines and the components of the exact history.

| entity | what | when |
|---|---|---|
| `scene` | the 3D world: the camera's frame, x right, y down, z forward, metres | once |
| `scene/camera` | the pinhole camera; its image plane holds the next eight | once |
| `.../image` | the photograph | each frame |
| `.../box` | the 2D box of the observation | each frame |
| `.../keypoints` | detected keypoints, colour and size by weight | every step |
| `.../wireframe/{left,right,across}` | projected wireframe | every step |
| `.../previous` | the same, faint, as it was after the weight update before | every step |
| `.../residuals` | line from each detected keypoint to its projection | every step |
| `.../truth` | the true box in the image | each frame |
| `.../points` | points of other sensors in the image, colour by weight | at the result |
| `scene/vehicle` | `camera_T_object`; what is below it is in the object frame | every step |
| `.../keypoints` | 3D keypoints, colour by weight | every step |
| `.../wireframe/{left,right,across}` | 3D wireframe | every step |
| `.../planes/<face>`, `.../planes/medial` | faces' planes and the medial plane, fitted to keypoints | every step |
| `.../surface`, `.../box`, `.../uncertainty` | surface, box, one-sigma ellipsoids of the keypoints | at the result |
| `.../model` | the closest car model, where there were any to compare with | at the result |
| `scene/previous` | wireframe in the camera frame, faint, after the weight update before | every step |
| `scene/points` | points of other sensors, colour by weight | at the result |
| `scene/alternatives` | other poses of at least 1 %: an arrow along the heading, and how probable | at the result |
| `scene/truth`, `.../box`, `.../keypoints` | true pose, box and keypoints | each frame |
| `scene/ground` | grid on the ground | once |
| `graph` | the factor graph: variables and factors; keypoints' factors coloured by weight | every step |
| `energy` | energy by term, and their total; NaN where a step has no such term | every step |
| `weights`, `coefficients` | one series per keypoint, per coefficient | every step |
| `error/<measure>` | distance from the truth | every step |
| `log` | what happened, and why it stopped | each weight update |
| `summary` | the result as a table | once |
| `history` | every field of every `Iteration`, in full precision | every step |

The recording of a track (`fgrecon.viz.track_recording`) has the same for every frame, and in addition

| entity | what | when |
|---|---|---|
| `scene/path`, `scene/path/truth` | origins of the vehicle up to a frame, estimated and true | each frame |
| `scene/track` | wireframes of all frames | each joint step |
| `frames/weights`, `frames/energy` | weight by keypoint, energy by term | each frame |
| `frames/error/<measure>` | distance from the truth | each frame |
| `track` | every field of every `JointStep`, in full precision | each joint step |

The recording of a scene (`fgrecon.viz.scene_recording`) has the photograph, the camera and the ground once, and all
else for each vehicle: `scene/camera/...` at `scene/camera/vehicles/<id>/...`, other `scene/...` at
`scene/vehicles/<id>/...`, and what is not in the scene at `vehicles/<id>/...` (`of_vehicle`). Every vehicle begins at
step 0. In addition it has

| entity | what | when |
|---|---|---|
| `scene/camera/boxes` | the 2D boxes with the vehicles' ids | once |
| `scene/vehicles/<id>/vehicle/heading` | an arrow from the middle beyond the front, with the id | once |
| `scene/vehicles/<id>/position` | ellipsoid that holds the position with a probability of 95 % | at the result |
| `states/<id>` | stage, then status, and whether the camera sees front or rear | where it changes |

The recording of a video (`fgrecon.viz.video_recording`) has the timelines `frame` and `time`, and no `step`, since of a
frame only the end of its solve is known:

| entity | what | when |
|---|---|---|
| `image` | the photograph; below it `boxes` with ids and words, and `wireframes` | each frame |
| `world` | where the camera was first, or the world that its poses are in | once |
| `world/camera`, `world/here` | the pinhole camera; its frame alone, with `rings` every 10 m | each frame |
| `world/points` | points of other sensors, colour by weight | each frame |
| `world/cars`, `world/headings`, `world/paths` | boxes and wireframes; arrows with ids; past places | each frame |
| `plots/<value>/<id>` | a number; of yaw, length, width and height with its band of 95 % | each frame |
| `graph` | factors of the window of one vehicle | each frame |
| `states/<id>`, `log` | status and visible side; why a frame could not be read | where they change |

Timelines of the others: `step` counts the steps across all stages (and, of a track, all frames), `stage` the stages,
`irls` the weight updates across all stages, and `frame` is the number of the image. Drawn geometry is in single
precision, as viewers want it; plots and `history` are in double, and `fgrecon.viz.replay` reads them back to the last
bit. Each row of `history` and `track` is one struct, the component `fields` of an archetype of our own.
"""

from __future__ import annotations

STEP = "step"
STAGE = "stage"
IRLS = "irls"
FRAME = "frame"

SCENE = "scene"
CAMERA = "scene/camera"
IMAGE = "scene/camera/image"
BOX_2D = "scene/camera/box"
KEYPOINTS_2D = "scene/camera/keypoints"
WIREFRAME_2D = "scene/camera/wireframe"
PREVIOUS_2D = "scene/camera/previous"
RESIDUALS = "scene/camera/residuals"
TRUTH_2D = "scene/camera/truth"

VEHICLE = "scene/vehicle"
KEYPOINTS_3D = "scene/vehicle/keypoints"
WIREFRAME_3D = "scene/vehicle/wireframe"
PLANES = "scene/vehicle/planes"
MEDIAL = "medial"
SURFACE = "scene/vehicle/surface"
MODEL = "scene/vehicle/model"
VEHICLE_BOX = "scene/vehicle/box"
POINTS_2D = "scene/camera/points"
POINTS_3D = "scene/points"
ALTERNATIVES = "scene/alternatives"
UNCERTAINTY = "scene/vehicle/uncertainty"
PREVIOUS_3D = "scene/previous"
TRUTH_3D = "scene/truth"
GROUND = "scene/ground"

GRAPH = "graph"
ENERGY = "energy"
TOTAL = "total"
WEIGHTS = "weights"
COEFFICIENTS = "coefficients"
ERROR = "error"

LOG = "log"
SUMMARY = "summary"
HISTORY = "history"
HISTORY_ARCHETYPE = "fgrecon.Iteration"

BOXES_2D = "scene/camera/boxes"
HEADING = "scene/vehicle/heading"
POSITION = "scene/position"
IN_VEHICLES = "vehicles"
STATES = "states"

PATH = "scene/path"
TRUE_PATH = "scene/path/truth"
TRACK_3D = "scene/track"
FRAMES = "frames"
TRACK = "track"
JOINT_ARCHETYPE = "fgrecon.JointStep"

VIDEO_IMAGE = "image"
WORLD = "world"
WORLD_CAMERA = "world/camera"
HERE = "world/here"
RINGS = "world/here/rings"
WORLD_POINTS = "world/points"
PLOTS = "plots"
SIZES = ("length", "width", "height")
"""Plots of a vehicle's size."""


def of_vehicle(entity: str, name: str) -> str:
    """Where a scene's recording has an entity of one of its vehicles.

    Args:
        entity: The entity in the recording of a single vehicle.
        name: The vehicle's name in paths: letters, digits, dots, dashes and underscores.
    """
    for above in (CAMERA, SCENE):
        if entity.startswith(f"{above}/"):
            return f"{above}/{IN_VEHICLES}/{name}/{entity.removeprefix(f'{above}/')}"
    return f"{IN_VEHICLES}/{name}/{entity}"
