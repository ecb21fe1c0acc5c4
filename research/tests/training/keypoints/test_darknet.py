"""From Darknet's files to ONNX: a small network with every kind of layer, against PyTorch."""

import sys

import cv2
import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.perception.vehicles import YoloVehicleDetector
from fgrecon_research.training.keypoints.darknet import convert, read_layers

torch = pytest.importorskip("torch")

ANCHORS = "anchors = 10,14, 23,27, 37,58, 81,82, 135,169, 344,319\nscale_x_y = 1.05\n"
CFG = f"""# all kinds of layers
[net]
width=32
[convolutional]
batch_normalize=1
filters=8
size=3
stride=2
pad=1
activation=leaky
[route]
layers=-1
groups=2
group_id=1
[convolutional]
batch_normalize=1
filters=4
size=3
stride=1
pad=1
activation=leaky
[route]
layers = -1,-2
[maxpool]
size=2
stride=2
[convolutional]
size=1
stride=1
pad=1
filters=255
activation=linear
[yolo]
mask = 3,4,5
{ANCHORS}
[route]
layers = -3
[upsample]
stride=2
[route]
layers = -1, 3
[convolutional]
size=1
stride=1
pad=1
filters=255
activation=linear
[yolo]
mask = 1,2,3
{ANCHORS}"""
SHAPES = [(8, 3, 3, True), (4, 4, 3, True), (255, 8, 1, False), (255, 16, 1, False)]  # of the convolutions


@pytest.fixture
def numbers():
    """Of each convolution: bias, then scale, mean and variance where it is normalised, then the kernel."""
    rng = np.random.default_rng(0)
    made = []
    for filters, width, size, normalised in SHAPES:
        made.append(rng.normal(size=filters))
        if normalised:
            made += [rng.normal(size=filters), rng.normal(size=filters), rng.uniform(0.5, 2.0, filters)]
        made.append(rng.normal(size=(filters, width, size, size)))
    return [part.astype("<f4") for part in made]


@pytest.fixture
def files(tmp_path, numbers):
    """The cfg and the weights file."""
    header = np.array([0, 2, 5], "<i4").tobytes() + np.array([32_013_312], "<u8").tobytes()
    (tmp_path / "small.cfg").write_text(CFG)
    (tmp_path / "small.weights").write_bytes(header + b"".join(part.tobytes() for part in numbers))
    return tmp_path / "small.cfg", tmp_path / "small.weights"


def reference(image, numbers):
    """The same network written out."""
    F, left = torch.nn.functional, iter(torch.from_numpy(part.astype(np.float64)) for part in numbers)

    def normalised(x, stride):
        bias, scale, mean, variance, kernel = (next(left) for _ in range(5))
        x = F.conv2d(x, kernel, stride=stride, padding=1)
        return F.leaky_relu(F.batch_norm(x, mean, variance, scale, bias, eps=1e-5), 0.1)

    def head(x):
        bias, kernel = next(left), next(left)
        return F.conv2d(x, kernel, bias)

    second_half = normalised(torch.from_numpy(image.astype(np.float64)), 2)[:, 4:]
    both = torch.cat([normalised(second_half, 1), second_half], dim=1)
    pooled = F.max_pool2d(both, 2)
    coarse = head(pooled)
    fine = head(torch.cat([F.interpolate(pooled, scale_factor=2, mode="nearest"), both], dim=1))
    return coarse.numpy(), fine.numpy()


@pytest.mark.parametrize("size", [(16, 32), (32, 8)])
def test_the_converted_network_computes_the_same(files, numbers, tmp_path, size):
    pytest.importorskip("onnx", reason="the converter needs the package onnx")
    image = np.random.default_rng(1).random((1, 3, *size), dtype=np.float32)
    network = cv2.dnn.readNetFromONNX(str(convert(*files, tmp_path / "small.onnx")))
    network.setInput(image)
    found = sorted(network.forward(network.getUnconnectedOutLayersNames()), key=np.size)  # their order is OpenCV's
    for got, wanted in zip(found, reference(image, numbers), strict=True):
        assert got.shape == wanted.shape
        np.testing.assert_allclose(got, wanted, atol=5e-3 * wanted.std())  # kernels are in half precision


@pytest.mark.parametrize("runtime", ["opencv", "onnx"])
def test_the_detector_runs_what_was_converted(tmp_path, runtime):
    """A network of YOLOv4-tiny's strides that sees nothing but the bias: a car in the middle of each coarse cell."""
    pytest.importorskip("onnx", reason="the converter needs the package onnx")
    if runtime == "onnx":
        pytest.importorskip("onnxruntime")
    halved = "[maxpool]\nsize=2\nstride=2\n"
    head = "[convolutional]\nsize=1\nstride=1\npad=1\nfilters=255\nactivation=linear\n[yolo]\n"
    coarse, fine = (f"{head}mask = {mask}\n{ANCHORS}" for mask in ("3,4,5", "1,2,3"))
    (tmp_path / "bias.cfg").write_text(f"[net]\n{5 * halved}{coarse}[route]\nlayers = 3\n{fine}")
    sees = np.full((3, 85), -50.0)
    sees[0, [0, 1, 2, 3, 4, 7]] = [0.0, 0.0, 0.0, 0.0, 50.0, 50.0]
    biases = [sees, np.full((3, 85), -50.0)]
    header = np.array([0, 2, 5, 0, 0], "<i4").tobytes()
    numbers = [np.concatenate([bias.ravel(), np.zeros(255 * 3)]).astype("<f4").tobytes() for bias in biases]
    (tmp_path / "bias.weights").write_bytes(header + b"".join(numbers))
    model = convert(tmp_path / "bias.cfg", tmp_path / "bias.weights", tmp_path / "bias.onnx")
    found = YoloVehicleDetector(model, runtime=runtime)(np.zeros((64, 64, 3), np.uint8))
    np.testing.assert_allclose(found.scores, 1.0)
    corners = found.boxes[np.lexsort(found.boxes.T[:2])]
    middles = np.array([[16, 16], [48, 16], [16, 48], [48, 48]])  # each 81 x 82, as far as it is in the image
    expected = np.clip(np.tile(middles, 2) + np.array([-40.5, -41, 40.5, 41]) - 0.5, 0.0, 63.0)
    kept = {tuple(box) for box in expected.tolist()}
    assert len(corners) > 0
    assert {tuple(box) for box in corners.tolist()} <= kept


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("[maxpool]", "[shortcut]", "shortcut"),
        ("81,82", "80,82", "anchors"),
        ("activation=leaky", "activation=mish", "mish"),
        ("filters=4", "filters=5", "weights"),
        ("layers = -3", "layers = -30", "layer 7"),
        ("filters=8", "filters", r"small.cfg:6"),
        ("[net]", "[route]", "cfg"),
        ("mask = 1,2,3", "", "mask"),
    ],
)
def test_networks_that_are_none_of_these(files, tmp_path, old, new, named):
    pytest.importorskip("onnx", reason="the converter needs the package onnx")
    cfg, weights = files
    cfg.write_text(CFG.replace(old, new, 1))
    with pytest.raises(InvalidInputError, match=named):
        convert(cfg, weights, tmp_path / "small.onnx")
    assert not (tmp_path / "small.onnx").exists()


def test_weights_of_another_length(files, tmp_path):
    pytest.importorskip("onnx", reason="the converter needs the package onnx")
    cfg, weights = files
    content = weights.read_bytes()
    for other in (content[:-8], content + b"0000", b""):
        weights.write_bytes(other)
        with pytest.raises(InvalidInputError, match="weights"):
            convert(cfg, weights, tmp_path / "small.onnx")


def test_without_the_package_it_says_what_to_install(files, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(InvalidInputError, match=r"pip install 'fgrecon\[training\]'"):
        convert(*files, tmp_path / "small.onnx")


def test_missing_files(tmp_path):
    with pytest.raises(InvalidInputError, match="cfg"):
        read_layers(tmp_path / "absent.cfg")
