"""Architecture of the networks: sizes, and layers by the names that files have for them.

`networks` says what is computed with them, `on_torch` and `on_onnx` on what.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass

from fgrecon.core.errors import InvalidInputError

AZIMUTH_BINS = 36
"""Directions that the azimuth output tells apart: bin b is centred at 10 b degrees."""

KINDS = ("car", "van", "lorry")
"""Kinds of vehicles that networks with an output for them tell apart, in its order."""

STRIDE = 2
"""Pixels of the crop per cell of the likelihood maps."""

PYRAMID = (1, 2, 4, 5)
"""The stages of the encoder at strides 4, 8, 16 and 32, which the pyramid is made of."""

PATCH = 32
"""Side of a patch, pixels."""

MEAN, SPREAD = 127.0, 128.0
"""Of the pixel values that the encoder's weights were learnt with: what networks see is (value - mean) / spread."""

_STAGES = (  # repeats, kernel, stride, expansion, channels: EfficientNet-lite0 without its last stage
    (1, 3, 1, 1, 16),
    (2, 3, 2, 6, 24),
    (2, 5, 2, 6, 40),
    (3, 3, 2, 6, 80),
    (3, 5, 1, 6, 112),
    (4, 5, 2, 6, 192),
)
_STEM = 32
_EPSILON = 1e-3  # of the weights' batch normalisation
_REFINE_EPSILON = 1e-5  # PyTorch's own

Shapes = dict[str, tuple[int, ...]]


@dataclass(frozen=True)
class KNetSettings:
    """Sizes of the network."""

    keypoints: int = 14  # number K of keypoints
    crop: int = 96  # side S of the square crop in pixels, a multiple of 32
    width: int = 64  # channels of the pyramid
    kinds: int = 0  # number of kinds of vehicles that it tells apart, the first of `KINDS`; 0 where it does not

    def to_dict(self) -> dict[str, int]:
        """Plain numbers for a file, which has none for what the network lacks."""
        return {name: value for name, value in asdict(self).items() if value}


@dataclass(frozen=True)
class RefineSettings:
    """Sizes of the networks."""

    keypoints: int = 14  # number K of keypoints, each with a network of its own
    crop: int = 176  # side of the crop that patches are cut from, pixels
    width: int = 16  # channels of each network

    def to_dict(self) -> dict[str, int]:
        """Plain numbers for a file."""
        return asdict(self)


@dataclass(frozen=True)
class CascadeSettings:
    """How the networks are asked and their maps are read. Set by hand and not tuned, but for what says otherwise.

    Attributes:
        patches: For each keypoint.
        patch_sigma_px: Of the patches' centres around the estimate, pixels of the finer crop.
        max_patch_offset_px: The estimate stays well inside every patch.
        fusion_window_px: Side of the window over which the patches' likelihoods are averaged: holds every patch whole.
        peak_reach_cells: Around a map's peak, over which position and covariance are taken.
        side_power: Sharpens the directions within the front and the rear half, for the probability of the left side;
            chosen on street cars of drives that networks had not learnt from.
        min_inside: Share of a box that must be in the image.
    """

    patches: int = 4
    patch_sigma_px: float = 3.0
    max_patch_offset_px: float = 7.0
    fusion_window_px: int = 48
    peak_reach_cells: int = 3
    side_power: float = 4.0
    min_inside: float = 0.2


SETTINGS = CascadeSettings()


@dataclass(frozen=True)
class Layer:
    """A convolution; with a batch normalisation and a ReLU after it, or neither."""

    name: str  # of its part of the network
    inputs: int  # channels
    outputs: int  # channels
    kernel: int = 1  # its side
    stride: int = 1  # pixels from one output to the next
    groups: int = 1  # of channels that do not mix
    dilation: int = 1  # pixels from one number of the kernel to the next
    padding: tuple[int, int] = (0, 0)  # zeros before and after the input, along both axes
    active: bool = True  # whether a ReLU follows the normalisation
    epsilon: float | None = None  # of the batch normalisation; None where there is none and the convolution has a bias

    @property
    def shapes(self) -> Shapes:
        """Of its arrays, by name."""
        kernel = (self.outputs, self.inputs // self.groups, self.kernel, self.kernel)
        if self.epsilon is None:
            return {f"{self.name}.weight": kernel, f"{self.name}.bias": (self.outputs,)}
        fields = ("weight", "bias", "running_mean", "running_var")
        return {f"{self.name}.conv.weight": kernel} | {f"{self.name}.norm.{field}": (self.outputs,) for field in fields}


@dataclass(frozen=True)
class Block:
    """Layers one after the other."""

    layers: tuple[Layer, ...]  # in order
    residual: bool  # whether the input is added to what comes out


@dataclass(frozen=True)
class KNetLayout:
    """The layers of KNet."""

    settings: KNetSettings  # its sizes
    stem: Layer  # the first
    stages: tuple[tuple[Block, ...], ...]  # those of the encoder, in blocks
    lateral: tuple[Layer, ...]  # from each level of the pyramid's stages to its width
    smooth: tuple[Block, ...]  # what follows at each level
    last: Block  # what follows at the finest
    head: Layer  # to the maps
    others: Shapes  # shapes of the arrays that are no convolution's

    @classmethod
    def of(cls, settings: KNetSettings) -> KNetLayout:
        """Of a network of these sizes.

        Raises:
            InvalidInputError: The crop is not a multiple of 32, or there are more kinds than have names.
        """
        if settings.crop % 32 or settings.crop < 32:
            raise InvalidInputError("knet.crop", settings.crop, "Give a multiple of 32.")
        if settings.kinds > len(KINDS):
            raise InvalidInputError("knet.kinds", settings.kinds, f"Give at most {len(KINDS)}: {', '.join(KINDS)}.")
        stages, channels = [], _STEM
        for stage, (repeats, kernel, stride, expansion, outputs) in enumerate(_STAGES):
            blocks = []
            for repeat in range(repeats):
                name = f"stages.{stage}.{repeat}.layers"
                blocks.append(_inverted(name, channels, outputs, kernel, 1 if repeat else stride, expansion))
                channels = outputs
            stages.append(tuple(blocks))
        width, count = settings.width, settings.keypoints
        others: Shapes = {"name": (count, width), "visible": (count, width), "bias": (count,)}
        linear = {"context": (width, channels), "azimuth": (AZIMUTH_BINS, channels), "see": (width, 2 * width)}
        if settings.kinds:
            linear["kind"] = (settings.kinds, channels)
        for name, shape in linear.items():
            others |= {f"{name}.weight": shape, f"{name}.bias": shape[:1]}
        return cls(
            settings=settings,
            stem=same("stem", 3, _STEM, 3, 2),
            stages=tuple(stages),
            lateral=tuple(Layer(f"lateral.{level}", _STAGES[s][4], width) for level, s in enumerate(PYRAMID)),
            smooth=tuple(_separable(f"smooth.{level}", width) for level in range(len(PYRAMID))),
            last=_separable("last", width),
            head=Layer("head", width, 4 * count),
            others=others,
        )

    @property
    def layers(self) -> tuple[Layer, ...]:
        """All of them."""
        blocks = [*(block for stage in self.stages for block in stage), *self.smooth, self.last]
        return (self.stem, *(layer for block in blocks for layer in block.layers), *self.lateral, self.head)

    @property
    def shapes(self) -> Shapes:
        """Of all arrays, by name."""
        return _shapes(self.layers) | self.others


@dataclass(frozen=True)
class RefineLayout:
    """The layers of the refinement networks, which lie side by side in groups."""

    layers: tuple[Layer, ...]  # in order
    head: Layer  # to the maps

    @classmethod
    def of(cls, settings: RefineSettings) -> RefineLayout:
        """Of networks of these sizes."""
        k, w = settings.keypoints, settings.width
        steps = ((3, 2, 1), (w, 1, 1), (w, 1, 2), (w, 1, 3), (w, 1, 1))  # inputs, stride, dilation
        layers = (
            Layer(f"layers.{i}", k * inputs, k * w, 3, stride, k, dilation, (dilation,) * 2, epsilon=_REFINE_EPSILON)
            for i, (inputs, stride, dilation) in enumerate(steps)
        )
        return cls(tuple(layers), Layer("head", k * w, 4 * k, groups=k))

    @property
    def shapes(self) -> Shapes:
        """Of all arrays, by name."""
        return _shapes([*self.layers, self.head])


def same(
    name: str, inputs: int, outputs: int, kernel: int, stride: int = 1, groups: int = 1, *, active: bool = True
) -> Layer:
    """A layer of KNet; pads an even image as TensorFlow does, where the encoder's weights come from."""
    odd = kernel - stride
    padding = (odd // 2, odd - odd // 2) if stride == 2 else (kernel // 2, kernel // 2)
    return Layer(name, inputs, outputs, kernel, stride, groups, 1, padding, active, _EPSILON)


def _inverted(name: str, inputs: int, outputs: int, kernel: int, stride: int, expansion: int) -> Block:
    """Inverted residual: expand, depthwise, project."""
    inner, first = inputs * expansion, int(expansion > 1)
    expand = (same(f"{name}.0", inputs, inner, 1),) * first
    depthwise = same(f"{name}.{first}", inner, inner, kernel, stride, inner)
    project = same(f"{name}.{first + 1}", inner, outputs, 1, active=False)
    return Block((*expand, depthwise, project), stride == 1 and inputs == outputs)


def _separable(name: str, channels: int) -> Block:
    """Depthwise 5 x 5 and pointwise convolution, added to the input."""
    depthwise = same(f"{name}.depthwise", channels, channels, 5, groups=channels)
    return Block((depthwise, same(f"{name}.pointwise", channels, channels, 1, active=False)), residual=True)


def _shapes(layers: Iterable[Layer]) -> Shapes:
    return {name: shape for layer in layers for name, shape in layer.shapes.items()}
