"""Keypoints from pixels: the networks at work.

`detect` runs them, `knet` and `refine` are the networks, `weights` their file; `crops` cuts out what they look at and
`decode` reads positions off their maps. `fgrecon.training.keypoints` trains them. PyTorch is imported on use.
"""

from fgrecon.core.detection import Detection
from fgrecon.core.renamed import renamed
from fgrecon.perception.keypoints.detect import CascadeDetection, KeypointCascade, detect_keypoints

__all__ = ["CascadeDetection", "Detection", "KeypointCascade", "detect_keypoints"]

__getattr__ = renamed(__name__, {"Detector": "KeypointCascade"})
