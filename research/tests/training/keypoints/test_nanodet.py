"""From the npm package to ONNX: a small network with every kind of layer, against PyTorch."""

import base64
import copy
import io
import json
import tarfile

import cv2
import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.perception.vehicles import MEAN
from fgrecon_research.training.keypoints import nanodet
from fgrecon_research.training.keypoints.nanodet import convert, read_package

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


def folder(path, described, numbers):
    (path / "models").mkdir(parents=True)
    (path / "models" / "nanodet.json").write_text(json.dumps(described))
    (path / "models" / "nanodet.bin").write_bytes(numbers)
    return path


def archive(path, members):
    """A packed package; a member without content is a link."""
    with tarfile.open(path, "w:gz") as packed:
        for name, content in members.items():
            entry = tarfile.TarInfo(f"package/{name}")
            if content is None:
                entry.type, entry.linkname = tarfile.SYMTYPE, "/etc/hostname"
            entry.size = len(content or b"")
            packed.addfile(entry, io.BytesIO(content or b""))
    return path


@pytest.mark.parametrize("runtime", ["opencv", "onnx"])
@pytest.mark.parametrize("size", [(64, 96), (160, 64)])
def test_the_converted_network_computes_the_same(small, tmp_path, size, runtime):
    described, numbers, taken = small
    image = np.random.default_rng(1).integers(0, 256, (*size, 3), dtype=np.uint8)
    model = convert(folder(tmp_path / "package", described, numbers), tmp_path / "small.onnx")
    blob = cv2.dnn.blobFromImage(image, 1.0 / 255.0, mean=MEAN)
    if runtime == "onnx":
        session = pytest.importorskip("onnxruntime").InferenceSession(str(model), providers=["CPUExecutionProvider"])
        found = session.run(None, {"image": blob})
    else:
        network = cv2.dnn.readNetFromONNX(str(model))
        network.setInput(blob)
        found = network.forward(network.getUnconnectedOutLayersNames())
    for got, wanted in zip(sorted(found, key=lambda values: -values.size), reference(image, taken), strict=True):
        assert got.shape == wanted.shape
        np.testing.assert_allclose(got, wanted, atol=1e-4 * wanted.std())  # half precision is the package's own


def test_folder_and_archive_give_the_same_bytes(small, tmp_path):
    described, numbers, _ = small
    unpacked = folder(tmp_path / "package", described, numbers)
    files = {"models/other.bin": b"x" * 5000, "models/nanodet.bin": numbers}
    packed = archive(tmp_path / "p.tgz", files | {"models/nanodet.json": json.dumps(described).encode()})
    first, second, third = (
        convert(path, tmp_path / f"{number}.onnx").read_bytes()
        for number, path in enumerate([unpacked, packed, packed])
    )
    assert first == second == third


def test_packages_without_the_files(small, tmp_path):
    _, numbers, _ = small
    (tmp_path / "text.tgz").write_text("no archive")
    without = archive(tmp_path / "w.tgz", {"models/nanodet.bin": numbers})
    short = tmp_path / "short.tgz"
    short.write_bytes(without.read_bytes()[:-2000])
    (tmp_path / "empty").mkdir()
    for path in (tmp_path / "absent", tmp_path / "text.tgz", without, short, tmp_path / "empty"):
        with pytest.raises(InvalidInputError, match="package"):
            read_package(path)


def test_links_and_large_files_are_not_read(small, tmp_path, monkeypatch):
    described, numbers, _ = small
    link = archive(tmp_path / "link.tgz", {"models/nanodet.json": None, "models/nanodet.bin": numbers})
    with pytest.raises(InvalidInputError, match=r"nanodet\.json is no file"):
        read_package(link)
    monkeypatch.setattr(nanodet, "_FILES", {"models/nanodet.json": 2**20, "models/nanodet.bin": 1000})
    packed = archive(tmp_path / "p.tgz", {"models/nanodet.bin": numbers})
    for path in (packed, folder(tmp_path / "package", described, numbers)):
        with pytest.raises(InvalidInputError, match=r"nanodet\.bin"):
            read_package(path)
    monkeypatch.setattr(nanodet, "_ARCHIVE_LIMIT", 4000)
    with pytest.raises(InvalidInputError, match="more than 4000 bytes"):
        read_package(archive(tmp_path / "large.tgz", {"models/other.bin": b"x" * 5000}))


def node_of(described, kind, number=0):
    return [node for node in described["modelTopology"]["node"] if node["op"] == kind][number]


def attribute(kind, name, value):
    def change(described):
        node_of(described, kind)["attr"][name] = value

    return change


def entry(key, value, number=0):
    def change(described):
        described["weightsManifest"][0]["weights"][number][key] = value

    return change


def source(kind, at, name):
    def change(described):
        node_of(described, kind)["input"][at] = name

    return change


def gone(described):
    del described["modelTopology"]


def alone(described):
    described["weightsManifest"] = []


def without_head(described):
    node_of(described, "SplitV", 2)["op"] = "Identity"


def another_kind(described):
    node_of(described, "LeakyRelu")["op"] = "Elu"


def in_a_circle(described):
    node_of(described, "Conv2D")["input"][0] = node_of(described, "LeakyRelu", 2)["name"]


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (gone, "modelTopology"),
        (alone, "nanodet.json"),
        (without_head, "outputs"),
        (another_kind, "Elu"),
        (in_a_circle, "cycle"),
        (attribute("Placeholder", "shape", {"shape": {"dim": [{"size": "1"}]}}), "input_1"),
        (attribute("Conv2D", "padding", text("SAME")), "Conv2D"),
        (attribute("Conv2D", "padding", {"s": "?"}), "Conv2D"),
        (attribute("Conv2D", "data_format", text("NCHW")), "Conv2D"),
        (attribute("Conv2D", "dilations", {"list": {"i": ["1", "2", "2", "1"]}}), "Conv2D"),
        (attribute("Conv2D", "strides", {"list": {"i": ["1", "2", "1", "1"]}}), "strides"),
        (attribute("MaxPool", "ksize", {"list": {"i": ["1", "3", "2", "1"]}}), "MaxPool"),
        (attribute("ResizeBilinear", "half_pixel_centers", {"b": False}), "Resize"),
        (source("LeakyRelu", 0, "absent"), "absent"),
        (source("ResizeBilinear", 1, "constant_0"), "Resize"),
        (source("PadV2", 2, "constant_0"), "PadV2"),
        (source("Conv2D", 1, "constant_0"), "Conv2D"),
        (source("Transpose", 1, "constant_0"), "Transpose"),
        (source("ConcatV2", 1, "input_1"), "ConcatV2"),
        (source("MaxPool", 0, "input_1"), "MaxPool"),
        (source("SplitV", 1, "constant_0"), "SplitV"),
        (entry("shape", [-1]), "constant_0"),
        (entry("shape", [10**12]), "nanodet.json"),
        (entry("dtype", "uint8"), "uint8"),
        (entry("shape", [1, 1]), "bytes too many|nanodet.json"),
    ],
)
def test_networks_that_are_none_of_these(small, tmp_path, change, named):
    described, numbers, _ = copy.deepcopy(small)
    change(described)
    with pytest.raises(InvalidInputError, match=named):
        convert(folder(tmp_path / "package", described, numbers), tmp_path / "small.onnx")
    assert not (tmp_path / "small.onnx").exists()


def test_numbers_that_are_not(small, tmp_path):
    described, numbers, _ = small
    kernel = next(entry["name"] for entry in described["weightsManifest"][0]["weights"] if len(entry["shape"]) == 4)
    start = 0
    for item in described["weightsManifest"][0]["weights"]:
        if item["name"] == kernel:
            break
        start += int(np.prod(item["shape"])) * (2 if "quantization" in item else 4)
    spoilt = numbers[:start] + np.float16(np.nan).tobytes() + numbers[start + 2 :]
    for number, (content, named) in enumerate(
        ((spoilt, "not finite"), (numbers[:-1], "nanodet.json"), (numbers + b"00", "too many"), (b"", "nanodet.json"))
    ):
        with pytest.raises(InvalidInputError, match=named):
            convert(folder(tmp_path / str(number), described, content), tmp_path / "small.onnx")


@pytest.mark.parametrize("content", ["", "[]", "{", '{"weightsManifest": 1}', "[" * 100_000])
def test_descriptions_that_are_none(tmp_path, content):
    path = folder(tmp_path / "package", {}, b"")
    (path / "models" / "nanodet.json").write_text(content)
    with pytest.raises(InvalidInputError, match="package"):
        convert(path, tmp_path / "small.onnx")
