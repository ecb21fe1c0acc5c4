"""Commands that label images, measure and train networks, and learn priors.

They register themselves: see `fgrecon.cli.main`.
"""

from __future__ import annotations

from collections.abc import Mapping

import typer

from fgrecon.cli.commands import add_command
from fgrecon.cli.training.keypoints import evaluate_command, silhouettes_command, train_command
from fgrecon.cli.training.label import label_command
from fgrecon.cli.training.prior_build import build_command
from fgrecon.cli.training.prior_learn import learn_command
from fgrecon.cli.training.vehicles import convert_command

__all__ = ["register"]


def register(groups: Mapping[str, typer.Typer]) -> None:
    """Add the commands to the groups of `fgrecon`, by name."""
    keypoints, prior = groups["keypoints"], groups["prior"]
    add_command(keypoints, "evaluate", evaluate_command)
    add_command(keypoints, "label", label_command)
    add_command(keypoints, "silhouettes", silhouettes_command)
    add_command(keypoints, "train", train_command)
    add_command(prior, "build", build_command)
    add_command(prior, "learn", learn_command)
    add_command(groups["vehicles"], "convert", convert_command)
