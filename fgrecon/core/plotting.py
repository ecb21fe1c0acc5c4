"""Plotting backends of results, found by entry point, as pandas does it.

What computes knows nothing of drawing. fgrecon's own backend is `fgrecon.viz.notebook`, registered in `pyproject.toml`:

    [project.entry-points."fgrecon.plotting"]
    matplotlib = "fgrecon.viz.notebook"

Another package registers another module under another name, and is chosen by `result.plot(backend="name")`.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any, Protocol, cast

from fgrecon.core.errors import InvalidInputError, MissingPackageError

GROUP = "fgrecon.plotting"
"""Group of the entry points."""

DEFAULT_BACKEND = "matplotlib"


class PlottingBackend(Protocol):
    """What a module that draws results has."""

    def plot(self, result: Any, image: Any = None, *, observation: Any = None) -> Any:
        """A figure of a `Reconstruction`; see `Reconstruction.plot`."""

    def plot_track(self, track: Any, images: Sequence[Any] | None = None) -> Any:
        """A figure of a `TrackReconstruction`; see `TrackReconstruction.plot`."""

    def html(self, result: Any) -> str:
        """HTML of either for a notebook."""


def plotting_backend(name: str = DEFAULT_BACKEND) -> PlottingBackend:
    """The backend of a name.

    Raises:
        InvalidInputError: Only others are installed.
        MissingPackageError: None is installed.
    """
    from importlib import metadata  # on use: results alone need it not

    found = {point.name: point for point in metadata.entry_points(group=GROUP)}
    if not found:
        purpose = f"Drawing a result (no backend is registered under the entry points {GROUP})"
        raise MissingPackageError("fgrecon", purpose)
    if name not in found:
        raise InvalidInputError("backend", name, f"Use one of {', '.join(sorted(found))}.")
    return cast("PlottingBackend", found[name].load())


def as_html(result: object) -> str:
    """A result for a notebook: as the backend shows it; as text where there is none, since showing must not fail."""
    try:
        backend = plotting_backend()
    except (InvalidInputError, MissingPackageError):
        return f"<pre>{escape(repr(result))}</pre>"
    return backend.html(result)
