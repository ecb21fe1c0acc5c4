"""`fgrecon demo`: a simulated scene with known truth, reconstructed and drawn. Needs no data."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from fgrecon.cli.common import check_output, console
from fgrecon.cli.deliver import ConnectOption, SpawnOption, check_delivery, deliver

__all__ = ["demo_command"]


def demo_command(
    out: Annotated[Path, typer.Option(help="Folder for the results; made where it does not exist.")] = Path("demo"),
    seed: Annotated[int, typer.Option(min=0, help="Of car, pose, keypoints and scenery.")] = 7,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
    animation: Annotated[Path | None, typer.Option(metavar="FILE", help="Animate the optimisation (gif, mp4).")] = None,
    connect: ConnectOption = None,
    spawn: SpawnOption = False,
) -> None:
    """Render a car, perturb and hide its keypoints, reconstruct it, and compare with the truth.

    Writes picture.png, recording.rrd for the rerun viewer and result.json, and what went in: image.png, keypoints.json.
    """
    from fgrecon.cli import demo_report as report
    from fgrecon.io.catalogue import load_prior
    from fgrecon.io.files import write_text
    from fgrecon.io.images import write_png
    from fgrecon.simulation.demo import demo_scene
    from fgrecon.solve.pipeline import reconstruct
    from fgrecon.viz import animate, picture, recording_of, save_picture
    from fgrecon.viz.animation import check_format

    check_delivery(None, connect)
    if animation is not None:
        check_output(animation)
        check_format(animation)
    out.mkdir(parents=True, exist_ok=True)
    prior = load_prior("car14")
    scene = demo_scene(prior, seed)
    seen, camera, image, truth = scene.observation, scene.camera, scene.picture.image, report.true_values(scene)
    result = reconstruct(
        seen.keypoints, camera, confidence=seen.confidence, box=seen.box, prior=prior, ground=scene.ground
    )
    stages = report.stages(result, prior.category, truth)
    document = json.dumps(report.document(seed, scene, truth, stages, result), allow_nan=False) + "\n"

    write_png(out / "image.png", image)
    write_text(out / "keypoints.json", json.dumps(report.keypoint_file(scene, prior.category), indent=1) + "\n")
    write_text(out / "result.json", document)
    save_picture(out / "picture.png", picture(result, seen, camera, image=image, truth=truth))
    recording = recording_of(result, seen, camera, image=image, truth=truth, ground=scene.ground)
    deliver([("demo", recording)], out / "recording.rrd", connect, spawn=spawn, several=False)
    if animation is not None:
        animate(animation, result, seen, camera, image=image, truth=truth)

    if as_json:
        sys.stdout.write(document)
    shown = console(error=as_json)
    shown.print(report.table(truth, stages))
    hidden, wrong = int((~scene.truth.visible).sum()), int(scene.truth.outlier.sum())
    again = f"{out / 'keypoints.json'} --image {out / 'image.png'} --camera-height {scene.ground.distance:g}"
    for line in (
        f"A simulated car with {len(seen.keypoints)} keypoints: {hidden} hidden, {wrong} measured in a wrong place.",
        f"{result.status.value}: {result.message}",
        f"See {out / 'picture.png'}, play it back with: fgrecon replay {out / 'recording.rrd'}",
        f"Do it again with: fgrecon reconstruct {again}",
    ):
        shown.print(line, markup=False)
