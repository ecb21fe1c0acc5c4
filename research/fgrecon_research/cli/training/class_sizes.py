"""`fgrecon prior sizes`: the shipped sizes of classes of vehicles, made again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from fgrecon.cli.options import DrivesArgument
from fgrecon.cli.terminal import Terminal
from fgrecon.io.files import check_output, write_text
from fgrecon_research.annotation.class_sizes import class_file


def sizes_command(
    drives: DrivesArgument,
    terminal: Terminal,
    labels: Annotated[Path, typer.Option(metavar="FOLDER", help="Label files of KITTI's object set (label_2).")],
    out: Annotated[Path, typer.Option(metavar="FILE", help="The JSON file to write.")] = Path("kitti.json"),
) -> None:
    """Measure sizes of cars, vans, lorries and trams by KITTI's labels, and count what the vehicle detector calls them.

    The drives are those with labels in which each vehicle is counted once. --verbose shows how often each
    class is among all labels.
    """
    screen = terminal.screen()
    check_output(out)
    content = class_file(labels, drives)
    for name, one in content["classes"].items():
        length, width, height = one["mean"]
        screen.print(f"{name}: {one['count']} labels, {length:.2f} x {width:.2f} x {height:.2f} m")
        screen.detail(f"{name}: {100.0 * one['share']:.1f} % of all")
    screen.wrote(write_text(out, json.dumps(content, indent=1) + "\n"))
