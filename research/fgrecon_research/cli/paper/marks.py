"""`fgrecon evaluate marks`: whether regions hold for keypoints that people marked."""

from __future__ import annotations

import json

from fgrecon.cli.options import JsonOption
from fgrecon.cli.outputs import check_outputs
from fgrecon.cli.terminal import Terminal
from fgrecon_research.cli.evaluate.calibration import calibration_tables
from fgrecon_research.cli.evaluate.data_options import DATA, DataOption

_METHOD = "reconstruct"


def marks_command(terminal: Terminal, data: DataOption = DATA, json_out: JsonOption = None) -> None:
    """Compare what results from people's marks say of themselves with the known cars of ApolloCar3D.

    How exactly people mark is fitted to one half of the images (`KeypointOptions.sigma_relative`) and tested on the
    other. The prior of a car has not learnt from its model. --verbose names what could not be reconstructed.
    """
    from fgrecon_research.evaluation.calibration import calibration_document
    from fgrecon_research.paper.apollocar3d import read_apollocar3d
    from fgrecon_research.paper.marked_calibration import calibrate_marked
    from fgrecon_research.training.priors.apollo79 import load_apollo79

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
    screen.write_json(json.dumps(document, indent=1, allow_nan=False) + "\n")
