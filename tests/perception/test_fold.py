"""Networks made ready for inference say what they said before."""

import numpy as np
import pytest

from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon.perception.keypoints.export import folded_arrays
from fgrecon.perception.keypoints.layout import KNetLayout, RefineLayout, same
from fgrecon.perception.keypoints.weights import load_arrays, load_weights, shipped

torch = pytest.importorskip("torch")

from fgrecon.perception.keypoints.fold import folded, knet_on_torch, refinement_on_torch  # noqa: E402
from fgrecon.perception.keypoints.knet import KNet, KNetSettings  # noqa: E402
from fgrecon.perception.keypoints.refine import RefineNet, RefineSettings  # noqa: E402


@pytest.fixture(scope="module")
def networks():
    """KNet and the refinement networks as trained."""
    stored = load_weights(shipped())
    knet, refinement = KNet(KNetSettings(**stored.settings)), RefineNet(RefineSettings(**stored.refine_settings))
    knet.load_state_dict(stored.state, strict=False)
    refinement.load_state_dict(stored.refinement, strict=False)
    return knet.eval(), refinement.eval()


def pixels(*shape):
    return torch.from_numpy(np.random.default_rng(0).integers(0, 256, shape).astype(np.float32))


def parts(network, kind):
    return [part for part in network.modules() if isinstance(part, kind)]


def test_knet_says_the_same_without_normalisations_and_padding_by_hand(networks):
    knet, crops = networks[0], pixels(2, 3, 96, 96)
    fast = folded(knet)
    assert parts(knet, torch.nn.BatchNorm2d)  # the network itself is as it was
    assert not parts(fast, torch.nn.BatchNorm2d)
    assert {getattr(part, "pad", None) for part in fast.modules()} == {None}
    with torch.inference_mode():
        expected, found = knet(crops), fast(crops)
    for name in ("maps", "visible", "azimuth"):
        torch.testing.assert_close(getattr(found, name), getattr(expected, name), atol=5e-5, rtol=0.0)


def test_the_refinement_networks_say_the_same(networks):
    refinement, patches = networks[1], pixels(2, 14, 3, 32, 32)
    with torch.inference_mode():
        found, expected = folded(refinement)(patches), refinement(patches)
    torch.testing.assert_close(found, expected, atol=5e-5, rtol=0.0)


@pytest.mark.parametrize(("kernel", "side"), [(3, 32), (5, 32), (3, 33), (5, 31)])
def test_padding_on_one_side_goes_into_the_kernel(kernel, side):
    from fgrecon.perception.keypoints.knet import _Same

    torch.manual_seed(0)
    part = _Same(same("part", 4, 4, kernel, 2, groups=4)).eval()
    part.norm.running_mean.normal_()
    part.norm.weight.data.uniform_(0.5, 2.0)
    image = torch.randn(1, 4, side, side)
    with torch.inference_mode():
        torch.testing.assert_close(folded(part)(image), part(image), atol=1e-5, rtol=0.0)


@pytest.mark.parametrize("finer", [False, True])
def test_arrays_are_folded_as_modules_are(networks, finer):
    stored, network = load_arrays(shipped()), folded(networks[finer])
    if finer:
        layout = RefineLayout.of(networks[1].settings)
        arrays, layers = stored.refinement, [*layout.layers, layout.head]
    else:
        layout, arrays = KNetLayout.of(networks[0].settings), stored.state
        blocks = [*(block for stage in layout.stages for block in stage), *layout.smooth, layout.last]
        layers = [layout.stem, *(layer for block in blocks for layer in block.layers), *layout.lateral, layout.head]
    assert len(layers) == len(parts(network, torch.nn.Conv2d))
    for layer in layers:
        part = network.get_submodule(layer.name)
        conv = getattr(part, "conv", part)
        for found, expected in zip(folded_arrays(layer, arrays), (conv.weight, conv.bias), strict=True):
            np.testing.assert_allclose(found, expected.detach().numpy(), atol=1e-6, rtol=1e-6)
        assert conv.padding == (layer.padding[1],) * 2
        assert (conv.stride[0], conv.dilation[0], conv.groups) == (layer.stride, layer.dilation, layer.groups)


def test_points_move_by_less_than_a_hundred_thousandth_of_a_pixel(networks):
    cascade = KeypointCascade(runtime="torch")
    assert not parts(cascade.network, torch.nn.BatchNorm2d)
    assert not parts(cascade.refinement, torch.nn.BatchNorm2d)
    image = np.random.default_rng(0).integers(0, 255, (20, 30, 3)).astype(np.uint8)
    image = np.kron(image, np.ones((8, 8, 1), np.uint8))  # 160 x 240, in blocks
    boxes = [[10, 20, 120, 100], [60, 30, 220, 150.0]]
    found = cascade(image, boxes)
    cascade._find, cascade._refine_patches = knet_on_torch(networks[0], "cpu"), refinement_on_torch(networks[1], "cpu")
    for fast, slow in zip(found, cascade(image, boxes), strict=True):
        np.testing.assert_allclose(fast.observation.keypoints, slow.observation.keypoints, atol=1e-5)
        np.testing.assert_allclose(fast.observation.confidence, slow.observation.confidence, atol=1e-5)
        np.testing.assert_allclose(fast.observation.covariance, slow.observation.covariance, rtol=1e-5, atol=1e-5)
