"""Options of `fgrecon run`: which frames, and how the camera moves."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

__all__ = ["FrameOptions", "MotionOptions"]


@dataclass(frozen=True)
class FrameOptions:
    """Which frames are taken, and when they were."""

    fps: Annotated[
        float | None,
        typer.Option(help="Frames per second of images without times.", show_default="10; a video's own"),
    ] = None
    every: Annotated[int, typer.Option(min=1, help="Take every so many frames.")] = 1
    start: Annotated[float, typer.Option(min=0.0, help="Begin so many seconds after the first frame.")] = 0.0
    end: Annotated[
        float | None, typer.Option(help="End so many seconds after the first frame.", show_default="the last frame")
    ] = None


@dataclass(frozen=True)
class MotionOptions:
    """How the camera moves."""

    poses: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Poses of the camera: KITTI, TUM, or JSON with matrices.")
    ] = None
    estimate_motion: Annotated[
        bool | None,
        typer.Option(
            "--estimate-motion/--no-estimate-motion",
            help="Estimate the camera's motion from the images; needs the ground.",
            show_default="where the ground is told, and not with --alone",
        ),
    ] = None
