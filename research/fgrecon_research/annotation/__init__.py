"""Keypoint labels of vehicles whose 3D boxes are known: what networks are trained on, and others ask for."""
