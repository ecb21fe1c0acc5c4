"""How far pictures are apart: both are made smaller first, since fonts and edges move by less than a pixel."""

import os
from pathlib import Path

import numpy as np
from PIL import Image

SMALLER, COLOURS = 4, 64
MEAN, WORST = 4.0, 18.0
"""Grey levels of 255: mean over the picture, and over the worst of a hundred parts."""


def smaller(image: np.ndarray) -> np.ndarray:
    height, width = (side // SMALLER * SMALLER for side in image.shape[:2])
    blocks = image[:height, :width].astype(np.float64)
    return blocks.reshape(height // SMALLER, SMALLER, width // SMALLER, SMALLER, 3).mean(axis=(1, 3))


def differences(image: np.ndarray, reference: np.ndarray) -> tuple[float, float]:
    """Mean difference, and that of the worst of a hundred parts."""
    apart = np.abs(smaller(image) - smaller(reference)).mean(axis=2)
    parts = [block.mean() for row in np.array_split(apart, 10) for block in np.array_split(row, 10, axis=1)]
    return float(apart.mean()), float(max(parts))


def check_like(path: Path, image: np.ndarray) -> None:
    """Compare a picture with its reference, which FGRECON_REFERENCES=1 in the environment writes anew."""
    if os.environ.get("FGRECON_REFERENCES"):
        Image.fromarray(image).quantize(COLOURS).save(path, optimize=True)
    reference = np.asarray(Image.open(path).convert("RGB"))
    assert image.shape == reference.shape
    mean, worst = differences(image, reference)
    assert mean < MEAN
    assert worst < WORST
