"""Samples for visitors: photograph and video of `fgrecon sample`."""

from __future__ import annotations

import tempfile
from functools import lru_cache
from pathlib import Path

from fgrecon.app.requested import Requested
from fgrecon.app.solving import Uploaded
from fgrecon.app.view import view_of
from fgrecon.core.size_prior import size_prior
from fgrecon.io.catalogue import load_prior
from fgrecon.io.images import write_png
from fgrecon.io.video_frames import write_video
from fgrecon.simulation.sample import sample_drive, sample_street

GIVEN = Requested(intrinsics="721.5,721.5,609.6,172.9", camera_height="1.65", size_prior="kitti")
"""What is known of them."""

_RATE = 10.0  # frames per second


def sample_photograph(folder: Path) -> bytes:
    """It as PNG, made in a folder."""
    street = sample_street(load_prior("car14").for_fleet(size_prior("kitti")))
    return write_png(folder / "street.png", street.image).read_bytes()


def sample_video(folder: Path) -> bytes:
    """A car that passes a standing camera, as MP4, made in a folder."""
    prior = load_prior("car14").for_fleet(size_prior("kitti"))
    with write_video(path := folder / "street.mp4", rate=_RATE) as add:
        for street in sample_drive(prior):
            add(street.image, None)
    return path.read_bytes()


@lru_cache(maxsize=1)
def make_page_ready() -> bool:
    """Load what the page needs by looking at the sample once, so that the first visitor does not wait for it."""
    with tempfile.TemporaryDirectory(prefix="fgrecon-") as name:
        (Path(name) / "street.png").write_bytes(sample_photograph(Path(name)))
        view_of(Path(name), Uploaded("street.png"), GIVEN)
    return True
