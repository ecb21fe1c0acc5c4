#!/usr/bin/env python3
"""Position, heading and shape of the cars in one image, by a factor graph, with every step of the optimisation."""

from __future__ import annotations

import argparse

import rerun as rr

import fgrecon
from fgrecon.simulation.sample import GROUND, sample_street
from fgrecon.viz import SolvedVehicle, scene_recording_of

DESCRIPTION = """
# Vehicles from a single image
Keypoints of three cars of a street, as a network finds them: with errors, some hidden, some in a wrong place. A factor
graph solved with [GTSAM](https://gtsam.org) gives where each car stands, how it is turned and what its shape is, and
how sure that is. Move along the timeline `step` to see the wireframes come to the cars, and the keypoints that are
wrong lose their weight.
"""


def main() -> None:
    """Simulate a street, reconstruct its cars, and show how."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0, help="Of the street.")
    rr.script_add_args(parser)
    arguments = parser.parse_args()

    street = sample_street(fgrecon.load_prior("car14"), arguments.seed)
    options = fgrecon.Options(keep_history=True)
    sights = []
    for number, car in enumerate(street.cars, start=1):
        seen = car.observation
        result = fgrecon.reconstruct(
            seen.keypoints, street.camera, confidence=seen.confidence, box=seen.box, ground=GROUND, options=options
        )
        sights.append(SolvedVehicle(result, seen, street.camera, street.image, title=f"car {number}"))
    recording = scene_recording_of(sights, ground=GROUND)

    rr.script_setup(arguments, "rerun_example_vehicle_reconstruction", default_blueprint=recording.layout())
    rr.log("description", rr.TextDocument(DESCRIPTION, media_type=rr.MediaType.MARKDOWN), static=True)
    recording.make()(rr.get_global_data_recording())
    rr.script_teardown(arguments)


if __name__ == "__main__":
    main()
