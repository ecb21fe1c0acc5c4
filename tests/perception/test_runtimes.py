"""What runs the networks does not matter to what they say."""

import pickle

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_prior
from fgrecon.perception.keypoints import sessions
from fgrecon.perception.keypoints.decode import ConfidenceCalibration
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon.perception.keypoints.sessions import chosen_runtime, open_session
from fgrecon.perception.keypoints.weights import Stored, save_weights
from fgrecon.simulation.demo import demo_scene

torch = pytest.importorskip("torch")

from fgrecon.perception.keypoints.knet import KNet, KNetSettings  # noqa: E402
from fgrecon.perception.keypoints.refine import RefineNet, RefineSettings  # noqa: E402

NEEDS = ("onnx", "onnxruntime")


@pytest.fixture(scope="module")
def runtime():
    """ONNX Runtime, where it is installed."""
    for name in NEEDS:
        pytest.importorskip(name, reason="the extra fgrecon[onnx] is not installed")


@pytest.fixture(scope="module")
def scenes():
    return [demo_scene(load_prior("car14"), seed) for seed in (0, 3)]


def close(found, expected, atol):
    np.testing.assert_allclose(found.observation.keypoints, expected.observation.keypoints, atol=atol)
    np.testing.assert_allclose(found.observation.confidence, expected.observation.confidence, atol=1e-5)
    np.testing.assert_allclose(found.observation.covariance, expected.observation.covariance, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(found.azimuth, expected.azimuth, atol=1e-5)
    np.testing.assert_allclose(found.visible, expected.visible, atol=1e-5)
    np.testing.assert_allclose(found.likelihood, expected.likelihood, atol=1e-5)


@pytest.mark.parametrize("refine", [False, True])
def test_cascades_find_the_same_points(runtime, scenes, refine):
    cascades = [KeypointCascade(refine=refine, runtime=name) for name in ("onnx", "torch")]
    assert [cascade.runtime for cascade in cascades] == ["onnx", "torch"]
    for scene in scenes:
        image, box = scene.picture.image, scene.observation.box
        boxes = [box, box + np.array([-9.0, -4.0, 6.0, 8.0]), box + 5.0]
        for found, expected in zip(*(cascade(image, boxes, maps=True) for cascade in cascades), strict=True):
            close(found, expected, 1e-4)


def test_networks_of_other_sizes(runtime, scenes, tmp_path):
    torch.manual_seed(0)
    sizes, finer = KNetSettings(crop=64, width=8), RefineSettings(crop=96, width=4)
    parts = (KNet(sizes).state_dict(), RefineNet(finer).state_dict())
    stored = Stored(parts[0], sizes.to_dict(), ConfidenceCalibration(), {}, parts[1], finer.to_dict())
    path = save_weights(tmp_path / "w.safetensors", stored)
    image, box = scenes[0].picture.image, scenes[0].observation.box
    found, expected = (KeypointCascade(path, runtime=name)(image, [box], maps=True) for name in ("onnx", "torch"))
    close(found[0], expected[0], 1e-4)


def test_no_box_is_no_work(runtime):
    assert KeypointCascade(runtime="onnx")(np.zeros((50, 50, 3), np.uint8), np.zeros((0, 4))) == []


def test_the_runtime_is_chosen_by_what_is_installed(monkeypatch):
    there = {"onnx", "onnxruntime"}
    monkeypatch.setattr(sessions, "find_spec", lambda name: name if name in there else None)
    assert chosen_runtime("auto", "torch", packages=NEEDS) == "onnx"
    assert chosen_runtime("torch", "torch", packages=NEEDS) == "torch"
    assert chosen_runtime("auto", "torch", packages=NEEDS, able=False) == "torch"
    with pytest.raises(InvalidInputError, match="another device"):
        chosen_runtime("onnx", "torch", packages=NEEDS, able=False)
    there.remove("onnx")
    assert chosen_runtime("auto", "torch", packages=NEEDS) == "torch"
    assert chosen_runtime("onnx", "opencv", packages=["onnxruntime"]) == "onnx"
    with pytest.raises(InvalidInputError, match=r"onnx without onnx\b.*fgrecon\[onnx\]"):
        chosen_runtime("onnx", "torch", packages=NEEDS)
    with pytest.raises(InvalidInputError, match="Give auto, onnx or torch"):
        KeypointCascade(runtime="caffe")


def test_without_onnx_runtime_the_cascade_runs_on_torch(monkeypatch):
    monkeypatch.setattr(sessions, "find_spec", lambda name: None)
    assert KeypointCascade().runtime == "torch"


def test_what_is_no_network_is_refused(runtime):
    with pytest.raises(InvalidInputError, match="model"):
        open_session(b"text", 1)


def test_no_more_threads_than_torch_has(runtime, monkeypatch):
    asked = []
    monkeypatch.setattr(
        "fgrecon.perception.keypoints.detect.open_session", lambda model, threads: asked.append(threads)
    )
    KeypointCascade(runtime="onnx")
    assert asked == [torch.get_num_threads()] * 2


@pytest.mark.parametrize("name", ["onnx", "torch"])
def test_a_cascade_goes_to_other_processes(runtime, scenes, name):
    cascade, scene = KeypointCascade(runtime=name), scenes[0]
    there = pickle.loads(pickle.dumps(cascade))
    assert there.runtime == name
    found, expected = (one(scene.picture.image, [scene.observation.box], maps=True)[0] for one in (there, cascade))
    close(found, expected, 1e-9)
