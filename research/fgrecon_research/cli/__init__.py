"""The commands of this package; they register themselves with fgrecon's command line (`fgrecon.cli.main`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import typer

from fgrecon.cli.commands import add_command
from fgrecon_research.cli.evaluate.boxes import boxes_command
from fgrecon_research.cli.evaluate.calibration import calibration_command
from fgrecon_research.cli.evaluate.kitti import kitti_command
from fgrecon_research.cli.evaluate.refine import refine_evaluation_command
from fgrecon_research.cli.evaluate.tracks import tracks_command
from fgrecon_research.cli.evaluate.video import video_command
from fgrecon_research.cli.paper.icra2017 import icra2017_command
from fgrecon_research.cli.paper.marks import marks_command, models_command
from fgrecon_research.cli.paper.paper import paper_command
from fgrecon_research.cli.paper.shape import shape_command
from fgrecon_research.cli.training.class_sizes import sizes_command
from fgrecon_research.cli.training.keypoints import evaluate_command, silhouettes_command, train_command
from fgrecon_research.cli.training.label import label_command
from fgrecon_research.cli.training.prior_build import build_command, compare_command
from fgrecon_research.cli.training.prior_learn import learn_command
from fgrecon_research.cli.training.vehicles import convert_command

__all__ = ["COMMANDS", "register"]

COMMANDS: Mapping[str, Mapping[str, Callable[..., None]]] = {
    "evaluate": {
        "tracks": tracks_command,
        "kitti": kitti_command,
        "video": video_command,
        "boxes": boxes_command,
        "refine": refine_evaluation_command,
        "calibration": calibration_command,
        "icra2017": icra2017_command,
        "marks": marks_command,
        "models": models_command,
        "paper": paper_command,
        "shape": shape_command,
    },
    "keypoints": {
        "evaluate": evaluate_command,
        "label": label_command,
        "silhouettes": silhouettes_command,
        "train": train_command,
    },
    "prior": {"build": build_command, "compare": compare_command, "learn": learn_command, "sizes": sizes_command},
    "vehicles": {"convert": convert_command},
}
"""Each command, by its group and name."""


def register(groups: Mapping[str, typer.Typer]) -> None:
    """Add the commands to the groups of `fgrecon`, by name."""
    for group, commands in COMMANDS.items():
        for name, command in commands.items():
            add_command(groups[group], name, command)
