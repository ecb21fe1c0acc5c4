"""Keypoints from other programs' files and objects, in their own names and orders."""

from fgrecon.io.keypoints.any_keypoints import keypoints_from, parse_any_keypoints, read_any_keypoints
from fgrecon.io.keypoints.names import NamesLike, shipped_schemes
from fgrecon.io.keypoints.records import NOT_JSON

__all__ = ["NOT_JSON", "NamesLike", "keypoints_from", "parse_any_keypoints", "read_any_keypoints", "shipped_schemes"]
