"""The result of reconstructing one vehicle from several images: a pose for each, and one shape."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.plotting import DEFAULT_BACKEND, as_html, plotting_backend
from fgrecon.core.reconstruction import GraphFactor, Reconstruction, Status
from fgrecon.core.repr import brief_repr
from fgrecon.core.serialise import as_arrow, as_pandas
from fgrecon.core.text import counted


@dataclass(frozen=True, eq=False)
class JointStep:
    """State of the whole track after one step of the joint optimisation.

    Attributes:
        irls: Index of the weight update, from 0.
        step: Index of the solver's iteration within that update, from 0.
        poses: (T, 4, 4) pose of every frame, maps object coordinates into the camera frame.
        coefficients: (N,) shape coefficients lambda.
        energies: Energy by term over all frames, nats.
    """

    irls: int
    step: int
    poses: NDArray[np.float64]
    coefficients: NDArray[np.float64]
    energies: Mapping[str, float]

    __repr__ = brief_repr


@dataclass(frozen=True, eq=False)
class TrackReconstruction:
    """Poses of one vehicle over several images, and its one shape.

    Attributes:
        status: How it ended: `failed`, `degenerate` or `ambiguous` where a frame is, else `weak` where half of them
            are.
        message: Why, in a sentence, with how many frames are weak and the most frequent reason.
        numbers: T indices of the observations that were solved, in order.
        frames: T results, all with the same shape; energies and history hold the terms of the frame alone.
        refused: Why the other observations were refused, by index.
        energies: Energy by term over all frames, nats.
        history: Every step of the joint optimisation, in order; the last steps of the frames' histories, stage `joint`,
            are the same steps.
        graph: The factors of the joint graph, those of the keypoints of one frame as one; empty without history.
        milliseconds: Wall time by stage.
    """

    status: Status
    message: str
    numbers: tuple[int, ...]
    frames: tuple[Reconstruction, ...]
    refused: Mapping[int, str]
    energies: Mapping[str, float]
    history: Sequence[JointStep]
    graph: Sequence[GraphFactor]
    milliseconds: Mapping[str, float]

    @property
    def coefficients(self) -> NDArray[np.float64]:
        """(N,) shape coefficients lambda."""
        return self.frames[0].shape.coefficients

    @property
    def box_size(self) -> NDArray[np.float64]:
        """(3,) length, width and height, metres."""
        return self.frames[0].box_size

    def __repr__(self) -> str:
        """A few lines: how it ended, the images, the size and the time."""
        lines = [f"TrackReconstruction: {self.status.value}. {self.message}"]
        lines.append(f"  {counted(len(self.frames), 'image')} solved, {len(self.refused)} refused")
        if self.frames:
            length, width, height = self.box_size
            lines.append(f"  length {length:.2f} m, width {width:.2f} m, height {height:.2f} m")
        lines.append(f"  {counted(len(self.history), 'joint step')}, {sum(self.milliseconds.values()):.0f} ms")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        """Picture and table for a notebook."""
        return as_html(self)

    def plot(
        self, images: Sequence[NDArray[np.uint8] | str | Path] | None = None, *, backend: str = DEFAULT_BACKEND
    ) -> Any:
        """Draw the wireframe over every image that was solved.

        Args:
            images: (H, W, 3) RGB photograph, or its file, of each observation; without them there is a plain canvas.
            backend: Name under which what draws is registered (`fgrecon.core.plotting`).

        Returns:
            A `matplotlib.figure.Figure`, by the backend of fgrecon.

        Raises:
            InvalidInputError: An image is none or missing, or there is no backend of that name.
            MissingPackageError: There is no backend at all.
        """
        return plotting_backend(backend).plot_track(self, images)

    def to_rows(self, *, flat: bool = True) -> list[dict[str, Any]]:
        """A row for each image, its number as id; see `Reconstruction.to_row`."""
        return [frame.to_row(str(number), flat=flat) for number, frame in zip(self.numbers, self.frames, strict=True)]

    def to_pandas(self) -> Any:
        """A `pandas.DataFrame` with a row for each image; see `Reconstruction.to_row`.

        Raises:
            MissingPackageError: pandas is not installed.
        """
        return as_pandas(self.to_rows())

    def to_arrow(self) -> Any:
        """A `pyarrow.Table` with a row for each image, arrays as lists."""
        return as_arrow(self.to_rows(flat=False))
