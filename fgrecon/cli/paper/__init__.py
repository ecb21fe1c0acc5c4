"""Commands that reproduce the paper's tables. They register themselves: see `fgrecon.cli.main`."""

from __future__ import annotations

from collections.abc import Mapping

import typer

from fgrecon.cli.commands import add_command
from fgrecon.cli.paper.icra2017 import icra2017_command
from fgrecon.cli.paper.marks import marks_command
from fgrecon.cli.paper.models import models_command
from fgrecon.cli.paper.paper import paper_command
from fgrecon.cli.paper.shape import shape_command

__all__ = ["register"]


def register(groups: Mapping[str, typer.Typer]) -> None:
    """Add the commands to the groups of `fgrecon`, by name."""
    evaluate = groups["evaluate"]
    add_command(evaluate, "icra2017", icra2017_command)
    add_command(evaluate, "marks", marks_command)
    add_command(evaluate, "models", models_command)
    add_command(evaluate, "paper", paper_command)
    add_command(evaluate, "shape", shape_command)
