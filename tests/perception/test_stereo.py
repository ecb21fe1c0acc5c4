"""Depth from made-up pairs of images, rectified and not."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from fgrecon.core.camera import Camera
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.evidence import StereoPair
from fgrecon.core.geometry import exponential
from fgrecon.perception.stereo import SETTINGS, stereo_depth

WIDTH, HEIGHT, FOCAL, BASELINE = 320, 120, 300.0, 0.5
CAMERA = Camera(np.array([[FOCAL, 0, 160.0], [0, FOCAL, 60.0], [0, 0, 1]]))


def _pair(right_T_left: np.ndarray, right: Camera = CAMERA) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two images of a textured board that stands 8 m away before a wall 20 m away, and the left depth (H, W)."""
    texture = np.random.default_rng(0).integers(0, 255, (600, 1600), dtype=np.uint8)
    texture = gaussian_filter(texture.astype(float), 1.2)
    texture = 255.0 * (texture - texture.min()) / np.ptp(texture)

    def look(camera: Camera, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        grid = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), axis=-1).astype(float)
        rays = camera.rays(grid.reshape(-1, 2)) @ pose[:3, :3]
        origin = -pose[:3, :3].T @ pose[:3, 3]
        image, depth = np.zeros(len(rays)), np.full(len(rays), np.nan)
        for distance, reach, place in ((20.0, np.inf, 900.0), (8.0, 1.5, 300.0)):
            where = origin + rays * ((distance - origin[2]) / rays[:, 2])[:, None]
            hit = np.abs(where[:, 0]) < reach
            column, row = (60.0 * where[:, :2] * 8.0 / distance + [place, 300.0]).T
            shown = map_coordinates(texture, [row, column], order=1, mode="grid-wrap")
            image[hit], depth[hit] = shown[hit], distance
        return image.reshape(HEIGHT, WIDTH).astype(np.uint8), depth.reshape(HEIGHT, WIDTH)

    left, depth = look(CAMERA, np.eye(4))
    return left, look(right, right_T_left)[0], depth


def _motion(turn: tuple[float, float, float] = (0, 0, 0), aside: tuple[float, float] = (0, 0)) -> np.ndarray:
    motion = np.eye(4)
    motion[:3, :3] = exponential(np.array(turn))
    motion[:3, 3] = [-BASELINE, *aside]
    return motion


@pytest.mark.parametrize(
    ("motion", "right"),
    [
        (_motion(), CAMERA),
        (_motion(), Camera(np.array([[FOCAL, 0, 165.0], [0, FOCAL, 60.0], [0, 0, 1]]))),
        (_motion((0.01, -0.02, 0.015), (0.03, 0.02)), CAMERA),
    ],
)
def test_depth_of_a_board_before_a_wall(motion: np.ndarray, right: Camera) -> None:
    left, seen, depth = _pair(motion, right)
    found = stereo_depth(left, CAMERA, StereoPair(seen, right, motion))
    matched = np.isfinite(found.depth)
    assert matched.mean() > 0.5
    off = np.abs(found.depth - depth)[matched]
    assert np.median(off / depth[matched] ** 2) * FOCAL * BASELINE < 0.3  # pixels
    np.testing.assert_allclose(
        found.sigma[matched], SETTINGS.disparity_sigma_px * found.depth[matched] ** 2 / (FOCAL * BASELINE), rtol=0.3
    )
    assert found.shared_sigma == pytest.approx(SETTINGS.offset_sigma_px / (FOCAL * BASELINE), rel=0.3)


def test_what_is_no_pair_is_refused() -> None:
    left, right, _ = _pair(_motion())
    with pytest.raises(InvalidInputError, match="shape"):
        stereo_depth(left, CAMERA, StereoPair(right[:50], CAMERA, _motion()))
    with pytest.raises(InvalidInputError, match="the left image again"):
        stereo_depth(left, CAMERA, StereoPair(left.copy(), CAMERA, _motion()))
    with pytest.raises(InvalidInputError, match="right_T_left"):
        StereoPair(right, CAMERA, np.linalg.inv(_motion()))
