"""The vehicles of a scene as its recording calls them: their branches of the entities."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from fgrecon.core.text import distinct
from fgrecon.viz import entities
from fgrecon.viz.picture import Sight

__all__ = ["Member", "members_of"]


@dataclass(frozen=True)
class Member:
    """A vehicle of a scene on its way into a recording.

    Attributes:
        number: Its place in the scene, which is its colour.
        title: What it is called.
        name: The same in paths.
        sight: What is recorded.
    """

    number: int
    title: str
    name: str
    sight: Sight

    def place(self, entity: str) -> str:
        """Where the recording has one of its entities."""
        return entities.of_vehicle(entity, self.name)


def members_of(sights: Sequence[Sight]) -> list[Member]:
    """The vehicles with names that paths can have, no two alike."""
    members: list[Member] = []
    taken: set[str] = set()
    for number, sight in enumerate(sights):
        title = sight.title or str(number)
        plain = re.sub(r"[^\w.-]+", "-", title, flags=re.ASCII).strip("-.") or str(number)
        members.append(Member(number, title, distinct(plain, taken), sight))
    return members
