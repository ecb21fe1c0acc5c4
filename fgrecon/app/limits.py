"""Limits of a service: request size, time, and length of the queue."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """Limits of a service; how many pixels an image may have is the readers' own limit (`fgrecon.io.arrays`)."""

    upload_bytes: int = 32 << 20  # of an image, a keypoint file or a calibration
    video_bytes: int = 512 << 20
    upload_seconds: float = 60.0  # in which an upload must have arrived
    solve_seconds: float = 60.0  # after which work on an image or a keypoint file is given up
    video_seconds: float = 1800.0  # the same of a video
    waiting: int = 64  # requests that may wait for a worker; more are refused


LIMITS = Limits()
"""Those that a service has if nothing else is said: not tuned."""
