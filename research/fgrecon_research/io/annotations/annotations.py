"""Keypoints marked in many images, in a category's order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.category import Category
from fgrecon.core.checks import as_shape
from fgrecon.core.errors import InvalidInputError


@dataclass(frozen=True)
class Annotations:
    """The annotated keypoints of M instances."""

    category: Category  # The category whose keypoint order the arrays follow
    # (M, K, 2) pixels (u, v), pixel centres at integers; NaN where a keypoint was not marked
    keypoints: NDArray[np.float64]
    # (M,) a name for each instance, for messages: the image, and the object within it; () counts them
    names: tuple[str, ...] = ()
    # (M,) identity of the vehicle that an instance shows; None where it is not known
    vehicles: NDArray[Any] | None = None
    views: NDArray[Any] | None = None  # (M,) class of the direction from which it is seen; None where it is not known
    source: str = ""  # Where the annotations come from, in words

    def __post_init__(self) -> None:
        """Check shapes and values; a keypoint with one coordinate missing counts as not marked.

        Raises:
            InvalidInputError: Wrong shapes, or an infinite pixel; names instance and keypoint.
        """
        keypoints = as_shape("keypoints", self.keypoints, (None, self.category.size, 2))
        count = len(keypoints)
        if not self.names:
            object.__setattr__(self, "names", tuple(map(str, range(count))))
        if len(self.names) != count:
            raise InvalidInputError("names", f"{len(self.names)} names", f"Give one for each of {count} instances.")
        for field in ("vehicles", "views"):
            value = getattr(self, field)
            if value is not None and np.shape(value) != (count,):
                raise InvalidInputError(field, f"shape {np.shape(value)}", f"Give one for each of {count} instances.")
        infinite = np.argwhere(np.isinf(keypoints))
        if len(infinite):
            instance, keypoint, _ = infinite[0]
            raise InvalidInputError(
                f"{self.names[instance]}: {self.category.keypoints[keypoint]}",
                keypoints[instance, keypoint].tolist(),
                "Give finite pixels, or NaN where the keypoint was not marked.",
            )
        missing = np.asarray(np.isnan(keypoints).any(axis=2))
        object.__setattr__(self, "keypoints", np.where(missing[:, :, None], np.nan, keypoints))

    def __len__(self) -> int:
        return len(self.keypoints)

    @property
    def measured(self) -> NDArray[np.bool_]:
        """(M, K) whether a keypoint was marked."""
        return np.isfinite(self.keypoints[:, :, 0])

    def select(self, rows: Sequence[int] | NDArray[Any]) -> Annotations:
        """Some of the instances, by index or mask."""
        chosen = np.arange(len(self))[np.asarray(rows)]
        return replace(
            self,
            keypoints=self.keypoints[chosen],
            names=tuple(self.names[i] for i in chosen),
            vehicles=None if self.vehicles is None else np.asarray(self.vehicles)[chosen],
            views=None if self.views is None else np.asarray(self.views)[chosen],
        )


def spread(annotations: Annotations, count: int, rng: np.random.Generator, *, min_visible: int = 8) -> NDArray[np.intp]:
    """Indices of `count` instances spread evenly over views and vehicles, as far as these are known.

    The views take turns; each turn takes, of the view's instances in random order, one whose vehicle was taken least
    often so far.

    Args:
        rng: Source of the random order.

    Returns:
        (count,) indices, ascending.

    Raises:
        InvalidInputError: There are fewer instances with enough marked keypoints.
    """
    candidates = np.flatnonzero(annotations.measured.sum(axis=1) >= min_visible)
    if not 1 <= count <= len(candidates):
        fix = f"Give 1 to {len(candidates)}, the number of instances with at least {min_visible} marked keypoints."
        raise InvalidInputError("count", count, fix)
    order = rng.permutation(candidates)
    vehicles = np.arange(len(annotations)) if annotations.vehicles is None else np.asarray(annotations.vehicles)
    views = np.zeros(len(annotations)) if annotations.views is None else np.asarray(annotations.views)
    vehicle = np.unique(vehicles, return_inverse=True)[1]
    taken = np.zeros(vehicle.max() + 1, dtype=np.int64)
    waiting = [list(order[views[order] == view]) for view in np.unique(views[order])]
    chosen: list[int] = []
    while len(chosen) < count:
        for queue in waiting:
            if queue and len(chosen) < count:
                place = int(np.argmin(taken[vehicle[queue]]))
                taken[vehicle[queue[place]]] += 1
                chosen.append(int(queue.pop(place)))
    return np.sort(np.array(chosen, dtype=np.intp))
