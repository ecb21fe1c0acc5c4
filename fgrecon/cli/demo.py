"""`fgrecon demo`: a simulated scene with known truth, reconstructed and drawn. Needs no data."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from fgrecon.cli.options import JsonOption, Viewer
from fgrecon.cli.outputs import check_outputs
from fgrecon.cli.terminal import Verbosity

DEMO_SEED = 2
"""Chosen among 0 to 9: all cars of its two scenes end nearer to the truth than they start. Of 210 cars of 70 streets
81 % do; the others start near it by chance. All errors of distance are within two standard deviations."""

_DPI = 300  # of the street's picture, for a page on a screen


def demo_command(
    viewer: Viewer,
    terminal: Verbosity,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="For the results; made where it does not exist.")] = Path(
        "demo"
    ),
    seed: Annotated[int, typer.Option(min=0, help="Of car, pose, keypoints and scenery.")] = DEMO_SEED,
    animation: Annotated[Path | None, typer.Option(metavar="FILE", help="Animate the optimisation (gif, mp4).")] = None,
    json_out: JsonOption = None,
) -> None:
    """Render a car, perturb and hide its keypoints, reconstruct it, and compare with the truth.

    Writes picture.png, recording.rrd for the rerun viewer and result.json, and what went in: image.png, keypoints.json.
    And scene.jpg: the cars of a street at the start and at the end, with the scene from above.
    --verbose has energies and times.
    """
    from fgrecon.cli import demo_report as report
    from fgrecon.cli.reconstruct_report import details
    from fgrecon.io.catalogue import load_prior
    from fgrecon.io.files import write_text
    from fgrecon.io.images import write_png
    from fgrecon.simulation.sample import demo_scene
    from fgrecon.solve.pipeline import reconstruct
    from fgrecon.viz import SolvedVehicle, animate, picture, recording_of, save_picture
    from fgrecon.viz.animation import check_format
    from fgrecon.viz.sinks import check_delivery, deliver

    check_delivery(None, viewer.connect)
    check_outputs(json_out, animation)
    if animation is not None:
        check_format(animation)
    screen = terminal.screen(json_out)
    out.mkdir(parents=True, exist_ok=True)
    prior = load_prior("car14")
    scene = demo_scene(prior, seed)
    observation, camera, image, truth = (
        scene.observation,
        scene.camera,
        scene.picture.image,
        report.true_values(scene.truth),
    )
    result = reconstruct(observation, camera, prior=prior, ground=scene.ground)
    stages = report.stages(result, prior.category, truth)
    document = json.dumps(report.document(seed, scene, truth, stages, result), allow_nan=False) + "\n"

    write_png(out / "image.png", image)
    write_text(out / "keypoints.json", json.dumps(report.keypoint_file(scene, prior.category), indent=1) + "\n")
    write_text(out / "result.json", document)
    sight = SolvedVehicle(result, observation, camera, image, truth)
    save_picture(out / "picture.png", picture(sight))
    save_picture(out / "scene.jpg", report.street_picture(prior, seed), dpi=_DPI)
    recording = recording_of(sight, ground=scene.ground)
    deliver([("demo", recording)], out / "recording.rrd", viewer.connect, spawn=viewer.spawn, several=False)
    if animation is not None:
        animate(animation, sight)

    screen.print(report.table(truth, stages))
    screen.print(*report.in_words(scene, result))
    screen.detail(*details(result))
    screen.print(*report.next_commands(scene, out))
    names = ("image.png", "keypoints.json", "result.json", "picture.png", "scene.jpg", "recording.rrd")
    screen.wrote(*(out / name for name in names), *([] if animation is None else [animation]))
    screen.write_json(document)
