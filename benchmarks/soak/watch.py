"""Whether the energy of a solve ever rises: what the solvers are seen to do, step by step.

The energy of an accepted step is that of its graph with visibility held, without the direction. These two may raise
the whole energy from one step to the next, and do: visibility follows the pose after every step and is no force of the
solver's (`fgrecon.solve.graph.newton`), and the direction has no gradient: it decides between minima
(`fgrecon.solve.proposals.direction`). Re-weighting that anneals, or whose weights belong to no energy (the paper's),
promises nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any
from unittest import mock

import gtsam

from fgrecon.solve.graph import newton, optimise
from fgrecon.solve.graph.graph import Graph
from fgrecon.solve.graph.observation_part import Weights

__all__ = ["Watch", "watched"]

_NO_FORCE = "direction"
_ROUNDING = 1e-8  # relative to the energy and one nat


@dataclass
class Watch:
    """What was seen.

    Attributes:
        steps: Accepted steps.
        rises: Steps after which the energy was higher, beyond rounding.
        highest: The highest rise, relative to the energy and one nat.
    """

    steps: int = 0
    rises: int = 0
    highest: float = 0.0

    def look(self, before: float, after: float) -> None:
        """Take note of the energies before and after a step."""
        rise = (after - before) / (1.0 + abs(before))
        self.steps += 1
        self.rises += int(not rise <= _ROUNDING)
        self.highest = max(self.highest, rise)


def _energy(graph: Graph, values: gtsam.Values, weights: list[Weights]) -> float:
    return sum(energy for name, energy in graph.energies(values, weights).items() if name != _NO_FORCE)


@contextmanager
def watched() -> Iterator[Watch]:
    """Watch every solve within."""
    watch = Watch()

    class Descent(newton.Descent):
        def _iterate(self, steps: Any) -> bool:
            before = _energy(self.graph, self.values, self.weights)
            ended = super()._iterate(steps)
            watch.look(before, _energy(self.graph, self.values, self.weights))
            return ended

    class Loop(optimise._Loop):  # noqa: SLF001  # to look into it
        def solve(self, tolerance: float) -> None:
            before = _energy(self.graph, self.values, self.weights)
            super().solve(tolerance)
            if self.strategy.descends and not self.strategy.anneals:
                watch.look(before, _energy(self.graph, self.values, self.weights))

    with mock.patch.object(optimise, "Descent", Descent), mock.patch.object(optimise, "_Loop", Loop):
        yield watch
