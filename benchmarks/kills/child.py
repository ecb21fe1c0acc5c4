"""What is killed: a command with its work in small parts, so that many of its moments are distinct.

    python -m benchmarks.kills.child MARK batch|run|train ARGUMENT...

The file MARK is made once everything is imported: imports take longer than the work and are not what is tested.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import fgrecon.batch.parts as parts
from fgrecon.cli.main import main
from fgrecon_research.training.keypoints.labelling import Source
from research.tests.training.keypoints.support import made_up_cars, make_small, unit_car_prior

__all__ = ["made_up_source"]


def made_up_source(folder: Path) -> Source:
    """Six photographs of one shape; the same ones every time. The files are `prepare`'s."""
    from dataclasses import replace

    rng, prior = np.random.default_rng(0), unit_car_prior()
    cars = made_up_cars(prior, np.zeros(5), 6, rng, folder)
    cars = [replace(car, cad_id="ab"[i // 3]) for i, car in enumerate(cars)]
    return Source(cars, np.arange(4), np.arange(4, 6), prior)


def _run(mark: Path, arguments: list[str]) -> None:
    parts._ROWS = 1  # noqa: SLF001  # many small parts
    if arguments[0] == "train":
        import torch

        torch.set_num_threads(1)
        make_small(made_up_source(mark.parent / "photographs"), pytest.MonkeyPatch())
        arguments = ["keypoints", *arguments]
    sys.argv = ["fgrecon", *arguments]
    mark.touch()
    main()


if __name__ == "__main__":
    _run(Path(sys.argv[1]), sys.argv[2:])
