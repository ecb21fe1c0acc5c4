"""A keypoint network of one's own, and a vehicle detector of one's own, in the place of the package's.

The network here is a stand-in: it draws the heat maps that a real one would predict for the rendered car.

     image ---- own detector ---- box ---- own network ---- heat map_i ---- peak_i, height_i
                                   |                                            |
     N(0, I) ---- L(0) ------------|------------------+-------------------------+
                (lambda)           |                  |                  reprojection_i
                                   |       symmetry, faces, size          (weight w_i)
     ground ---- X(0,0) ------- 2D box -----------------------------------------+
                 (pose)
"""

import numpy as np

import fgrecon
from fgrecon.simulation import DemoScene, demo_scene

SIDE = 64  # pixels of a heat map


class OwnNetwork:
    """Heat maps of a network as observations."""

    category = "car14"  # whose keypoints it finds, in this order

    def __init__(self, scene: DemoScene) -> None:
        self.scene = scene

    def __call__(self, image: np.ndarray, boxes: np.ndarray) -> list[fgrecon.Observation]:
        """An observation for each box (N, 4) of an image (H, W, 3)."""
        return [self._look(image, box) for box in boxes]

    def _look(self, image: np.ndarray, box: np.ndarray) -> fgrecon.Observation:
        maps = self._heat_maps(image, box)  # yours: torch, ONNX, a service, ...
        row, column = np.divmod(maps.reshape(len(maps), -1).argmax(axis=1), SIDE)
        cell = (box[2:] - box[:2]) / SIDE
        return fgrecon.Observation(box[:2] + np.column_stack([column, row]) * cell, maps.max(axis=(1, 2)), box)

    def _heat_maps(self, _: np.ndarray, box: np.ndarray) -> np.ndarray:
        seen, cells = self.scene.observation, np.arange(SIDE)
        u, v = ((seen.keypoints - box[:2]) / (box[2:] - box[:2]) * SIDE).T[..., None]
        across, down = np.exp(-((cells - u) ** 2) / 8), np.exp(-((cells - v) ** 2) / 8)
        return seen.confidence[:, None, None] * down[:, :, None] * across[:, None, :]


def main() -> None:
    scene = demo_scene(fgrecon.load_prior("car14"), seed=1)
    own = {
        "vehicle_detector": lambda _: fgrecon.Vehicles([scene.observation.box], [1.0]),  # boxes and scores
        "keypoint_detector": OwnNetwork(scene),
    }
    (car,) = fgrecon.reconstruct_image(scene.picture.image, scene.camera, ground=scene.ground, **own)
    print(car.result)
    print(f"true rotation_y {np.degrees(fgrecon.rotation_y(scene.truth.camera_T_object)):.1f} degrees")


if __name__ == "__main__":
    main()
