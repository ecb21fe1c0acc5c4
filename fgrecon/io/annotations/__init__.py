"""2D keypoint annotations of many instances, and readers for the formats that people have."""

from fgrecon.io.annotations.annotations import Annotations, spread
from fgrecon.io.annotations.reader import FORMATS, load_annotations

__all__ = ["FORMATS", "Annotations", "load_annotations", "spread"]
