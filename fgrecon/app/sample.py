"""The photograph that visitors can try: the street of `fgrecon sample`."""

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
from fgrecon.simulation.sample import sample_street


def sample_photograph(folder: Path) -> bytes:
    """It as PNG, made in a folder."""
    street = sample_street(load_prior("car14").for_fleet(size_prior("kitti")))
    return write_png(folder / "street.png", street.image).read_bytes()


@lru_cache(maxsize=1)
def make_page_ready() -> bool:
    """Load what the page needs by looking at the sample once, so that the first visitor does not wait for it."""
    with tempfile.TemporaryDirectory(prefix="fgrecon-") as name:
        (Path(name) / "street.png").write_bytes(sample_photograph(Path(name)))
        given = Requested(intrinsics="721.5,721.5,609.6,172.9", camera_height="1.65", size_prior="kitti")
        view_of(Path(name), Uploaded("street.png"), given)
    return True
