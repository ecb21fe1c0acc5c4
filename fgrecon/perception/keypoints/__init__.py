"""Keypoints from pixels: the networks at work.

`detect` runs them. `layout` says what they are made of, `knet` and `refine` are these on PyTorch, `export` makes ONNX
files of them; `weights` is their file. `crops` and `patches` cut out what they look at and `decode` reads positions off
their maps. PyTorch is imported on use, and ONNX Runtime does without it.
"""

from fgrecon.core.detection import Detection
from fgrecon.perception.keypoints.detect import CascadeDetection, KeypointCascade, detect_keypoints

__all__ = ["CascadeDetection", "Detection", "KeypointCascade", "detect_keypoints"]
