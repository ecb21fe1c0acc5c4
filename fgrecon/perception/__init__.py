"""From photographs to keypoints and cars: detectors and networks at work."""
