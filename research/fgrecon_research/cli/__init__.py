"""The commands of this package; they register themselves with fgrecon's command line (`fgrecon.cli.main`).

They are imported when they are looked up, with all that they need.
"""

from __future__ import annotations

from collections.abc import Mapping

import typer

from fgrecon.cli.commands import add_later

COMMANDS: Mapping[str, Mapping[str, str]] = {
    "evaluate": {
        "tracks": "evaluate.tracks:tracks_command",
        "kitti": "evaluate.kitti:kitti_command",
        "video": "evaluate.video:video_command",
        "boxes": "evaluate.boxes:boxes_command",
        "refine": "evaluate.refine:refine_evaluation_command",
        "calibration": "evaluate.calibration:calibration_command",
        "icra2017": "paper.icra2017:icra2017_command",
        "marks": "paper.marks:marks_command",
        "models": "paper.marks:models_command",
        "paper": "paper.paper:paper_command",
        "shape": "paper.shape:shape_command",
    },
    "keypoints": {
        "evaluate": "training.keypoints:evaluate_command",
        "label": "training.label:label_command",
        "silhouettes": "training.keypoints:silhouettes_command",
        "train": "training.keypoints:train_command",
    },
    "prior": {
        "build": "training.prior_build:build_command",
        "compare": "training.prior_build:compare_command",
        "learn": "training.prior_learn:learn_command",
        "sizes": "training.prior_build:sizes_command",
    },
    "vehicles": {"convert": "training.vehicles:convert_command"},
}
"""Where each command is in this package, by its group and name."""


def register(groups: Mapping[str, typer.Typer]) -> None:
    """Add the commands to the groups of `fgrecon`, by name."""
    for group, commands in COMMANDS.items():
        for name, place in commands.items():
            add_later(groups[group], name, f"{__name__}.{place}")
