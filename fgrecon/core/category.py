"""A vehicle category as data: names, symmetry, faces, edges and dimensions of its keypoints.

A category is a JSON file (see `fgrecon/data/categories/car14.json`): another category needs a file, not a patch.
All indices are 0-based; the file itself refers to keypoints by name. This module does no I/O: see
`fgrecon.io.catalogue` for reading a category by name or path.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.checks import as_instance, own
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.repr import brief_repr
from fgrecon.core.settings import check_settings, flag, number

DIMENSIONS = ("length", "width", "height")
"""The three dimensions in the order used everywhere; their object axes are x, z and y."""

_FIELDS = ["name", "keypoints", "symmetric_pairs", "faces", "edges", "neighbours", "dimensions", "ground", "motion"]

_DIRECTIONS = {"length": (1.0, 0.0, 0.0), "width": (0.0, 0.0, 1.0), "height": (0.0, -1.0, 0.0)}


@dataclass(frozen=True)
class MotionModel:
    """What is known of the motion of a category's vehicles, over a world that stands still.

    Attributes:
        wheeled: Whether they move along their heading, stand at times, and turn while they move alone.
        acceleration: By how much speed changes in a second (1 sigma), metres per second.
        turning: By how much the turn rate changes in a second (1 sigma), radians per second.
        slip: Speed across the heading (1 sigma), metres per second; of those with wheels.
        radius: Radius of the turning circle, metres; of those with wheels.
        standing: Speed below which they are taken to stand, metres per second; of those with wheels.
    """

    wheeled: bool = flag(default=True)
    acceleration: float = number(2.0, least=1e-3, most=1e3)
    turning: float = number(0.3, least=1e-4, most=1e3)
    slip: float = number(0.3, least=1e-3, most=1e3)
    radius: float = number(5.0, least=1e-3, most=1e3)
    standing: float = number(0.2, least=1e-4, most=1e3)

    def __post_init__(self) -> None:
        """Check the numbers (`InvalidInputError`)."""
        check_settings(self, "category.motion")

    @classmethod
    def from_dict(cls, data: object) -> MotionModel:
        """The model of a category's file; what it does not name is as in the default.

        Raises:
            InvalidInputError: It is no object, or names something that there is not.
        """
        names = [entry.name for entry in fields(cls)]
        if not isinstance(data, dict) or not set(data) <= set(names):
            raise InvalidInputError("category.motion", data, f"Give an object with some of {', '.join(names)}.")
        return cls(**data)

    def to_dict(self) -> dict[str, bool | float]:
        """Every field by name; `from_dict` reads it back."""
        return asdict(self)


@dataclass(frozen=True)
class Face:
    """A quad of keypoints that lie in one plane, in order around the quad."""

    name: str
    keypoints: tuple[int, ...]
    ground_parallel: bool
    rectangular: bool


@dataclass(frozen=True)
class Dimension:
    """One dimension, measured between the centroids of two groups of keypoints along an object axis.

    Attributes:
        name: `length`, `width` or `height`.
        plus: Keypoints at the far end (front, left, top).
        minus: Keypoints at the near end (rear, right, bottom).
        ratio: Distance between the centroids divided by the dimension of the vehicle's box (lamp to lamp is about 0.88
            of a car's length).
    """

    name: str
    plus: tuple[int, ...]
    minus: tuple[int, ...]
    ratio: float

    @property
    def direction(self) -> NDArray[np.float64]:
        """Unit vector of the object frame from `minus` to `plus`."""
        return np.array(_DIRECTIONS[self.name])


@dataclass(frozen=True)
class Category:
    """Everything that is known about a vehicle category apart from its shape.

    Attributes:
        name: Name of the category, such as `car14`.
        keypoints: K keypoint names, in the order of every array of this category.
        symmetric_pairs: Pairs (left, right) of mirror images about the medial plane z = 0.
        faces: Planar faces.
        edges: Pairs of keypoints joined in the drawn wireframe.
        neighbours: For each keypoint the keypoints whose centroid it stays close to (Laplacian term).
        dimensions: Length, width and height, in this order.
        ground_keypoints: Keypoints at a common height above the ground (the wheels).
        ground_ratio: Their height above the ground divided by the height of the vehicle's box.
        motion: How such vehicles move.
    """

    name: str
    keypoints: tuple[str, ...]
    symmetric_pairs: tuple[tuple[int, int], ...]
    faces: tuple[Face, ...]
    edges: tuple[tuple[int, int], ...]
    neighbours: tuple[tuple[int, ...], ...]
    dimensions: tuple[Dimension, ...]
    ground_keypoints: tuple[int, ...]
    ground_ratio: float
    motion: MotionModel = field(default_factory=MotionModel)

    __repr__ = brief_repr

    @property
    def size(self) -> int:
        """Number of keypoints K."""
        return len(self.keypoints)

    @cached_property
    def mirror(self) -> NDArray[np.intp]:
        """(K,) index of each keypoint's mirror image; its own index where it is on the medial plane."""
        mirror = np.arange(self.size)
        for left, right in self.symmetric_pairs:
            mirror[left], mirror[right] = right, left
        return own(mirror)

    @cached_property
    def off_faces(self) -> NDArray[np.intp]:
        """Keypoints on no planar face: parts that stand out of the body, such as mirrors."""
        return own(np.setdiff1d(np.arange(self.size), [k for face in self.faces for k in face.keypoints]))

    @cached_property
    def dimension_operator(self) -> NDArray[np.float64]:
        """(3, K, 3) linear map from keypoints (K, 3) to the box's length, width and height, in metres."""
        operator = np.zeros((3, self.size, 3))
        for row, dimension in enumerate(self.dimensions):
            direction = dimension.direction / dimension.ratio
            operator[row, list(dimension.plus)] += direction / len(dimension.plus)
            operator[row, list(dimension.minus)] -= direction / len(dimension.minus)
        return own(operator)

    def box_size(self, keypoints: NDArray[np.float64]) -> NDArray[np.float64]:
        """(3,) length, width and height of the box of a vehicle with these keypoints (K, 3), in metres."""
        operator = self.dimension_operator
        size: NDArray[np.float64] = operator.reshape(3, -1).dot(keypoints.reshape(-1, 1))
        return size[:, 0]

    def index(self, keypoint: str, field: str = "keypoint") -> int:
        """Index of a keypoint by its name.

        Args:
            keypoint: The name.
            field: What an error calls it.

        Raises:
            InvalidInputError: The category has no such keypoint.
        """
        try:
            return self.keypoints.index(keypoint)
        except ValueError:
            fix = f"Use the keypoints of {self.name}: {', '.join(self.keypoints)}."
            raise InvalidInputError(field, keypoint, fix) from None

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Category:
        """Build and check a category from the content of its JSON file.

        Raises:
            InvalidInputError: A field is missing, of the wrong kind, or names an unknown keypoint.
        """
        return _Reader(as_instance("category", data, Mapping)).category()

    def to_dict(self) -> dict[str, Any]:
        """The content of the category's JSON file; `from_dict` reads it back."""
        names = self.keypoints

        def named(indices: tuple[int, ...]) -> list[str]:
            return [names[i] for i in indices]

        return {
            "name": self.name,
            "keypoints": list(names),
            "symmetric_pairs": [named(pair) for pair in self.symmetric_pairs],
            "faces": [
                {
                    "name": face.name,
                    "keypoints": named(face.keypoints),
                    "ground_parallel": face.ground_parallel,
                    "rectangular": face.rectangular,
                }
                for face in self.faces
            ],
            "edges": [named(edge) for edge in self.edges],
            "neighbours": {names[i]: named(near) for i, near in enumerate(self.neighbours)},
            "dimensions": {
                d.name: {"plus": named(d.plus), "minus": named(d.minus), "ratio": d.ratio} for d in self.dimensions
            },
            "ground": {"keypoints": named(self.ground_keypoints), "ratio": self.ground_ratio},
            **({} if self.motion == MotionModel() else {"motion": self.motion.to_dict()}),
        }


class _Reader:
    """Reads the fields of a category file and names the field in every error."""

    def __init__(self, data: Mapping[str, Any]) -> None:
        self.data = data
        names = self.get("keypoints", list)
        if len(names) < 4 or not all(isinstance(n, str) for n in names) or len(set(names)) != len(names):
            raise InvalidInputError("category.keypoints", names, "Give at least four distinct keypoint names.")
        self.names: list[str] = names

    def category(self) -> Category:
        self.known("category", self.data, _FIELDS)
        ground = self.get("ground", dict)
        self.known("category.ground", ground, ("keypoints", "ratio"))
        self.known("category.dimensions", self.get("dimensions", dict), DIMENSIONS)
        edges = tuple(self.group("edges", edge, 2) for edge in self.get("edges", list))
        return Category(
            name=self.get("name", str),
            keypoints=tuple(self.names),
            symmetric_pairs=self.pairs(),
            faces=tuple(self.face(face) for face in self.get("faces", list)),
            edges=tuple((a, b) for a, b in edges),
            neighbours=self.neighbours(edges),
            dimensions=tuple(self.dimension(name) for name in DIMENSIONS),
            ground_keypoints=self.group("ground.keypoints", ground.get("keypoints")),
            ground_ratio=self.ratio("ground.ratio", ground.get("ratio"), lowest=0.0),
            motion=MotionModel.from_dict(self.data.get("motion", {})),
        )

    def get(self, field: str, kind: type) -> Any:
        value = self.data.get(field)
        if not isinstance(value, kind):
            raise InvalidInputError(f"category.{field}", value, f"Give a {kind.__name__}.")
        return value

    @staticmethod
    def known(where: str, entry: Mapping[str, Any], fields: Sequence[str]) -> None:
        """A misspelt field would be left out without a word, and what it says with it."""
        if unknown := [name for name in entry if name not in fields]:
            raise InvalidInputError(where, unknown[0], f"Give no other fields than {', '.join(fields)}.")

    @staticmethod
    def flag(field: str, entry: Mapping[str, Any], name: str) -> bool:
        value = entry.get(name, False)
        if not isinstance(value, bool):
            raise InvalidInputError(f"category.{field}.{name}", value, "Give true or false.")
        return value

    def group(self, field: str, names: Any, size: int | None = None) -> tuple[int, ...]:
        if not isinstance(names, list) or not names or (size is not None and len(names) != size):
            raise InvalidInputError(f"category.{field}", names, f"Give a list of {size or 'some'} keypoint names.")
        for name in names:
            if name not in self.names:
                raise InvalidInputError(f"category.{field}", name, "Use a name that is listed under keypoints.")
        if len(set(names)) != len(names):
            raise InvalidInputError(f"category.{field}", names, "Name each keypoint once.")
        return tuple(self.names.index(name) for name in names)

    def pairs(self) -> tuple[tuple[int, int], ...]:
        pairs = [self.group("symmetric_pairs", pair, 2) for pair in self.get("symmetric_pairs", list)]
        used = [i for pair in pairs for i in pair]
        if len(set(used)) != len(used):
            raise InvalidInputError("category.symmetric_pairs", pairs, "Put each keypoint in at most one pair.")
        return tuple((a, b) for a, b in pairs)

    def face(self, face: Any) -> Face:
        if not isinstance(face, Mapping) or not isinstance(face.get("name"), str):
            raise InvalidInputError("category.faces", face, "Give an object with name and keypoints.")
        field = f"faces.{face['name']}"
        self.known(f"category.{field}", face, ("name", "keypoints", "ground_parallel", "rectangular"))
        keypoints = self.group(field, face.get("keypoints"))
        if len(keypoints) < 3:
            raise InvalidInputError(f"category.{field}", keypoints, "Give at least three keypoints.")
        rectangular = self.flag(field, face, "rectangular")
        if rectangular and len(keypoints) != 4:
            raise InvalidInputError(f"category.{field}", keypoints, "A rectangle needs four keypoints.")
        return Face(face["name"], keypoints, self.flag(field, face, "ground_parallel"), rectangular)

    def neighbours(self, edges: tuple[tuple[int, ...], ...]) -> tuple[tuple[int, ...], ...]:
        """The named neighbourhoods; a keypoint without one has the keypoints it shares an edge with."""
        given = self.data.get("neighbours", {})
        if not isinstance(given, Mapping):
            raise InvalidInputError("category.neighbours", given, "Give an object from keypoint to list of keypoints.")
        self.known("category.neighbours", given, self.names)
        result: list[tuple[int, ...]] = []
        for i, name in enumerate(self.names):
            if name in given:
                result.append(self.group(f"neighbours.{name}", given[name]) if given[name] else ())
            else:
                result.append(tuple(sorted({b if a == i else a for a, b in edges if i in (a, b)})))
        return tuple(result)

    def dimension(self, name: str) -> Dimension:
        entry = self.get("dimensions", dict).get(name)
        if not isinstance(entry, Mapping):
            raise InvalidInputError(f"category.dimensions.{name}", entry, "Give an object with plus, minus and ratio.")
        field = f"dimensions.{name}"
        self.known(f"category.{field}", entry, ("plus", "minus", "ratio"))
        return Dimension(
            name,
            self.group(f"{field}.plus", entry.get("plus")),
            self.group(f"{field}.minus", entry.get("minus")),
            self.ratio(f"{field}.ratio", entry.get("ratio"), lowest=1e-3),
        )

    def ratio(self, field: str, value: Any, lowest: float) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not lowest <= value <= 10.0:
            raise InvalidInputError(f"category.{field}", value, f"Give a number from {lowest} to 10.")
        return float(value)
