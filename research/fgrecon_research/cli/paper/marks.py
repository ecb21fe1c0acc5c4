"""`fgrecon evaluate marks`: whether regions hold for keypoints that people marked."""

from __future__ import annotations

import numpy as np

from fgrecon.cli.options import JsonOption
from fgrecon.cli.outputs import check_outputs
from fgrecon.cli.terminal import Terminal
from fgrecon.core.serialise import finite
from fgrecon_research.cli.evaluate.calibration import calibration_tables
from fgrecon_research.cli.evaluate.data_options import DATA, DataOption, MarkdownOption
from fgrecon_research.evaluation.calibration import calibration_document
from fgrecon_research.evaluation.text_table import TextTable
from fgrecon_research.paper.apollocar3d import read_apollocar3d
from fgrecon_research.paper.closest_models import CLOSEST_ROWS, ClosestModelRanks, rank_models, share_within
from fgrecon_research.paper.marked_calibration import calibrate_marked
from fgrecon_research.training.priors.apollo79 import load_apollo79

_METHOD = "reconstruct"


def marks_command(terminal: Terminal, data: DataOption = DATA, json_out: JsonOption = None) -> None:
    """Compare what results from people's marks say of themselves with the known cars of ApolloCar3D.

    How exactly people mark is fitted to one half of the images (`KeypointOptions.sigma_relative`) and tested on the
    other. The prior of a car has not learnt from its model. --verbose names what could not be reconstructed.
    """
    check_outputs(json_out)
    screen = terminal.screen(json_out)
    models = load_apollo79(data)
    cars = read_apollocar3d(data / "apollocar3d_val" / "annotations.json", models)
    with screen.bar() as advance:
        found = calibrate_marked(cars, models, lambda done, total: advance("Reconstructions", done, total))
    first, second = found.sigma_relative
    screen.print(f"{len(cars.cars)} cars, {len(found.failures)} of them refused. Marks are known to")
    screen.print(f"{100 * first:.2f} % of the box by one half of the images, {100 * second:.2f} % by the other.")
    screen.print(*(table.shown() for table in calibration_tables(_METHOD, found.calibration)))
    screen.detail(*found.failures)
    given = {"method": _METHOD, "sigma_relative": list(found.sigma_relative), "refused": list(found.failures)}
    document = calibration_document(found.calibration, given)
    screen.write_document(document)


# `fgrecon evaluate models`: how often the right car model is among the closest ones.

FORMAT = "fgrecon_research.evaluation.models/1"
_FIRST = (1, 5)
_HEADS = ("models in the order of", "right one first %", "in the first 5 %", "median place")


def models_command(
    terminal: Terminal, data: DataOption = DATA, json_out: JsonOption = None, markdown: MarkdownOption = None
) -> None:
    """Say how often the right one of 79 car models is found for the cars of ApolloCar3D, solved from people's marks.

    The prior of a car has not learnt from its model. --verbose shows the place of every car's.
    """
    check_outputs(json_out, markdown)
    screen = terminal.screen(json_out)
    models = load_apollo79(data)
    cars = read_apollocar3d(data / "apollocar3d_val" / "annotations.json", models)
    with screen.bar() as advance:
        found = rank_models(cars, models, lambda done, total: advance("Cars", done, total))
    rows = _rows(found)
    note = _note(found)
    screen.print(f"{len(found.names)} cars, {found.count} models")
    table = TextTable(_HEADS, rows)
    screen.print(table.shown(), note)
    screen.detail(*(f"{name}: {place}" for name, place in zip(found.names, found.ranks["Hausdorff"], strict=True)))
    document = {
        "format": FORMAT,
        "cars": len(found.names),
        "models": found.count,
        "rows": {
            row[0]: dict(zip(("first", "first_5", "median_place"), map(float, row[1:]), strict=True)) for row in rows
        },
        "margins": {"cars": found.names, "metres": finite([round(float(m), 4) for m in found.margins])},
    }
    screen.write_document(document)
    screen.write_text(markdown, f"{len(found.names)} cars, {found.count} models.\n\n{table.markdown()}\n{note}\n")


def _rows(found: ClosestModelRanks) -> list[tuple[str, ...]]:
    return [
        (row, *(f"{found.share(row, first):.1f}" for first in _FIRST), f"{found.median(row):g}") for row in CLOSEST_ROWS
    ]


def _note(found: ClosestModelRanks) -> str:
    """What the margin to the second model shows."""
    row = CLOSEST_ROWS[-1]
    wide = found.margins >= np.nanquantile(found.margins, 2 / 3)
    limit = 100 * float(np.nanquantile(found.margins, 2 / 3))
    first, five = (share_within(found.ranks[row][wide], count) for count in _FIRST)
    return (
        f"Of the third with the largest margin to the second model ({limit:.1f} cm and more, {row}): "
        f"{first:.1f} % and {five:.1f} %."
    )
