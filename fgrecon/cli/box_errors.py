"""Options that say how far a detector's 3D boxes are off."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:  # the command line must start fast: what the commands need is imported when they run
    from fgrecon.core.box3d import BoxErrors

__all__ = ["BoxErrorOptions"]

_PANEL = "Errors of the boxes (1 sigma)"


@dataclass(frozen=True)
class BoxErrorOptions:
    """How far 3D boxes are off; the defaults are a monocular detector's."""

    depth_error: Annotated[float, typer.Option(help="Of the distance, as a share of it.", rich_help_panel=_PANEL)] = (
        0.06
    )
    bearing_error: Annotated[float, typer.Option(help="Of where a box is seen, pixels.", rich_help_panel=_PANEL)] = 2.0
    yaw_error: Annotated[
        float, typer.Option(help="Of the yaw of a box that is not turned round, degrees.", rich_help_panel=_PANEL)
    ] = 10.0
    size_error: Annotated[
        float, typer.Option(help="Of length, width and height, as a share.", rich_help_panel=_PANEL)
    ] = 0.05
    turned_share: Annotated[float, typer.Option(help="Share of boxes turned round.", rich_help_panel=_PANEL)] = 0.05

    def errors(self) -> BoxErrors:
        """They, as the solver takes them.

        Raises:
            InvalidInputError: A number is out of range.
        """
        from math import radians

        from fgrecon.core.box3d import BoxErrors

        return BoxErrors(
            self.depth_error, self.bearing_error, radians(self.yaw_error), self.size_error, self.turned_share
        )
