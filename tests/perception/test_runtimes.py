"""What runs the networks does not matter to what they say."""

import pickle
import sys
from dataclasses import replace

import numpy as np
import pytest
from safetensors import safe_open

from fgrecon.core.errors import InvalidInputError, MissingPackageError
from fgrecon.io.catalogue import load_prior
from fgrecon.perception.keypoints import detect, sessions
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon.perception.keypoints.layout import KNetSettings, RefineSettings
from fgrecon.perception.keypoints.network_file import save_weights
from fgrecon.perception.keypoints.sessions import at_most, open_session, runs_on, threads_of_networks
from fgrecon.simulation.sample import demo_scene
from tests.perception.untrained import untrained

torch = pytest.importorskip("torch")

from safetensors.torch import save  # noqa: E402

from fgrecon.perception.keypoints import on_torch  # noqa: E402


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
def test_cascades_find_the_same_points(scenes, refine):
    cascades = [KeypointCascade(refine=refine, runtime=name) for name in ("onnx", "torch")]
    assert [cascade.runtime for cascade in cascades] == ["onnx", "torch"]
    for scene in scenes:
        image, box = scene.picture.image, scene.observation.box
        boxes = [box, box + np.array([-9.0, -4.0, 6.0, 8.0]), box + 5.0]
        for found, expected in zip(*(cascade(image, boxes, maps=True) for cascade in cascades), strict=True):
            close(found, expected, 1e-4)


def test_networks_of_other_sizes(scenes, tmp_path):
    stored = untrained(KNetSettings(crop=64, width=8), RefineSettings(crop=96, width=4))
    path = save_weights(tmp_path / "w.safetensors", stored)
    image, box = scenes[0].picture.image, scenes[0].observation.box
    found, expected = (KeypointCascade(path, runtime=name)(image, [box], maps=True) for name in ("onnx", "torch"))
    close(found[0], expected[0], 1e-4)


def test_no_box_is_no_work():
    assert KeypointCascade(runtime="onnx")(np.zeros((50, 50, 3), np.uint8), np.zeros((0, 4))) == []


def test_the_runtime_is_chosen_by_what_has_the_device(monkeypatch):
    with pytest.raises(InvalidInputError, match="Give auto, onnx"):
        KeypointCascade(runtime="caffe")
    monkeypatch.setattr(detect, "runs_on", lambda device: False)
    assert KeypointCascade().runtime == "torch"
    with pytest.raises(InvalidInputError, match="onnx on cpu"):
        KeypointCascade(runtime="onnx")


def test_torch_is_needed_for_its_runtime_alone(monkeypatch):
    monkeypatch.setitem(sys.modules, "fgrecon.perception.keypoints.on_torch", None)
    assert KeypointCascade().runtime == "onnx"
    with pytest.raises(MissingPackageError, match=r"pip install 'fgrecon\[torch\]'"):
        KeypointCascade(runtime="torch")


def test_a_device_that_is_not_there_is_refused():
    assert not runs_on("tpu")
    for device in ("cuda:99", "tpu"):
        with pytest.raises(InvalidInputError, match=f"device.*{device}.*`cpu`"):
            KeypointCascade(device=device)


@pytest.mark.parametrize("name", ["onnx", "torch"])
def test_a_gpu_finds_the_same_points(scenes, name):
    if not (runs_on("cuda") if name == "onnx" else torch.cuda.is_available()):
        pytest.skip(f"there is no GPU for {name}")
    for found, expected in zip(*(found_in(scenes, name, device) for device in ("cuda", "cpu")), strict=True):
        near(found, expected)


def test_factors_of_ten_bits_as_a_gpu_takes_them_find_the_same_points(scenes, monkeypatch):
    expected = found_in(scenes, "torch", "cpu")
    monkeypatch.setattr(on_torch, "functional", _InTensorFloat32())
    for found, one in zip(found_in(scenes, "torch", "cpu"), expected, strict=True):
        near(found, one)
        assert np.abs(found.likelihood - one.likelihood).max() > 1e-6


def found_in(scenes, name, device):
    """What the cascade finds in each of the scenes."""
    cascade = KeypointCascade(runtime=name, device=device)
    return [cascade(scene.picture.image, [scene.observation.box], maps=True)[0] for scene in scenes]


def near(found, expected):
    """Within some times what convolutions on GPUs change, whose factors have ten bits by default (TensorFloat-32)."""
    np.testing.assert_allclose(found.observation.keypoints, expected.observation.keypoints, atol=0.05)
    np.testing.assert_allclose(found.observation.confidence, expected.observation.confidence, atol=5e-3)
    np.testing.assert_allclose(found.observation.covariance, expected.observation.covariance, rtol=1e-2, atol=0.05)
    np.testing.assert_allclose(found.azimuth, expected.azimuth, atol=2e-3)
    np.testing.assert_allclose(found.visible, expected.visible, atol=5e-3)
    np.testing.assert_allclose(found.likelihood, expected.likelihood, atol=2e-3)


class _InTensorFloat32:
    """torch.nn.functional with factors of convolutions rounded to ten bits."""

    def __getattr__(self, name):
        return getattr(torch.nn.functional, name)

    def conv2d(self, x, kernel, *how):
        return torch.nn.functional.conv2d(self._rounded(x), self._rounded(kernel), *how)

    @staticmethod
    def _rounded(x):
        bits = x.contiguous().view(torch.int32)
        return ((bits + 0x0FFF + ((bits >> 13) & 1)) & ~0x1FFF).view(torch.float32)


def test_onnx_runtime_gets_the_device_and_its_number(monkeypatch):
    asked = []
    monkeypatch.setattr(
        "onnxruntime.InferenceSession", lambda model, options, providers: asked.append(providers) or _Session()
    )
    for device in ("cpu", "cuda", "cuda:1"):
        open_session(b"", 1, device)
    cuda, cpu = "CUDAExecutionProvider", "CPUExecutionProvider"
    assert asked == [[cpu], [cuda, cpu], [(cuda, {"device_id": 1}), cpu]]


class _Session:
    def get_inputs(self):
        return ["image"]


def test_what_is_no_network_is_refused():
    with pytest.raises(InvalidInputError, match="model"):
        open_session(b"text", 1)


def test_no_more_threads_than_torch_has(monkeypatch):
    asked = []
    monkeypatch.setattr(
        "fgrecon.perception.keypoints.on_onnx.open_session", lambda model, threads, device: asked.append(threads)
    )
    monkeypatch.setattr(sessions, "free_cores", lambda: 1000)
    KeypointCascade(runtime="onnx")
    assert asked == [torch.get_num_threads()] * 2
    with at_most(torch.get_num_threads() + 1):
        KeypointCascade(runtime="onnx", refine=False)
    assert asked[2:] == [torch.get_num_threads() + 1]


@pytest.mark.parametrize(
    ("said", "threads"), [("3", 3), ("5,2", 5), (" 1 ", 1), ("0", None), ("-2", None), ("many", None), (None, None)]
)
def test_as_many_threads_as_torch_would_have(monkeypatch, said, threads):
    monkeypatch.delitem(sys.modules, "torch")
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    if said is not None:
        monkeypatch.setenv("OMP_NUM_THREADS", said)
    monkeypatch.setattr(sessions, "free_cores", lambda: 7)
    assert threads_of_networks() == (threads or 7)
    with at_most(2):
        assert threads_of_networks() == 2
    with at_most(None):
        assert threads_of_networks() == (threads or 7)


@pytest.mark.parametrize("threads", [1, 2])
def test_torch_has_the_threads_of_networks_while_they_run_alone(threads):
    with at_most(threads):
        cascade = KeypointCascade(runtime="torch", refine=False)
    asked, before = [], torch.get_num_threads()
    inner = torch.nn.functional.conv2d

    def noted(*args):
        asked.append(torch.get_num_threads())
        return inner(*args)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fgrecon.perception.keypoints.on_torch.functional.conv2d", noted)
        cascade(np.zeros((60, 60, 3), np.uint8), [[10, 10, 50, 50]])
    assert set(asked) == {threads}
    assert torch.get_num_threads() == before


def change(parts, name, value):
    """Weights in which an array of KNet or the refinement networks is another one, or gone."""
    part, name = name.split(":")
    before = parts[part]
    parts[part] = {**before, name: value(before.get(name))} if value else {n: v for n, v in before.items() if n != name}


ODD = {
    "missing": ("knet:stages.1.0.layers.0.conv.weight", None, "no stages.1.0.layers.0.conv.weight in"),
    "missing normalisation": ("knet:stem.norm.running_var", None, "no stem.norm.running_var in"),
    "missing linear": ("knet:see.bias", None, "no see.bias in"),
    "too many": ("knet:other.weight", lambda _: torch.zeros(3), "an unknown other.weight in"),
    "too large": ("knet:head.weight", lambda v: torch.zeros(2 * len(v), *v.shape[1:]), "head.weight of size"),
    "as many numbers": ("knet:azimuth.weight", lambda v: v.T.contiguous(), "azimuth.weight of size"),
    "one axis more": ("knet:bias", lambda v: v[None], "bias of size"),
    "broadcast": ("knet:stem.norm.bias", lambda _: torch.zeros(1), "stem.norm.bias of size"),
    "no number": ("knet:name", lambda v: v * float("nan"), "name that is not finite"),
    "complex": ("knet:visible", lambda v: v.to(torch.complex64), "safetensors"),
    "bits": ("knet:visible", lambda v: v.to(torch.float8_e4m3fn), "safetensors"),
    "refinement missing": ("refine:layers.3.conv.weight", None, "no layers.3.conv.weight in"),
    "refinement too many": (
        "refine:layers.9.conv.weight",
        lambda _: torch.zeros(1),
        "an unknown layers.9.conv.weight in",
    ),
    "refinement too small": ("refine:head.weight", lambda v: v[1:], "head.weight of size"),
    "refinement infinite": (
        "refine:layers.0.norm.weight",
        lambda v: v / 0.0,
        "layers.0.norm.weight that is not finite",
    ),
}


@pytest.mark.parametrize("name", ["onnx", "torch"])
@pytest.mark.parametrize("odd", ODD)
def test_weights_of_no_network_are_refused_alike(tmp_path, name, odd):
    stored = untrained(KNetSettings(crop=32, width=8), RefineSettings(crop=64, width=2))
    path = tmp_path / "w.safetensors"
    parts = {
        part: {name: torch.from_numpy(array) for name, array in arrays.items()}
        for part, arrays in (("knet", stored.state), ("refine", stored.refinement))
    }
    KeypointCascade(save_weights(path, stored), runtime=name)
    *how, reason = ODD[odd]
    change(parts, *how)
    with safe_open(str(path), framework="pt") as file:
        about = file.metadata()
    arrays = {f"{p}.{n}": v.clone() for p, state in parts.items() for n, v in state.items() if "num_batches" not in n}
    path.write_bytes(save(arrays, about))
    with pytest.raises(InvalidInputError, match=f"weights: got .*{reason}"):
        KeypointCascade(path, runtime=name)


@pytest.mark.parametrize("name", ["onnx", "torch"])
@pytest.mark.parametrize(
    ("sizes", "finer", "field"),
    [
        ({"crop": 48}, {}, r"knet\.crop"),
        ({"depth": 3}, {}, "weights: .*this version"),
        ({"width": 16}, {}, r"weights: .* of size \("),
        ({"width": 4096}, {}, r"weights: .* of size \("),
        ({"keypoints": 4}, {}, "weights.*4 keypoints"),
        ({}, {"depth": 3}, "weights: .*this version"),
        ({}, {"width": 4}, r"weights: .* of size \("),
        ({}, {"keypoints": 13}, r"weights: .* of size \("),
    ],
)
def test_sizes_of_another_network_are_refused_alike(tmp_path, name, sizes, finer, field):
    made, near = KNetSettings(crop=32, width=8), RefineSettings(crop=64, width=2)
    sizes, finer = {**made.to_dict(), **sizes}, {**near.to_dict(), **finer}
    path = tmp_path / "w.safetensors"
    save_weights(path, replace(untrained(made, near), settings=sizes, refine_settings=finer))
    with pytest.raises(InvalidInputError, match=field):
        KeypointCascade(path, runtime=name)


@pytest.mark.parametrize("name", ["onnx", "torch"])
def test_a_cascade_goes_to_other_processes(scenes, name):
    cascade, scene = KeypointCascade(runtime=name), scenes[0]
    there = pickle.loads(pickle.dumps(cascade))
    assert there.runtime == name
    found, expected = (one(scene.picture.image, [scene.observation.box], maps=True)[0] for one in (there, cascade))
    close(found, expected, 1e-9)
