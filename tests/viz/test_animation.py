"""Animations have one picture per step, move, and are whole or absent."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.viz import SolvedVehicle, animate
from tests.results import changed
from tests.viz.made_up import Example


@pytest.fixture(scope="module")
def short(example: Example) -> Example:
    history = example.reconstruction.diagnostics.history
    return replace(
        example, reconstruction=changed(example.reconstruction, history=(history[0], history[3], history[-1]))
    )


def sight_of(example: Example, **given) -> SolvedVehicle:
    return SolvedVehicle(example.reconstruction, example.observation, example.camera, **given)


def test_gif_has_a_picture_per_step(short: Example, tmp_path) -> None:
    from PIL import Image

    path = animate(tmp_path / "a.gif", sight_of(short, image=short.image, truth=short.truth))
    with Image.open(path) as animation:
        assert animation.n_frames == 3
        pictures, durations = [], []
        for frame in range(3):
            animation.seek(frame)
            pictures.append(np.asarray(animation.convert("RGB"), dtype=int))
            durations.append(animation.info["duration"])
    assert all(np.abs(a - b).mean() > 0.1 for a, b in pairwise(pictures))
    assert durations[-1] > 2 * durations[0] > 4 * durations[1]


def test_mp4_has_the_steps_and_holds_the_result(short: Example, tmp_path) -> None:
    import cv2

    video = cv2.VideoCapture(str(animate(tmp_path / "a.mp4", sight_of(short))))
    frames = []
    while True:
        more, frame = video.read()
        if not more:
            break
        frames.append(frame.astype(int))
    assert len(frames) == 4 + 3 + 12
    assert np.abs(frames[0] - frames[3]).mean() < 1.0
    assert np.abs(frames[0] - frames[6]).mean() > 0.1
    assert np.abs(frames[7] - frames[-1]).mean() < 1.0


@pytest.mark.parametrize("name", ["a.png", "a"])
def test_other_endings_are_refused(short: Example, tmp_path, name: str) -> None:
    with pytest.raises(InvalidInputError, match="gif, mp4"):
        animate(tmp_path / name, sight_of(short))


def test_without_a_history_there_is_nothing_to_animate(short: Example, tmp_path) -> None:
    still = replace(sight_of(short), reconstruction=changed(short.reconstruction, history=()))
    with pytest.raises(InvalidInputError, match="keep_history"):
        animate(tmp_path / "a.gif", still)
    assert not list(tmp_path.iterdir())
