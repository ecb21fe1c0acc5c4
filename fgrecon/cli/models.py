"""The options of `fgrecon reconstruct` that find the closest car model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:  # the command line must start fast: what the command needs is imported when it runs
    from fgrecon.cli.reconstruct_work import Outcome
    from fgrecon.core.category import Category
    from fgrecon.core.vehicle_mesh import VehicleMesh

__all__ = ["CarModels", "with_closest"]

_PANEL = "Car models"


@dataclass(frozen=True)
class CarModels:
    """The models that vehicles are compared with."""

    models: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER|FILE",
            help="Find the closest of these car models (obj, ply, glb, npz), in metres; it is drawn as well.",
            rich_help_panel=_PANEL,
        ),
    ] = None
    models_axes: Annotated[
        str | None,
        typer.Option(
            metavar="FORWARD,UP",
            help="What points forward and up in meshes, such as x,z.",
            show_default="x,-y; z,y in glb",
            rich_help_panel=_PANEL,
        ),
    ] = None

    def read(self, category: Category) -> list[VehicleMesh]:
        """The models; none where none are asked for.

        Raises:
            InvalidInputError: A file cannot be used, or axes are given but no models.
        """
        from fgrecon.core.errors import InvalidInputError
        from fgrecon.io.models import read_models

        if self.models is None:
            if self.models_axes is not None:
                raise InvalidInputError("models_axes", "without --models", "Say with --models where the models are.")
            return []
        return read_models(self.models, category, self.models_axes)


def with_closest(outcomes: Sequence[Outcome], models: Sequence[VehicleMesh]) -> list[Outcome]:
    """The outcomes, those with a pose and, where there are any models, with the closest of these.

    Raises:
        InvalidInputError: The models cannot be compared with the vehicles.
    """
    import numpy as np

    from fgrecon.core.vehicle_mesh import closest_model

    return [
        replace(outcome, closest=closest_model(outcome.result, models))
        if models and outcome.result is not None and np.isfinite(outcome.result.wireframe).all()
        else outcome
        for outcome in outcomes
    ]
