"""The networks that look at images say what those say that were trained."""

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.perception.keypoints.crops import crop_of, extract
from fgrecon.perception.keypoints.decode import ConfidenceCalibration
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon.perception.keypoints.layout import KINDS, KNetLayout, KNetSettings, RefineLayout, RefineSettings, same
from fgrecon.perception.keypoints.network_file import Stored, load_weights, save_weights, shipped
from fgrecon.perception.keypoints.networks import folded_arrays

torch = pytest.importorskip("torch")

from fgrecon.perception.keypoints.on_torch import knet_on_torch, refinement_on_torch  # noqa: E402
from fgrecon_research.training.keypoints.knet import KNet, _Same  # noqa: E402
from fgrecon_research.training.keypoints.train_refine import RefineNet  # noqa: E402
from fgrecon_research.training.keypoints.trainer import load_tensors  # noqa: E402

CALIBRATION = ConfidenceCalibration()


def bytes_of(*shape):
    return np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)


def test_knet_says_the_same_without_normalisations_and_padding_by_hand():
    arrays, stored = load_weights(shipped()), load_tensors(shipped())
    sizes = KNetSettings(**stored.settings)
    knet = KNet(sizes).eval()
    knet.load_state_dict(stored.state, strict=False)
    crops = bytes_of(2, 96, 96, 3)
    with torch.inference_mode():
        expected = knet(torch.from_numpy(crops).permute(0, 3, 1, 2).float())
        likelihood = torch.softmax(expected.maps.flatten(2), dim=2).view(expected.maps.shape)
    found = knet_on_torch(KNetLayout.of(sizes), arrays.state, "cpu", 1)(crops)
    np.testing.assert_allclose(np.log(found[0]), np.log(likelihood.numpy()), atol=1e-4)
    np.testing.assert_allclose(found[1], expected.visible, atol=5e-5)
    np.testing.assert_allclose(found[2], expected.azimuth, atol=5e-5)


@pytest.mark.parametrize("kinds", [0, 3])
def test_kinds_are_said_alike_on_both_runtimes_and_in_the_mirror(kinds, tmp_path):
    """Oracle: the module that is trained, on the crop and on its mirror image."""
    pytest.importorskip("onnxruntime")
    torch.manual_seed(0)
    sizes = KNetSettings(crop=32, width=8, kinds=kinds)
    network = KNet(sizes).eval()
    path = save_weights(tmp_path / "n.safetensors", Stored(network.state_dict(), sizes.to_dict(), CALIBRATION, {}))
    network.load_state_dict(load_tensors(path).state, strict=False)
    image = bytes_of(40, 40, 3)
    found = [KeypointCascade(path, runtime=name)(image, [[4, 4, 36, 36]])[0] for name in ("torch", "onnx")]
    if not kinds:
        assert [one.kinds for one in found] == [None, None]
        return
    crop = extract(image, crop_of(np.array([4.0, 4, 36, 36]), 32))
    with torch.inference_mode():
        both = torch.from_numpy(np.stack([crop, crop[:, ::-1]])).permute(0, 3, 1, 2).float()
        expected = torch.softmax(network(both).kind, dim=1).mean(dim=0)
    for one in found:
        assert list(one.kinds) == list(KINDS)
        np.testing.assert_allclose(list(one.kinds.values()), expected, atol=1e-5)


def test_there_are_no_more_kinds_than_names():
    with pytest.raises(InvalidInputError, match=r"kinds.*car, van, lorry"):
        KNetLayout.of(KNetSettings(kinds=4))


def test_the_refinement_networks_say_the_same():
    arrays, stored = load_weights(shipped()), load_tensors(shipped())
    finer = RefineSettings(**stored.refine_settings)
    refinement = RefineNet(finer).eval()
    refinement.load_state_dict(stored.refinement, strict=False)
    patches = bytes_of(2, 42, 32, 32)
    with torch.inference_mode():
        logits = refinement(torch.from_numpy(patches).unflatten(1, (14, 3)).float())
        expected = torch.log_softmax(logits.flatten(2), dim=2)
    (found,) = refinement_on_torch(RefineLayout.of(finer), arrays.refinement, "cpu", 1)(patches)
    np.testing.assert_allclose(found, expected, atol=1e-4)


@pytest.mark.parametrize(("kernel", "side"), [(3, 32), (5, 32), (3, 33), (5, 31)])
def test_padding_on_one_side_goes_into_the_kernel(kernel, side):
    torch.manual_seed(0)
    layer = same("part", 4, 4, kernel, 2, groups=4)
    part = _Same(layer).eval()
    part.norm.running_mean.normal_()
    part.norm.weight.data.uniform_(0.5, 2.0)
    arrays = {f"part.{name}": value.numpy() for name, value in part.state_dict().items()}
    weight, bias = (torch.from_numpy(array) for array in folded_arrays(layer, arrays))
    image = torch.randn(1, 4, side, side)
    with torch.inference_mode():
        found = torch.nn.functional.relu6(torch.nn.functional.conv2d(image, weight, bias, 2, layer.padding[1], 1, 4))
        torch.testing.assert_close(found, part(image), atol=1e-5, rtol=0.0)


@pytest.mark.parametrize("sizes", [KNetSettings(), KNetSettings(keypoints=5, crop=64, width=24, kinds=3)])
def test_the_layout_names_the_arrays_of_the_modules(sizes):
    finer = RefineSettings(keypoints=sizes.keypoints, width=sizes.width)
    pairs = ((KNet(sizes), KNetLayout.of(sizes)), (RefineNet(finer), RefineLayout.of(finer)))
    for network, layout in pairs:
        state = {name: tuple(value.shape) for name, value in network.state_dict().items() if "num_batches" not in name}
        assert layout.shapes == state
