"""Keypoints from pixels: the networks, what trains them, and the labels that they make for one another.

`labels` finds the shapes behind groups of photographs and projects first labels; `dataset` and `augment` make training
samples; `knet` is the network and `train` trains it; `relabel` lets its predictions correct the labels in a factor
graph; `detect` is the network at work. PyTorch is imported only by what needs it.
"""

from fgrecon.perception.keypoints.detect import Detection, Detector, detect_keypoints

__all__ = ["Detection", "Detector", "detect_keypoints"]
