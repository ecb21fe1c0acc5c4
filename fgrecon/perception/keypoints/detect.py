"""Keypoints of vehicles in an image: the networks at work."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fgrecon.core.arrays import Array
from fgrecon.core.checks import as_finite, as_rows, check_corners
from fgrecon.core.detection import Detection
from fgrecon.core.errors import InvalidInputError, MissingPackageError
from fgrecon.core.observation import Observation
from fgrecon.io.catalogue import load_category
from fgrecon.perception.keypoints.crops import (
    MARGIN,
    Crop,
    crop_of,
    cut_patches,
    extract,
    fuse,
    patch_offsets,
    run_networks,
    window_of,
)
from fgrecon.perception.keypoints.decode import (
    ConfidenceCalibration,
    Decoded,
    decode,
    left_probability,
    peak,
    softmax,
)
from fgrecon.perception.keypoints.layout import (
    KINDS,
    PATCH,
    SETTINGS,
    KNetLayout,
    KNetSettings,
    RefineLayout,
    RefineSettings,
)
from fgrecon.perception.keypoints.network_file import WITHOUT_STREET, check_arrays, load_weights, shipped
from fgrecon.perception.keypoints.sessions import Network, runs_on, threads_of_networks

S = TypeVar("S", KNetSettings, RefineSettings)

REACH = 0.1
"""A point is right within this fraction of the box's longer side: what a confidence is the probability of."""

_EVEN = 0.5  # these confidences are probabilities: right as often as wrong at a half

SMALLEST_BOX = 8.0
"""Pixels of the longer side: a smaller vehicle has no keypoints to see."""


@dataclass(frozen=True, eq=False, repr=False)
class CascadeDetection(Detection):
    """What the networks say about one vehicle.

    Attributes:
        observation: Keypoints, confidences, covariances and box, pixels of the image. A confidence is the probability
            that the keypoint is visible and within 0.1 of the box's longer side of the truth; hidden keypoints have
            low ones.
        azimuth: (A,) probability of each direction, as in `Detection`.
        visible: (K,) probability of each keypoint to be visible, wherever it is.
        kinds: Probability of each kind of vehicle, by name, as in `Detection`.
        mass: (K,) share of the likelihood near the position: how sure KNet's map is.
        crop: The part of the image that the network saw.
        likelihood: (K, H, W) likelihood maps over the crop, or None where they were not asked for.
    """

    azimuth: Array = field()  # no defaults here: the networks always say it
    visible: Array = field()
    mass: Array = field()
    crop: Crop = field()
    likelihood: Array | None = None

    @property
    def left_probability(self) -> float:
        """How probably the camera is to the vehicle's left, and not its right."""
        return left_probability(self.azimuth)


class KeypointCascade:
    """The networks, loaded once: KNet finds the keypoints of a crop, the refinement networks look again from near.

    Attributes:
        category: Name of the category whose keypoints they find.
        calibration: From their outputs to confidences and covariances.
        provenance: Learnt from what (plain strings).
        runtime: What runs them: "torch" or "onnx". Points are the same to 1e-4 pixels.
    """

    def __init__(
        self,
        weights: str | Path | None = None,
        *,
        refine: bool = True,
        mirror: bool = True,
        device: str = "cpu",
        runtime: str = "auto",
    ) -> None:
        """Load a network.

        Args:
            weights: File, or `photographs` for the shipped network that has learnt from no image of KITTI; None for the
                one that is shipped for general use.
            refine: Whether the refinement networks follow KNet, where the file has them.
            mirror: Whether KNet also looks at the mirror image, and the mean of both counts.
            device: `cpu`, or that of a GPU as PyTorch names it, such as `cuda` or `cuda:1`.
            runtime: What runs the networks: "torch"; "onnx", which is ONNX Runtime; or "auto", "onnx" where it
                has the device. Either has as many threads as cores are free now.

        Raises:
            InvalidInputError: There is no such file, it holds no network, or nothing runs networks on the device.
            MissingPackageError: PyTorch is needed and not installed.
        """
        named = None if weights is None else str(weights)
        path = shipped(named) if named in (None, WITHOUT_STREET) else Path(str(named))
        stored = load_weights(path)
        self.provenance = dict(stored.provenance)
        self.calibration: ConfidenceCalibration = stored.calibration
        self.device = device
        if runtime not in ("auto", "onnx", "torch") or (runtime == "onnx" and not runs_on(device)):
            raise InvalidInputError("runtime", f"{runtime} on {device}", "Give auto, onnx (ONNX Runtime) or torch.")
        self.runtime = "torch" if runtime == "torch" or not runs_on(device) else "onnx"
        self.mirror = mirror
        self.category = stored.category
        category = load_category(stored.category)
        self._partner = category.mirror
        self.trust = stored.trust
        self._arrays, self._finer = stored.state, None
        self._settings = _of_file(path, KNetSettings, stored.settings)
        self._layout = KNetLayout.of(self._settings)
        if self._settings.keypoints != category.size:
            value = f"{self._settings.keypoints} keypoints in {path}"
            raise InvalidInputError("weights", value, f"Category {category.name} has {category.size}.")
        check_arrays(stored.state, self._layout.shapes, path)
        if stored.refinement is not None and stored.refine_settings is not None and refine:
            self._finer, self._finer_arrays = _of_file(path, RefineSettings, stored.refine_settings), stored.refinement
            check_arrays(stored.refinement, RefineLayout.of(self._finer).shapes, path)
        self._find, self._refine_patches = self._running()

    def _running(self) -> tuple[Network, Network | None]:
        """KNet, and the refinement networks if there are any, on the runtime."""
        finer = None if self._finer is None else RefineLayout.of(self._finer)
        threads = threads_of_networks()
        if self.runtime == "onnx":
            from fgrecon.perception.keypoints.on_onnx import knet_on_onnx, refinement_on_onnx

            first = knet_on_onnx(self._layout, self._arrays, threads, self.device)
            return first, None if finer is None else refinement_on_onnx(finer, self._finer_arrays, threads, self.device)
        try:
            from fgrecon.perception.keypoints.on_torch import check_device, knet_on_torch, refinement_on_torch
        except ModuleNotFoundError as error:
            raise MissingPackageError("fgrecon[torch]", "The keypoint networks on PyTorch") from error
        check_device(self.device)
        first = knet_on_torch(self._layout, self._arrays, self.device, threads)
        return first, None if finer is None else refinement_on_torch(finer, self._finer_arrays, self.device, threads)

    def __getstate__(self) -> dict[str, Any]:
        """What other processes get: the networks are made of their arrays there again."""
        made = ("_find", "_refine_patches")
        return {name: value for name, value in vars(self).items() if name not in made}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """The reverse of `__getstate__`."""
        vars(self).update(state)
        self._find, self._refine_patches = self._running()

    def __call__(
        self, image: NDArray[Any], boxes: ArrayLike, *, maps: bool = False, batch: int = 32
    ) -> list[CascadeDetection]:
        """Keypoints of every box.

        Args:
            image: (H, W, 3) RGB or (H, W) grey, 8 or 16 bits; or (H, W, 4) with transparency, which is dropped.
            boxes: (N, 4) x1, y1, x2, y2 in pixels.
            maps: Whether to keep the likelihood maps.
            batch: Most vehicles at a time.

        Raises:
            InvalidInputError: The image is none, or a box is too small or not in it; names the box.
        """
        pixels = as_rgb8(image)
        corners = as_finite("boxes", as_rows("boxes", boxes, 4), (None, 4))
        for number, box in enumerate(corners):
            check_box(box, pixels, f"boxes[{number}]")
        detections: list[CascadeDetection] = []
        for start in range(0, len(corners), batch):
            some = corners[start : start + batch]
            detections += self.detect_batch([pixels] * len(some), some, maps=maps)
        return detections

    def detect_batch(
        self, images: Sequence[NDArray[np.uint8]], boxes: NDArray[np.float64], *, maps: bool = False
    ) -> list[CascadeDetection]:
        """Keypoints of one box (B, 4) in each of B RGB images (H, W, 3), in one batch; nothing is checked."""
        size = self._settings.crop
        crops = [crop_of(box, size) for box in boxes]
        pixels = np.stack([extract(image, crop) for image, crop in zip(images, crops, strict=True)])
        likelihood, visible, azimuth, kinds = self.mirror_average(pixels) if self.mirror else self.forward(pixels)
        decoded = decode(likelihood, size / likelihood.shape[-1], REACH * size / MARGIN)
        confidence = self.calibration.confidence(visible, decoded.mass)
        azimuth = self.calibration.direction(azimuth)
        kinds = None if kinds is None else self.calibration.kinds(kinds)
        if self._refine_patches is not None:
            decoded = self._refine(self._refine_patches, images, boxes, likelihood, decoded)
        detections = []
        for row, (box, crop) in enumerate(zip(boxes, crops, strict=True)):
            directions = azimuth[row]
            covariance = self.calibration.covariance(decoded.covariance[row], size / MARGIN) / crop.scale**2
            observation = Observation(
                crop.to_image(decoded.points[row]), confidence[row], box, covariance, _EVEN, directions
            )
            visibility = 0.5 * (1.0 + np.tanh(0.5 * visible[row]))
            kept = likelihood[row] if maps else None
            named = None if kinds is None else dict(zip(KINDS, kinds[row].tolist(), strict=False))
            crop_seen = (decoded.mass[row], crop, kept)
            detections.append(CascadeDetection(observation, directions, visibility, *crop_seen, kinds=named))
        return detections

    def _refine(
        self, networks: Network, images: Sequence[NDArray[np.uint8]], boxes: Array, likelihood: Array, first: Decoded
    ) -> Decoded:
        """KNet's positions and covariances corrected by the refinement networks; pixels of KNet's crop."""
        assert self._finer is not None
        size, finer = self._settings.crop, self._finer.crop
        fine = np.stack([extract(image, crop_of(box, finer)) for image, box in zip(images, boxes, strict=True)])
        ratio = finer / size
        centres = np.rint((first.points + 0.5) * ratio - 0.5).astype(np.int64)
        offsets = patch_offsets(SETTINGS.patches, centres.shape[1])
        corners = centres[:, None] + offsets - PATCH // 2
        patches = run_networks(networks, cut_patches(fine, corners))
        before = window_of(likelihood, centres, finer)
        joint, origin = fuse(patches, offsets, centres, before, self.trust)
        pixels, covariance = peak(joint)
        return Decoded((pixels + origin + 0.5) / ratio - 0.5, covariance / ratio**2, first.mass)

    def mirror_average(self, crops: NDArray[np.uint8]) -> tuple[Array, Array, Array, Array | None]:
        """`forward` on the crops and their mirror images, averaged; in these left and right change places."""
        count = len(crops)
        maps, visible, azimuth, kinds = self.forward(np.concatenate([crops, crops[:, :, ::-1]]))
        partner = self._partner
        mirrored = np.concatenate([azimuth[count:, :1], azimuth[count:, :0:-1]], axis=1)
        return (
            (maps[:count] + maps[count:][:, partner][..., ::-1]) / 2,
            (visible[:count] + visible[count:][:, partner]) / 2,
            (azimuth[:count] + mirrored) / 2,
            None if kinds is None else (kinds[:count] + kinds[count:]) / 2,
        )

    def forward(self, crops: NDArray[np.uint8]) -> tuple[Array, Array, Array, Array | None]:
        """Likelihood maps (B, K, H, W), visibility logits (B, K), directions (B, A), kinds (B, N) of crops.

        Crops are (B, S, S, 3); kinds are None where the network does not tell them.
        """
        likelihood, visible, azimuth, *kind = (array.astype(np.float64) for array in self._find(crops))
        return likelihood, visible, softmax(azimuth), softmax(kind[0]) if kind else None


def _of_file(path: Path, kind: type[S], sizes: Mapping[str, int]) -> S:
    """Settings from the sizes in a file."""
    try:
        return kind(**sizes)
    except TypeError as error:
        fix = f"Give a network of this version ({error})."
        raise InvalidInputError("weights", str(path), fix) from error


def detect_keypoints(image: NDArray[Any], boxes: ArrayLike) -> list[Observation]:
    """Keypoints of the vehicles in an image, by the network that comes with the package (`car14`).

    Args:
        image: (H, W, 3) RGB, or grey; 8 or 16 bits.
        boxes: (N, 4) x1, y1, x2, y2 of the vehicles in pixels.

    Returns:
        One observation per box, ready for `fgrecon.reconstruct`.

    Raises:
        InvalidInputError: The image is none, a box is too small or outside, or the package has no network.
    """
    return [detection.observation for detection in shipped_cascade()(image, boxes)]


@lru_cache(maxsize=1)
def shipped_cascade() -> KeypointCascade:
    """The networks that come with the package, loaded once and shared.

    Raises:
        InvalidInputError: This installation has none.
    """
    return KeypointCascade()


def as_rgb8(image: NDArray[Any]) -> NDArray[np.uint8]:
    """An image as (H, W, 3) RGB bytes."""
    given: object = image
    if isinstance(given, bytes | bytearray):
        fix = "Give its path, or its pixels: `fgrecon.read_image` and `cv2.imdecode` have them."
        raise InvalidInputError("image", f"{len(given)} bytes of a file", fix)
    pixels = np.asarray(image)
    fix = "Give an array (H, W, 3) of RGB or (H, W) of grey values, uint8 or uint16."
    if pixels.ndim == 2:
        pixels = pixels[..., None]
    if pixels.ndim != 3 or pixels.shape[2] not in (1, 3, 4) or 0 in pixels.shape:
        raise InvalidInputError("image", f"shape {pixels.shape}", fix)
    if pixels.dtype == np.uint16:
        pixels = (pixels // 257).astype(np.uint8)
    if pixels.dtype != np.uint8:
        raise InvalidInputError("image", str(pixels.dtype), fix)
    colours = pixels[..., :3] if pixels.shape[2] > 1 else np.repeat(pixels, 3, axis=2)
    return np.asarray(colours, dtype=np.uint8)


def large_enough(boxes: Array) -> NDArray[np.bool_]:
    """Whether there are keypoints to see in boxes (..., 4): sides that are longer than 0, one of `SMALLEST_BOX`."""
    sides = boxes[..., 2:] - boxes[..., :2]
    return (sides > 0.0).all(axis=-1) & (sides.max(axis=-1) >= SMALLEST_BOX)


def check_box(box: Array, image: NDArray[np.uint8], field: str = "box") -> None:
    """Refuse a box in which no keypoints can be found."""
    height, width = image.shape[:2]
    check_corners(field, box)
    size = box[2:] - box[:2]
    if not large_enough(box):
        raise InvalidInputError(field, box.tolist(), f"Give a vehicle of at least {SMALLEST_BOX:g} pixels.")
    inner = np.minimum(box[2:], [width - 0.5, height - 0.5]) - np.maximum(box[:2], -0.5)
    if not (inner > 0).all() or inner.prod() < SETTINGS.min_inside * size.prod():
        raise InvalidInputError(field, box.tolist(), f"Give a box inside the image of {width} x {height} pixels.")
