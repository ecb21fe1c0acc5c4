"""Figures that show themselves in a notebook. Importing this imports matplotlib, so it is imported on use."""

from __future__ import annotations

import io
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

_WIDEST = 1200.0  # pixels in a notebook


class Drawing(Figure):
    """A figure with an Agg canvas of its own.

    Notebooks show matplotlib's figures where pyplot was imported; this one they show without it.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        FigureCanvasAgg(self)

    def _repr_png_(self) -> bytes:
        """What a notebook shows."""
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=min(self.dpi, _WIDEST / self.get_size_inches()[0]))
        return buffer.getvalue()
