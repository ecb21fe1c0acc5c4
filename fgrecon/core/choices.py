"""Enumerations of options, apart from what they do: the command line lists them before numpy is imported."""

from __future__ import annotations

from enum import StrEnum


class BoxModel(StrEnum):
    """What a 2D box encloses."""

    SURFACE = "surface"
    """The vehicle's outline, as detectors draw it (the prior's surface; without one, its 3D box)."""
    CUBOID = "cuboid"
    """The projected corners of the vehicle's 3D box, as KITTI's labels and detectors trained on them have it."""
    DETECTED = "detected"
    """The outline, as the package's own vehicle detector draws it: wider than it is, and lower at the top."""
    OFF = "off"
    """The box places the start and scales the noise, but is no evidence."""


class BoxOrigin(StrEnum):
    """What the location of a 3D box is."""

    BOTTOM = "bottom"
    """The centre of its bottom face, as in KITTI's files."""
    CENTRE = "centre"
    """Its centre."""


class TrafficSide(StrEnum):
    """The side of the road that traffic keeps to."""

    RIGHT = "right"
    LEFT = "left"


class ClassScheme(StrEnum):
    """Whose names classes of vehicles have."""

    FGRECON = "fgrecon"
    KITTI = "kitti"
    COCO = "coco"
    """A van is a car, a truck or a bus there; how often was counted with the package's own vehicle detector."""
    YOLO = "yolo"
    """COCO's names."""
    NUSCENES = "nuscenes"
    """Those of its annotations and those of its detection task."""
    OPENLABEL = "openlabel"
    """Those of its ontology, with `Vehicle` before them or without."""


class ClassSource(StrEnum):
    """Who says of which class vehicles are."""

    LABELS = "labels"
    """Whoever labelled or found them: the file of their boxes, keypoints or tracks."""
    DETECTED = "detected"
    """The package's own vehicle detector."""
    KEYPOINTS = "keypoints"
    """The keypoint networks."""


class StrategyName(StrEnum):
    """The robust strategies by name; `fgrecon.core.robust` says what each does."""

    MIXTURE = "mixture"
    PAPER = "paper"
    PAPER_LITERAL = "paper_literal"
    HUBER = "huber"
    CAUCHY = "cauchy"
    GEMAN_MCCLURE = "geman_mcclure"
    TUKEY = "tukey"
    GNC = "gnc"


class DepthScale(StrEnum):
    """What the numbers of a depth map are."""

    METRIC = "metric"
    """Metres."""
    SCALE = "scale"
    """Metres times an unknown number."""
    SCALE_AND_SHIFT = "scale_and_shift"
    """Metres times an unknown number, and plus one."""
