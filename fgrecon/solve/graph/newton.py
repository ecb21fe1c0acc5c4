"""Newton's method on a graph whose robust losses are inside its factors: one loop, for one image as for a track.

An iteration looks what each pose lets the camera see, linearises the factors there (`factors.mixture.Form.NEWTON`) and
solves. What such a step neglects (the curvature of outline and projection, that visibility follows the pose) makes the
steps shrink by a factor of 0.1 to 0.5 from one to the next; Anderson's acceleration learns that from the last steps and
takes the iteration to where they would lead: ten iterations where forty of re-weighting were needed.

A step that does not lower the energy, visibility held, is given up for the plain one. Where that leads up as well, the
energy bends more than the factors say: a car observed square on is on a crease of its outline, the loss of a keypoint
that is mostly wrong bends the other way. From there on the steps are those of a parabola that lies above the energy
(`Form.MAJORISED`), accelerated likewise, and where these fail a damped one of Levenberg-Marquardt's.

Visibility is no force of the solver's and can swing between two views of a car for ever: where the steps have not ended
after `followed_iterations` of them, it is held at the best state and the iteration goes on from there. Of many images
one may swing and keep all from ending: it is held as soon as it is observed to, and its pose goes alone to where that
leads, which is a long way if it is across a plateau.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import gtsam
import numpy as np

from factors.mixture import Form
from factors.system import Point
from fgrecon.core.arrays import Array
from fgrecon.core.errors import DegenerateProblemError, FactorCallbackError
from fgrecon.solve.graph.anderson import Anderson
from fgrecon.solve.graph.graph import Graph, State
from fgrecon.solve.graph.graph_settings import SETTINGS
from fgrecon.solve.graph.observation_part import Weights
from fgrecon.solve.graph.solver import minimise

NEWTON = SETTINGS.newton


@dataclass(frozen=True)
class Step:
    """One step of the loop."""

    update: int  # index of the weight update
    step: int  # index of the solver's iteration within it
    ended: Callable[[], gtsam.Values]  # makes `values`
    weights: Sequence[Weights]  # weights that it was made under; Newton's method has those of where it ended

    @property
    def values(self) -> gtsam.Values:
        """Where it ended, made anew each time."""
        return self.ended()


class Descent:
    """The loop's variables: values and weights, and what it has done.

    Attributes:
        weights: Weights and visibility of each observation where it is.
        steps: Every iteration, where the history is kept.
        iterations: How many were made.
        converged: Whether the last step was steady, or where steps leap over a crease of the energy, gained nothing.
    """

    def __init__(self, graph: Graph, start: State, most: int | None = None, steady: float | None = None) -> None:
        """Begin at a state of a graph that `is_robust`; `most` and `steady` are as `optimise` has them."""
        self.most = most
        self.graph = graph
        self._values: gtsam.Values | None = None
        self._point: Point = None
        self.values = graph.values(start)
        self.weights: list[Weights] = list(start.weights)
        self.steps: list[Step] = []
        self.iterations = 0
        self._first: Callable[[], dict[str, float]] = dict
        self.converged = False
        self._lengths = (np.inf, np.inf)  # of the last two steps
        self._damping = SETTINGS.first_damping
        self._form = Form.NEWTON
        self._still = False  # whether the last damped step moved nothing
        self._in_vain = 0  # damped steps, one after the other, that gained a negligible energy
        self._swinging = _Swinging(len(start.weights))
        self._shared = not start.others.empty() or bool(graph.shared.known)
        self._steady = NEWTON.steady if steady is None else steady

    @property
    def point(self) -> Point:
        """Where it is, as the graph's system has it."""
        return self._point

    @property
    def values(self) -> gtsam.Values:
        """Where it is."""
        if self._values is None:
            self._values = self._system.values(self._point)
        return self._values

    @values.setter
    def values(self, values: gtsam.Values) -> None:
        self._system = self.graph.system(values)
        self._values = values
        self._point = self._system.point(values)

    def _go(self, point: Point) -> None:
        """Go to a point of the graph's system; its values are made when they are asked for."""
        self._point, self._values = point, None

    def run(self) -> None:
        """Go to a minimum.

        Raises:
            DegenerateProblemError: The start has an infinite energy, or Levenberg-Marquardt gives up.
        """
        self.weights = self.graph.reweigh_at(self._point, self.weights)
        if self.most is None:
            self._first = self.graph.read_energies(self.values, self.weights)
        states = [(self._point, self.weights)]
        steps = Anderson()
        for iteration in range(NEWTON.followed_iterations):
            self.converged = self._iterate(steps)
            before = self.weights
            self.weights = self.graph.reweigh_at(self._point, before, held=self._swinging.held)
            if swinging := self._swinging.watch(before, self.weights):
                self._settle_apart(swinging)
                steps.forget()
            self._record()
            if self.converged or self.iterations == self.most:
                return
            if iteration >= NEWTON.followed_iterations // 2:
                states.append((self._point, self.weights))  # most end before their energies are asked for
        energies = [self.first]
        for point, self.weights in states[1:]:
            self._go(point)
            energies.append(self.graph.energy(self.values, self.weights))
        point, self.weights = states[energies.index(min(energies))]
        self._go(point)
        self._settle()

    def _settle(self) -> None:
        """Go to a minimum with visibility held."""
        steps = Anderson()
        for _ in range(NEWTON.held_iterations):
            self.converged = self._iterate(steps)
            self.weights = self.graph.reweigh_at(self._point, self.weights, hold=True)
            self._record()
            if self.converged:
                return
        # Steps that lead to and fro: down to where they gain nothing.
        built = self.graph.build(self.weights, self._form)
        solution = minimise(built, self.values, relative_tolerance=NEWTON.final_relative_decrease)
        self.values, self.converged = solution.values, solution.converged
        self.weights = self.graph.reweigh_at(self._point, self.weights, hold=True)
        self._record()

    def _settle_apart(self, images: Collection[int]) -> None:
        """Bring the poses of images to where they come to rest with everything else held.

        Where a ground or a camera is a variable it is as much theirs, and they go with it.
        """
        if self._shared:
            return
        values = gtsam.Values(self.values)  # those until now are in the history
        for index in images:
            loop = Descent(*self.graph.alone(index, values, self.weights))
            try:
                loop._settle()
            except DegenerateProblemError:  # not alone, then
                continue
            values.update(loop.values)
            self.weights[index] = loop.weights[0]
        self.values = values

    @property
    def first(self) -> float:
        """Energy at the start, nats."""
        return sum(self._first().values())

    def _record(self) -> None:
        if self.graph.options.keep_history:
            self.steps.append(Step(self.iterations, 0, partial(self._system.values, self._point), self.weights))
        self.iterations += 1

    def _iterate(self, steps: Anderson) -> bool:
        """One step; whether it was the last."""
        last = self._step(steps)
        if last is None and self._form is Form.NEWTON:
            self._form, self._lengths = Form.MAJORISED, (np.inf, np.inf)
            steps.forget()
            last = self._step(steps)
        return self._damped(steps) if last is None else last

    def _step(self, steps: Anderson) -> bool | None:
        """A step that does not raise the energy, and whether it was the last; None where there is none."""
        try:
            step, energy_here = self.graph.step(self._point, self.weights, self._form)
        except FactorCallbackError:
            raise
        except RuntimeError:  # the only sign of a direction that nothing determines
            return None
        length = float(np.abs(step).max(initial=0.0))
        last = self._is_last(length)
        # So near the end nobody asks what it does to the energy.
        unseen = last and self._steady <= NEWTON.steady
        rise = NEWTON.negligible_rise
        energy = np.inf if unseen else energy_here() * (1.0 + rise) + rise
        further = steps.propose(step)
        if further is not None and np.abs(further).max() > NEWTON.longest_step * length:
            further = None
        for proposed in self._tries(step, further):
            moved = self._system.moved(self._point, proposed)
            if unseen or self.graph.error(moved) <= energy:
                steps.took(proposed)
                self._go(moved)
                self._still = False
                return last
        return None

    def _tries(self, step: Array, further: Array | None) -> Iterator[Array]:
        """Steps in the order in which they are tried: an accelerated one, the plain one, a shorter one."""
        if further is not None:
            yield further
        yield step
        if self._form is Form.MAJORISED:
            yield NEWTON.shortened_step * step

    def _is_last(self, length: float) -> bool:
        """Whether the step after one of this length will be steady, as the slower of the last two rates foretells."""
        earlier, before = self._lengths
        self._lengths = before, length
        rate = max(before / earlier, length / before) if 0.0 < before < earlier < np.inf else 1.0
        return min(rate, 1.0) * length <= self._steady

    def _damped(self, steps: Anderson) -> bool:
        """One step of Levenberg-Marquardt's instead; whether it was the last: those before moved or gained nothing."""
        steps.forget()
        built = self.graph.build(self.weights, self._form)
        solution = minimise(built, self.values, max_iterations=1, damping=self._damping)
        gained = built.error(self.values) - solution.error
        self._in_vain = self._in_vain + 1 if gained <= SETTINGS.negligible_gain_nats else 0
        moved = self.values.localCoordinates(solution.values).vector()
        before, self._still = self._still, float(np.abs(moved).max(initial=0.0)) <= self._steady
        self.values = solution.values
        first = SETTINGS.first_damping  # too much of it keeps all still
        self._damping = first if self._still else max(solution.damping, first)
        return (before and self._still) or self._in_vain >= NEWTON.vain_steps


class _Swinging:
    """Which of several images' visibilities swing, by how much each changed in the last iterations."""

    def __init__(self, images: int) -> None:
        self.held: set[int] = set()
        self._several = images > 1
        most = max(NEWTON.watched_iterations + 1, 3)
        self._passed: deque[tuple[Sequence[Weights], Sequence[Weights]]] = deque(maxlen=most)  # weights before, after

    def watch(self, before: Sequence[Weights], after: Sequence[Weights]) -> set[int]:
        """Take note of an iteration; the images that now swing."""
        if not self._several:
            return set()
        self._passed.append((before, after))
        if len(self._passed) <= (2 if self.held else NEWTON.watched_iterations):
            return set()
        now, earlier = (_changes(*self._passed[back]) for back in (-1, -3))
        worst = np.maximum(NEWTON.least_swing, 0.5 * now.max())  # the others may change because of those
        swinging = set(np.flatnonzero((now > worst) & (now >= earlier)).tolist())
        if swinging:
            self.held |= swinging
            self._passed.clear()  # what the others did was its doing too
        return swinging


def _changes(before: Sequence[Weights], after: Sequence[Weights]) -> Array:
    """(N,) how much the visibility of each image changed at most."""
    visibilities = [np.array([one.visibility for one in some]) for some in (before, after)]
    changes: Array = np.abs(visibilities[1] - visibilities[0]).max(axis=1)
    return changes
