"""A category of one's own, from a JSON file: a lorry's box body by its eight corners, and a shape prior for it.

N(0, I) ---- L(0) ---- reprojection_i ---- X(0,0) ---- ground
        (length, height)      |
                      faces of the file
"""

import json
import tempfile
from pathlib import Path

import numpy as np

import fgrecon
from fgrecon.simulation import KITTI_CAMERA, yaw_pose

CORNERS = [f"{x}_{y}_{z}" for x in ("front", "rear") for y in ("top", "bottom") for z in ("left", "right")]
SIGNS = np.array([[x, y, z] for x in (1, -1) for y in (1, 0) for z in (1, -1)], dtype=float)
FRONT, REAR, TOP, BOTTOM, LEFT, RIGHT = (
    [corner for corner in CORNERS if part in corner] for part in ("front", "rear", "top", "bottom", "left", "right")
)
CATEGORY = {
    "name": "box8",
    "keypoints": CORNERS,
    "symmetric_pairs": list(zip(LEFT, RIGHT, strict=True)),
    "faces": [
        {"name": "roof", "keypoints": [TOP[0], TOP[1], TOP[3], TOP[2]], "ground_parallel": True, "rectangular": True},
        {"name": "doors", "keypoints": [REAR[0], REAR[1], REAR[3], REAR[2]], "rectangular": True},
    ],
    "neighbours": {corner: [] for corner in CORNERS},  # no Laplacian: a box's size is all that varies
    "edges": [[CORNERS[i], CORNERS[i + step]] for step in (1, 2, 4) for i in range(8) if not i & step],
    "dimensions": {
        "length": {"plus": FRONT, "minus": REAR, "ratio": 1.0},
        "width": {"plus": LEFT, "minus": RIGHT, "ratio": 1.0},
        "height": {"plus": TOP, "minus": BOTTOM, "ratio": 1.0},
    },
    "ground": {"keypoints": BOTTOM, "ratio": 0.0},
}


def main() -> None:
    (file := Path(tempfile.mkdtemp()) / "box8.json").write_text(json.dumps(CATEGORY), encoding="utf-8")
    mean = SIGNS * [3.5, -2.6, 1.25]  # metres: 7 m long, 2.5 m wide, 2.6 m high; y points down
    basis = np.stack([mean * [0.25, 0, 0], mean * [0, 0.12, 0]])  # one sigma each: length 25 %, height 12 %
    prior = fgrecon.ShapePrior(fgrecon.load_category(file), mean, basis, np.full(8, 0.03), np.array([0.8, 0.2]))

    pose = yaw_pose(yaw=2.4, location=np.array([3.0, 1.65, 18.0]))
    corners = prior.keypoints([1.0, -0.5]) @ pose[:3, :3].T + pose[:3, 3]
    keypoints = KITTI_CAMERA.project(corners) + np.random.default_rng(1).normal(0, 1.0, (8, 2))
    keypoints[5] = np.nan  # one corner was not found, the others to within a pixel
    pixel = np.tile(np.eye(2), (8, 1, 1))
    result = fgrecon.reconstruct(keypoints, KITTI_CAMERA, covariance=pixel, prior=prior, ground=1.65)
    print(f"{result.status}: yaw {np.degrees(result.rotation_y):.1f} (true {np.degrees(2.4):.1f}) degrees")
    print(f"position {result.location.round(2)} (true {pose[:3, 3]}) m")
    print(f"length, width, height {result.box_size.round(2)} (true {prior.box_size([1.0, -0.5]).round(2)}) m")


if __name__ == "__main__":
    main()
