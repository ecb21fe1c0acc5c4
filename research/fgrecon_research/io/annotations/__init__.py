"""2D keypoint annotations of many instances, and readers for the formats that people have."""

from fgrecon_research.io.annotations.annotations import Annotations, spread
from fgrecon_research.io.annotations.reader import FORMATS, load_annotations

__all__ = ["FORMATS", "Annotations", "load_annotations", "spread"]
