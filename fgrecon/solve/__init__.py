"""From keypoints to pose and shape: proposals, factor graph, result."""
