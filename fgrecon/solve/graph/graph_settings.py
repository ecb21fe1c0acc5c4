"""Settings of the graph's optimisation, in one place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class NewtonSettings:
    """Of Newton's method, for the mixture (`fgrecon.solve.graph.newton`). Where nothing else is said, not tuned."""

    steady: float = 1e-6
    """A step is the last if the next will move no variable by more (radians, metres, standard deviations of lambda): a
    micrometre, at two thirds of the iterations that 1e-8 needs."""
    followed_iterations: int = 25
    """For which visibility follows the pose."""
    held_iterations: int = 30
    """At most, after that, with visibility held."""
    watched_iterations: int = 6
    """From which on the visibility of an image among others may not change more than two iterations before."""
    least_swing: float = 1e-4
    """A change of visibility by less is none."""
    shortened_step: float = 0.3
    """Share of a plain step that goes up."""
    longest_step: float = 20.0
    """Times the plain step that an accelerated one may go."""
    negligible_rise: float = 1e-10
    """Relative rise of the energy that is none: near the end it is too coarse to judge a step by."""
    final_relative_decrease: float = 1e-12
    """At which Levenberg-Marquardt ends."""
    vain_steps: int = 2
    """Damped steps in a row that gain a negligible energy are the last: hardly anything says where to."""
    remembered_steps: int = 4
    """That Anderson's acceleration learns from; the compiled kernel takes so many at most."""
    acceleration_ridge: float = 1e-10
    """Share of the normal equations' diagonal: of several changes that are nearly one any mixture will do."""


@dataclass(frozen=True)
class ReweightingSettings:
    """Of iteratively re-weighted least squares, for other strategies (`fgrecon.solve.graph.optimise`); not tuned."""

    settled_weight_change: float = 1e-4
    """Weights that change by less have settled."""
    early_relative_decrease: float = 1e-4
    """At which a solve ends whose weights are about to change."""
    final_relative_decrease: float = 1e-13
    """The same for the last solves."""
    still: float = 1e-7
    """A solve that moves no variable by more (radians, metres, standard deviations of lambda) ends at the minimum."""
    refreshed_updates: int = 4
    """Times the strategy's updates: how often visibility is made anew at most."""
    held_updates: int = 60
    """At most, with visibility held."""
    most_iterations: int = 500
    """Of the solver, over all updates: cars take up to 200, what takes more does not end."""
    longest_guess: float = 20.0
    """Steps that a guess may go ahead."""
    drift_nats: float = 0.1
    """That settled weights may cost: what moves visibility is no force of the solver's."""


@dataclass(frozen=True)
class GraphSettings:
    """Of the graph: which proposals are refined, what decides between them, and when a solve ends.

    Where nothing else is said a number was not tuned.
    """

    proposal_gap_nats: float = 12.0
    """A proposal that is worse by more is not refined: refinement changes differences by 3 nats at most."""
    restart_below_weight: float = 4.0
    """Keypoints' weight: a pose has six unknowns, which leaves two equations for the shape."""
    restart_below_weight_of_some: float = 7.0
    """The same where less than `many_measured_share` were measured: fewer could contradict the pose."""
    many_measured_share: float = 0.75
    """Share of the keypoints."""
    restart_least_right: float = 0.3
    """Keypoints that the detector believes right, in all: with less there is nothing to find."""
    most_restarts: int = 3
    """Searches from there, each from a better pose than the one before."""
    better_by_nats: float = 0.5
    """What is lower by less is no other result."""
    mode_rounds: int = 3
    """Of images that change over to another mode."""
    image_evidence_nats: float = 5.0
    """That one image can say for a mode: in 0.7 % of the images all keypoints are of another one."""
    turn_sigma_radians: float = float(np.deg2rad(10.0))
    """From one image of a sequence to the next."""
    most_turn_nats: float = 30.0
    """That a turn costs at most."""
    first_damping: float = 1e-5
    """Levenberg-Marquardt's."""
    negligible_gain_nats: float = 1e-3
    """That an iteration gains: too few to tell one shape from another."""
    absolute_decrease_nats: float = 1e-12
    """At which Levenberg-Marquardt ends whatever the energy."""
    undetermined_share: float = 1e-12
    """Share of a vehicle's largest information below which a direction has none."""
    newton: NewtonSettings = NewtonSettings()
    """Of Newton's method."""
    reweighting: ReweightingSettings = ReweightingSettings()
    """Of iteratively re-weighted least squares."""


SETTINGS = GraphSettings()
"""What the graph reads."""
