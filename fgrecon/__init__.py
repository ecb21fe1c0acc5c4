"""Pose and shape of a vehicle from a single image, by factor-graph optimisation."""
