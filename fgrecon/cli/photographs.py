"""Several photographs, or a folder of them: `fgrecon reconstruct ... --out FOLDER`, a results file for each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.cli import reconstruct_work, show
from fgrecon.cli.common import about_camera
from fgrecon.cli.models import with_closest
from fgrecon.cli.options import CameraOptions, VehicleBoxes
from fgrecon.cli.overwrites import check_not_over, files_in
from fgrecon.cli.picture_tasks import is_image, read_image_tasks
from fgrecon.cli.reconstruct_work import Outcome, Task
from fgrecon.cli.settings import Settings
from fgrecon.cli.terminal import Screen
from fgrecon.cli.together import Scene, grounds_of, solve_same_camera, solve_together, wants_together
from fgrecon.core.camera import Camera
from fgrecon.core.choices import BoxModel
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.text import counted, distinct
from fgrecon.core.vehicle_mesh import VehicleMesh
from fgrecon.io.files import write_text
from fgrecon.io.images import IMAGES, read_photograph

__all__ = ["PhotographFile", "PhotographWork", "reconstruct_each", "refuse", "wanted"]


@dataclass(frozen=True)
class PhotographFile:
    """A photograph, and where its results go.

    Attributes:
        image: Its file.
        target: The file of its results without ending, in the output's folder.
    """

    image: Path
    target: Path


@dataclass(frozen=True)
class PhotographWork:
    """What holds for all of them.

    Attributes:
        camera: The command line's camera.
        boxes: Where the cars are, and the network.
        settings: Prior, ground, size prior and options.
        box_model: What boxes enclose, or None for what their source says.
        together: Whether the vehicles of an image are solved together; None for the default.
        models: Car models that vehicles are compared with; may be empty.
        history: Whether results keep their history.
        pictures: Whether each is drawn.
        same_camera: Whether one camera took all of them.
    """

    camera: CameraOptions
    boxes: VehicleBoxes
    settings: Settings
    box_model: BoxModel | None
    together: bool | None
    models: Sequence[VehicleMesh]
    history: bool
    pictures: bool
    same_camera: bool = False


def wanted(
    files: Sequence[Path], out: Path | None, boxes: Path | None, *, pictures: bool
) -> list[PhotographFile] | None:
    """The photographs that are meant; None where a single file is, whose results do not go to a folder.

    Args:
        files: What the command line names.
        out: Folder of the results, or None.
        boxes: Where boxes are read, or None.
        pictures: Whether each is to be drawn.

    Raises:
        InvalidInputError: One is no image, a folder has none, nothing says where the results go, or one would be
            written over an image or its boxes.
    """
    if out is None:
        if len(files) == 1 and not files[0].is_dir() and not pictures:
            return None
        value = f"{len(files)} files" if len(files) > 1 else str(files[0])
        raise InvalidInputError("out", f"nothing, for {value}", "Give --out FOLDER, for a results file of each image.")
    images: dict[Path, None] = {}
    for file in files:
        if file.is_dir():
            inside = [path for path in sorted(file.iterdir()) if is_image(path) and path.is_file()]
            if not inside:
                raise InvalidInputError("file", str(file), f"Give a folder with images ({', '.join(IMAGES)}).")
            images |= dict.fromkeys(inside)
        elif not is_image(file):
            raise InvalidInputError(
                "file", str(file), "Give images and folders of them, or one file alone without --out."
            )
        else:
            images[file] = None
    if out.exists() and not out.is_dir():
        raise InvalidInputError("out", str(out), "Give a folder.")
    taken: set[str] = set()
    found = [PhotographFile(image, out / distinct(image.stem, taken)) for image in images]
    read = [*images, *files_in(boxes)]
    for one in found:
        for ending in (".json", ".png") if pictures else (".json",):
            check_not_over("out", _ending(one, ending), read)
    out.mkdir(parents=True, exist_ok=True)
    return found


def refuse(
    json_out: str | None, drawn: bool, recorded: bool, box: Sequence[str] | None, ids: Sequence[str] | None
) -> None:
    """Refuse what is said of one photograph where there may be several.

    Raises:
        InvalidInputError: Something is.
    """
    given = {"json": json_out is not None, "picture": drawn, "save": recorded, "box": bool(box), "id": bool(ids)}
    fixes = {"picture": "Give --pictures, for one of each image.", "box": "Give --boxes or --detect."}
    for field, used in given.items():
        if used:
            fix = fixes.get(field, "Leave it out: --out has a results file of each image.")
            raise InvalidInputError(field, "given with --out", fix)


def reconstruct_each(photographs: Sequence[PhotographFile], how: PhotographWork, screen: Screen) -> bool:
    """Reconstruct the vehicles of each photograph; say at the end what could not be used, and why.

    Returns:
        Whether every one gave a vehicle.

    Raises:
        InvalidInputError: The camera of all of them is given already.
    """
    if how.same_camera and how.camera.source().given:
        raise InvalidInputError("same_camera", "beside a camera", "Leave it out: the focal length is known.")
    nothing: list[str] = []
    count = 0
    for one, outcomes in (
        _same_camera(photographs, how, screen) if how.same_camera else _apart(photographs, how, screen)
    ):
        if isinstance(outcomes, FgreconError):
            nothing.append(f"{one.image}: {outcomes}")
        else:
            count += sum(outcome.result is not None for outcome in outcomes)
    done = len(photographs) - len(nothing)
    screen.print(f"{counted(count, 'vehicle')} in {done} of {counted(len(photographs), 'image')}.")
    for line in nothing:
        screen.fail(line)
    return not nothing


_Found = Iterator[tuple[PhotographFile, list[Outcome] | FgreconError]]


def _apart(photographs: Sequence[PhotographFile], how: PhotographWork, screen: Screen) -> _Found:
    """Each photograph by itself, as soon as it is read."""
    for one in screen.watch(photographs, "Images"):
        try:
            seen = _look(one, how, screen)
            joint = how.settings.options.shape.joint if how.together is None else how.together
            scenes: list[Scene] = []
            if joint or wants_together(seen.tasks):
                outcomes, scenes = solve_together(seen.tasks, how.settings, screen)
            else:
                outcomes = [reconstruct_work.run(task, how.settings) for task in seen.tasks]
        except FgreconError as error:
            yield one, error
            continue
        yield one, _deliver(seen, outcomes, scenes, how, screen)
        for scene in scenes:
            if scene.result.camera.focal_sigma:
                screen.warn(about_camera(scene.result.camera, seen.own))


def _same_camera(photographs: Sequence[PhotographFile], how: PhotographWork, screen: Screen) -> _Found:
    """All photographs with one focal length, which is found when all are read."""
    seen: list[_Seen] = []
    for one in screen.watch(photographs, "Keypoints"):
        try:
            looked = replace(_look(one, how, screen), pixels=None)  # read again where it is drawn
            if seen and not _alike(seen[0].tasks[0].camera, looked.tasks[0].camera):
                value = f"another size or focal length than {seen[0].file.image.name}"
                raise InvalidInputError("same_camera", value, "Give images of one camera, alike in size.")
            seen.append(looked)
        except FgreconError as error:
            yield one, error
    if not seen:
        return
    solved = solve_same_camera([(one.file.image.name, one.tasks) for one in seen], how.settings)
    counts = [sum(outcome.result is not None for outcome in outcomes) for outcomes, _ in solved]
    cars = f"the {counted(sum(counts), 'car')} of {counted(sum(map(bool, counts)), 'image')}"
    screen.warn(about_camera(solved[0][1].result.camera, seen[0].own, cars))
    for one_seen, (outcomes, scene) in zip(seen, solved, strict=True):
        yield one_seen.file, _deliver(one_seen, outcomes, [scene], how, screen)


def _alike(first: Camera, second: Camera) -> bool:
    """Whether two photographs' cameras may be one: of the same size, and with the same focal length as far as known."""
    same = first.image_size == second.image_size and first.focal_sigma == second.focal_sigma
    return same and bool(np.allclose(first.matrix, second.matrix, rtol=1e-3))


@dataclass(frozen=True)
class _Seen:
    """A photograph whose vehicles have keypoints.

    Attributes:
        file: The photograph.
        tasks: Its vehicles.
        own: The camera that its file tells, or None.
        pixels: (H, W, 3), or None where they are not kept.
    """

    file: PhotographFile
    tasks: list[Task]
    own: Camera | None
    pixels: NDArray[np.uint8] | None


def _look(one: PhotographFile, how: PhotographWork, screen: Screen) -> _Seen:
    """The vehicles of a photograph.

    Raises:
        InvalidInputError: The image or its boxes cannot be used.
    """
    pixels, own = read_photograph(one.image, how.camera.whole)
    source, category = how.camera.source(pixels, own), how.settings.prior.category
    return _Seen(
        one, read_image_tasks(one.image, pixels, source, category, how.boxes, how.box_model, screen), own, pixels
    )


def _deliver(
    seen: _Seen, outcomes: list[Outcome], scenes: list[Scene], how: PhotographWork, screen: Screen
) -> list[Outcome] | FgreconError:
    """Show a photograph's results, and write them to its file.

    Returns:
        The results, or why there is none.

    Raises:
        InvalidInputError: The file cannot be written.
    """
    one, settings = seen.file, how.settings
    outcomes = with_closest(outcomes, how.models)
    screen.print(f"{one.image}:")
    show.print_table(screen, outcomes)
    plain = [scene.plain() for scene in scenes]
    document = show.document(one.image, outcomes, settings, plain, one.image, history=how.history)
    screen.wrote(write_text(_ending(one, ".json"), document))
    if how.pictures:
        pixels = read_photograph(one.image)[0] if seen.pixels is None else seen.pixels
        grounds = grounds_of(seen.tasks, settings, scenes)
        screen.wrote(*show.draw(_ending(one, ".png"), outcomes, pixels, grounds, sheet=False))
    try:
        if reconstruct_work.check_any(one.image, outcomes):
            return outcomes
    except InvalidInputError as error:
        return error
    return outcomes[0].error or InvalidInputError("image", str(one.image), "Solving failed on every vehicle.")


def _ending(one: PhotographFile, ending: str) -> Path:
    return one.target.with_name(one.target.name + ending)
