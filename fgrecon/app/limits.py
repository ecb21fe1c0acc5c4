"""What a service takes: how much at once, how long, and how much waits."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """Limits of a service; how many pixels an image may have is the readers' own limit (`fgrecon.io.arrays`).

    Attributes:
        upload_bytes: Of an image, a keypoint file or a calibration.
        video_bytes: Of a video.
        upload_seconds: In which an upload must have arrived.
        solve_seconds: After which work on an image or a keypoint file is given up.
        video_seconds: The same of a video.
        waiting: Requests that may wait for a worker; more are refused.
    """

    upload_bytes: int = 32 << 20
    video_bytes: int = 512 << 20
    upload_seconds: float = 60.0
    solve_seconds: float = 60.0
    video_seconds: float = 1800.0
    waiting: int = 64


LIMITS = Limits()
"""Those that a service has if nothing else is said: not tuned."""
