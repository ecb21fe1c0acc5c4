"""Pose adjustment: ASPnP, visibility, weights."""
