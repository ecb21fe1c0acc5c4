"""The refinement networks' geometry: patches, and fusion with KNet's likelihood."""

import numpy as np
import pytest

from fgrecon.perception.keypoints.crops import cut_patches, fuse, patch_offsets, run_networks, window_of
from fgrecon.perception.keypoints.decode import decode
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon.perception.keypoints.layout import PATCH, KNetSettings, RefineLayout, RefineSettings
from fgrecon.perception.keypoints.network_file import load_weights, save_weights
from tests.perception.untrained import untrained, untrained_arrays

SMALL = RefineSettings(crop=64, width=2)


def test_patches_are_cut_where_asked_and_repeat_the_edge():
    crops = np.arange(2 * 40 * 40 * 3, dtype=np.int64).reshape(2, 40, 40, 3) % 251
    crops = crops.astype(np.uint8)
    corners = np.array([[[[4, 6], [-10, 0]]], [[[8, 8], [20, 20]]]])
    patches = cut_patches(crops, corners)
    assert patches.shape == (2, 1, 2, 3, PATCH, PATCH)
    np.testing.assert_array_equal(patches[0, 0, 0], np.moveaxis(crops[0, 6:38, 4:36], -1, 0))
    np.testing.assert_array_equal(patches[0, 0, 1, :, 0, :10], np.repeat(crops[0, 0, 0][:, None], 10, axis=1))


def test_what_patches_agree_on_is_found_between_pixels():
    rng = np.random.default_rng(0)
    truth = rng.uniform(50, 80, (2, 14, 2))
    centres = np.rint(truth + rng.normal(0, 3, truth.shape)).astype(np.int64)
    offsets = patch_offsets(4, 14)
    corners = centres[:, None] + offsets - PATCH // 2
    span = np.arange(PATCH)
    x, y = corners[..., 0, None] + span, corners[..., 1, None] + span
    u, v = truth[:, None, :, 0, None], truth[:, None, :, 1, None]
    logs = -(((y - v) ** 2)[..., :, None] + ((x - u) ** 2)[..., None, :]) / (2 * 1.5**2)
    flat = np.zeros((2, 14, 48, 48))
    joint, origin = fuse(logs, offsets, centres, flat, 1.0)
    np.testing.assert_allclose(joint.sum(axis=(2, 3)), 1.0)
    np.testing.assert_allclose(decode(joint, 1.0, 10.0).points + origin, truth, atol=0.1)


def test_the_window_of_knets_map_lies_where_it_should():
    maps = np.full((1, 1, 48, 48), 1e-9)
    maps[0, 0, 20, 30] = 1.0  # at 60.5, 40.5 of a crop of 96 pixels: at 111.4, 74.75 of one of 176
    centres = np.array([[[110, 75]]])
    window = window_of(maps, centres, 176)
    row, column = np.unravel_index(window[0, 0].argmax(), (48, 48))
    np.testing.assert_allclose([column + 110 - 24, row + 75 - 24], [111.4, 74.7], atol=1.0)


def test_a_window_beyond_the_border_repeats_it_on_maps_of_any_size():
    rng = np.random.default_rng(0)
    for side in (6, 16, 48):
        maps = rng.random((2, 3, side, side))
        centres = rng.integers(-5, 180, (2, 3, 2))
        window = window_of(maps, centres, 176)
        # The plain way, a pixel at a time.
        for b, k, v, u in [(0, 0, 0, 0), (0, 1, 47, 0), (1, 2, 20, 30), (1, 0, 47, 47), (0, 2, 0, 47)]:
            x, y = np.clip((centres[b, k] + [u - 24, v - 24] + 0.5) * side / 176 - 0.5, 0, side - 1)
            c, r = (min(int(place), side - 2) for place in (x, y))
            four, (p, q) = np.log(maps[b, k, r : r + 2, c : c + 2] + 1e-7), (x - c, y - r)
            assert window[b, k, v, u] == pytest.approx(np.array([1 - q, q]) @ four @ np.array([1 - p, p]))


def test_each_keypoint_has_a_network_of_its_own():
    pytest.importorskip("torch")
    from fgrecon.perception.keypoints.on_torch import refinement_on_torch

    layout = RefineLayout.of(SMALL)
    patches = np.random.default_rng(0).integers(0, 255, (1, 1, 14, 3, PATCH, PATCH)).astype(np.uint8)
    runner = refinement_on_torch(layout, untrained_arrays(layout), "cpu", 1)
    before = run_networks(runner, patches)
    np.testing.assert_allclose(np.exp(before).sum(axis=(-1, -2)), 1.0, atol=1e-5)
    patches[0, 0, 3] = 0
    changed = np.abs(run_networks(runner, patches) - before).max(axis=(-1, -2))[0, 0] > 1e-6
    assert changed.nonzero()[0].tolist() == [3]


def test_a_cascade_from_a_file_moves_points_only_within_the_patches(tmp_path):
    stored = untrained(KNetSettings(crop=32, width=8), SMALL, trust=1.0)
    path = save_weights(tmp_path / "w.safetensors", stored)
    assert load_weights(path).refine_settings == SMALL.to_dict()
    image = np.random.default_rng(0).integers(0, 255, (90, 140, 3)).astype(np.uint8)
    boxes = [[10, 10, 110, 80], [20, 5, 90, 85.0]]
    alone, cascade = (KeypointCascade(path, refine=refine)(image, boxes) for refine in (False, True))
    for a, b in zip(alone, cascade, strict=True):
        moved = np.linalg.norm(a.observation.keypoints - b.observation.keypoints, axis=1) * b.crop.scale * 2
        assert 0 < moved.max() < 34
        np.testing.assert_allclose(a.observation.confidence, b.observation.confidence)
        assert np.linalg.eigvalsh(b.observation.covariance).min() > 0
