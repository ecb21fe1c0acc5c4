"""How the vehicles of a category move: data of its file."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.settings import check_settings, flag, number

__all__ = ["MotionModel"]


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
