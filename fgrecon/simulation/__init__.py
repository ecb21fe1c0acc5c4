"""Vehicles, keypoints and images that the project makes itself, with known truth."""
