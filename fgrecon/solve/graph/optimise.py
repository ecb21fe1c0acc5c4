"""Minimisation of a graph's energy, for one image of a car as for a track.

Where the robust losses are inside the factors Newton's method finds it (`fgrecon.solve.graph.newton`). The m-estimators
and the paper's strategies are iteratively re-weighted least squares: weights are made from the residuals, visibility
from the poses; GTSAM solves under them; and so on. With visibility held every such solve lowers the robust energy (the
weights are those of a majorising function), and a state that weights and solve leave alone is a minimum of it.
Visibility is not part of that argument: made anew each time it can swing between two views of a car for ever. So the
loop has two parts:

1. updates with visibility made anew until the weights settle, at most four times `RobustStrategy.updates`; where they
   swing, the best of these states is taken;
2. visibility held as it is there, updates until a solve moves nothing. The steps of such a
   sequence shrink by a nearly constant factor, so that its end can be guessed (Aitken); a guess that does not lower the
   energy is not taken.

The strategies of the paper's Eqs. 4 and 5, whose weights belong to no energy, make all their updates instead.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import gtsam
import numpy as np

from factors.mixture import Form
from fgrecon.core.arrays import Array
from fgrecon.core.errors import DegenerateProblemError
from fgrecon.solve.graph.graph import Graph, State
from fgrecon.solve.graph.graph_settings import SETTINGS
from fgrecon.solve.graph.newton import Descent, Step
from fgrecon.solve.graph.observation_part import Weights
from fgrecon.solve.graph.solver import minimise

REWEIGHTING = SETTINGS.reweighting


@dataclass(frozen=True)
class Optimum:
    """Where the loop ended."""

    state: State  # poses, shapes and weights
    values: gtsam.Values  # the same, with planes
    make_energies: Callable[[], dict[str, float]]
    steps: tuple[Step, ...]  # every step, if asked for
    iterations: int  # number of the solver's iterations
    make_gains: tuple[Callable[[], float], ...]  # of each stage: the energy at its start minus that at its end, nats
    failure: str | None = None  # why the loop gave up, or None; the rest is then the state before
    unfinished: str | None = None  # where it was stopped short of a minimum, or None

    @property
    def energies(self) -> dict[str, float]:
        """Energy by term over everything, nats; none where they were not asked for or it gave up."""
        return self.make_energies()

    @cached_property
    def gain(self) -> float:
        """Energy at the start minus that at the end, nats; NaN where the strategy defines none."""
        return sum(make() for make in self.make_gains)

    @property
    def energy(self) -> float:
        """The whole energy, nats; infinite where the loop gave up."""
        return sum(self.energies.values()) if self.failure is None else float("inf")


def optimise(graph: Graph, start: State, most: int | None = None, steady: float | None = None) -> Optimum:
    """Minimise a graph's energy from a state.

    Args:
        graph: The graph; its options say how.
        start: Where to start, every keypoint in front of its camera.
        most: Make no more of Newton's steps than that, and tell no energies: for a start near the minimum, which is to
            be come closer to.
        steady: End where the next of Newton's steps will move no variable by more: for an end from which another graph
            goes on. None for the minimum itself.

    Returns:
        The end. Where the start is behind the camera or a system is singular, the state so far and why.
    """
    loop = Descent(graph, start, most, steady) if graph.is_robust else _Loop(graph, start)
    failure = None
    try:
        graph.check_in_front(loop.values, loop.point)
        loop.run()
    except DegenerateProblemError as error:
        failure = str(error)
    has_energies = failure is None and most is None
    energies = graph.read_energies(loop.values, loop.weights) if has_energies else dict
    known = has_energies and graph.options.strategy.descends
    return Optimum(
        state=graph.read(loop.values, loop.weights),
        values=loop.values,
        make_energies=energies,
        steps=tuple(loop.steps),
        iterations=loop.iterations,
        make_gains=(lambda: loop.first - sum(energies().values()) if known else float("nan"),),
        failure=failure,
        unfinished=None if loop.converged else f"after {loop.iterations} iterations",
    )


class _Loop:
    """The loop's variables: values and weights, and what it has done."""

    def __init__(self, graph: Graph, start: State) -> None:
        self.graph, self.strategy = graph, graph.options.strategy
        self.values, self.weights = graph.values(start), list(start.weights)
        self.point = None
        self.steps: list[Step] = []
        self.iterations = self.update = 0
        self.converged = True
        self.first = float("nan")

    def run(self) -> None:
        updates = max(self.strategy.updates, 1)
        updates_to_make = (
            updates if self.strategy.anneals or not self.strategy.descends else REWEIGHTING.refreshed_updates * updates
        )
        best: tuple[float, gtsam.Values, list[Weights]] | None = None
        settled = False
        for update in range(updates_to_make):
            change = self.reweigh(min(update / max(updates - 1, 1), 1.0))
            energy = self.energy()
            self.first = energy if update == 0 else self.first
            if best is None or energy < best[0] or self.strategy.anneals:
                best = energy, self.values, self.weights
            settled = update > 0 and change < REWEIGHTING.settled_weight_change and not self.strategy.anneals
            if settled and self.strategy.descends:
                break  # what is left is for the second part
            last = settled or update == updates_to_make - 1
            final = last and not self.strategy.descends
            self.solve(REWEIGHTING.final_relative_decrease if final else REWEIGHTING.early_relative_decrease)
            if last:
                break
        if self.strategy.descends and best is not None and not self.values.empty():
            self.reweigh(1.0)
            if not self.strategy.anneals and best[0] < self.energy() - (REWEIGHTING.drift_nats if settled else 0.0):
                _, self.values, self.weights = best
            self.settle()

    def settle(self) -> None:
        """The second part: visibility held, until nothing moves."""
        before: Array | None = None
        for _ in range(REWEIGHTING.held_updates):
            self.reweigh(1.0, hold=True)
            start = self.values
            self.solve(REWEIGHTING.final_relative_decrease)
            step = start.localCoordinates(self.values)
            moved: Array = step.vector()
            if np.abs(moved).max() <= REWEIGHTING.still:
                self.converged = True
                return
            if before is not None:
                self.guess(step, float(moved @ before / (before @ before)), self.energy())
            if self.iterations >= REWEIGHTING.most_iterations:
                break
            before = moved
        self.converged = False

    def guess(self, step: gtsam.VectorValues, ratio: float, energy: float) -> None:
        """Go on along the last step to where a geometric sequence of such steps would end, if that is lower."""
        if not 0.0 < ratio < 1.0:
            return
        ahead = gtsam.VectorValues(step)
        ahead.scaleInPlace(min(ratio / (1.0 - ratio), REWEIGHTING.longest_guess))
        here, self.values = self.values, self.values.retract(ahead)
        if not self.energy() < energy:
            self.values = here

    def reweigh(self, progress: float, *, hold: bool = False) -> float:
        """Make the weights anew; the largest change of a keypoint's."""
        before, self.weights = self.weights, self.graph.reweigh(self.values, self.weights, progress, hold=hold)
        pairs = zip(before, self.weights, strict=True)
        return max(float(np.abs(new.keypoints - old.keypoints).max()) for old, new in pairs)

    def solve(self, tolerance: float) -> None:
        record = self.graph.options.keep_history
        graph = self.graph.build(self.weights, Form.NEWTON)
        solution = minimise(graph, self.values, relative_tolerance=tolerance, record=record)
        self.steps += [
            Step(self.update, i, partial(gtsam.Values, values), self.weights) for i, values in enumerate(solution.path)
        ]
        self.values, self.converged = solution.values, solution.converged
        self.iterations += solution.iterations
        self.update += 1

    def energy(self) -> float:
        return self.graph.energy(self.values, self.weights)
