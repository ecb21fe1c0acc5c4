"""The run of `fgrecon reconstruct`: one file, or images and folders of them with a results file each.

files ---- tasks, one for each vehicle ---- outcomes ---- table, JSON, drawings, recordings
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fgrecon.batch.results_file import document
from fgrecon.batch.solve_tasks import (
    Outcome,
    SolvedImage,
    check_any,
    fit_warnings,
    grounds_of,
    left_out_lines,
    solve_same_camera,
    solve_tasks,
    with_closest,
)
from fgrecon.batch.vehicle_tasks import KeypointRequest, VehicleTask, image_tasks, input_warnings, read_tasks
from fgrecon.cli import reconstruct_report as report
from fgrecon.cli.outputs import check_not_over, files_in
from fgrecon.cli.reconstruct_options import Drawings, ReconstructRequest
from fgrecon.cli.terminal import Screen
from fgrecon.core.camera import Camera, Ground
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.text import counted, distinct
from fgrecon.core.vehicle_mesh import VehicleMesh
from fgrecon.io.cameras.camera_source import CameraSource, assumed_focal_length
from fgrecon.io.files import write_text
from fgrecon.io.images import IMAGES, read_photograph
from fgrecon.io.nuscenes import NEAREST
from fgrecon.io.run_settings import RunSettings
from fgrecon.perception.sensor_source import SensorSource
from fgrecon.viz.outcomes import draw, draw_moving, recordings

_NAMED = 8
"""Vehicles that an error names."""


@dataclass(frozen=True)
class _Photograph:
    """A photograph whose vehicles have keypoints.

    Attributes:
        path: Its file.
        tasks: Its vehicles.
        source: What is given of its camera, with its pixels and EXIF data.
    """

    path: Path
    tasks: list[VehicleTask]
    source: CameraSource


@dataclass(frozen=True)
class _Solved:
    """The vehicles of a file, solved."""

    tasks: list[VehicleTask]
    outcomes: list[Outcome]
    images: list[SolvedImage]

    def grounds(self, settings: RunSettings) -> dict[str | None, Ground | None]:
        """The ground of each image, by its name."""
        return grounds_of(self.tasks, settings, self.images)


def reconstruct_file(files: Sequence[Path], request: ReconstructRequest, screen: Screen) -> bool:
    """Reconstruct the vehicles of one file.

    Returns:
        Whether at least one was reconstructed.

    Raises:
        InvalidInputError: The input cannot be used.
    """
    (file,) = files
    settings, of_image = request.settings(), _is_image(file)
    models = request.car_models.read(settings.prior.category)
    request.check_jobs(of_image=of_image, several=False)
    photograph, ignored = _read(file, request, settings, screen)
    tasks = _chosen(photograph.tasks, request.solving.ids)
    _check_animated(request.drawings, tasks)
    warnings = input_warnings(tasks, detected=of_image)
    if settings.ground is None and tasks:
        image = file if of_image else request.drawings.image
        screen.print(*_ground_of(photograph.source, tasks[0].instance.image or (None if image is None else image.name)))
    together = request.together(of_image=of_image)
    outcomes, images = solve_tasks(tasks, settings, together=together, jobs=request.results.jobs, watch=screen.watch)
    solved = _Solved(tasks, with_closest(outcomes, models), images)
    report.print_table(screen, solved.outcomes)
    for image_solved in images:
        screen.print(*report.image_lines(image_solved))
        if image_solved.result.camera.focal_sigma:
            screen.warn(assumed_focal_length(image_solved.result.camera, photograph.source.exif))
    left_out = left_out_lines(solved.outcomes)
    screen.print(
        *left_out[:_NAMED], *([f"... and {len(left_out) - _NAMED} more left out."] if left_out[_NAMED:] else [])
    )
    for line in warnings or ([] if of_image else fit_warnings(solved.outcomes)):
        screen.warn(line)
    if ignored:
        screen.print(f"Fields of the file without a meaning here: {', '.join(ignored)}.")
    _deliver(file, solved, photograph, request, settings, screen)
    if not check_any(file, solved.outcomes):
        screen.fail("No vehicle could be reconstructed.")
        return False
    return True


def _read(
    file: Path, request: ReconstructRequest, settings: RunSettings, screen: Screen
) -> tuple[_Photograph, tuple[str, ...]]:
    """The vehicles of a file, the photograph that shows them, and fields of the file that mean nothing."""
    if _is_image(file):
        return _read_photograph(file, request, settings, screen), ()
    request.boxes.refuse()
    source, image = request.source(), request.drawings.image
    if image is not None:
        pixels, exif = read_photograph(image, source.whole)
        source = replace(source, image=pixels, exif=exif)
    names = request.results.names
    read = read_tasks(file, settings.prior.category, source, names, None if image is None else image.name)
    for line in read.warnings:
        screen.warn(line)
    tasks = _with_evidence(read.tasks, request.sensors.source(source), image or file)
    return _Photograph(file, tasks, source), read.ignored


def _with_evidence(tasks: list[VehicleTask], sensors: SensorSource | None, file: Path) -> list[VehicleTask]:
    """The vehicles of a keypoint file with what other sensors say of their images.

    Args:
        tasks: The vehicles.
        sensors: The sensors' files, or None.
        file: The photograph, else the keypoint file, whose name the sensors' files have where vehicles name no image.
    """
    if sensors is None:
        return tasks
    paths = [file if one.instance.image in (None, file.name) else Path(str(one.instance.image)) for one in tasks]
    sensors.check(path.name for path in paths)
    known = {path: sensors.evidence(path) for path in paths}
    return [replace(one, evidence=known[path]) for path, one in zip(paths, tasks, strict=True)]


def _read_photograph(path: Path, request: ReconstructRequest, settings: RunSettings, screen: Screen) -> _Photograph:
    source = request.source()
    pixels, exif = read_photograph(path, source.whole)
    source = replace(source, image=pixels, exif=exif)
    how = KeypointRequest(settings.prior.category, request.boxes.weights, request.solving.box_model)
    found = request.boxes.choose(path, pixels, scale_to_image=source.scale_to_image)
    if others := found.other_vehicles:
        listed = ", ".join(f"{count} {kind}" for kind, count in others.most_common())
        screen.note(f"{path.name}: left out {listed}, which {settings.prior.category.name} does not cover.")
    if found.near:
        cars = counted(found.near, "car")
        screen.note(f"{path.name}: left out {cars} nearer to the camera than {NEAREST} m, without a 2D box.")
    sensors = request.sensors.source(source)
    if sensors is not None and request.of_one([path]):
        sensors.check([path.name])
    tasks = image_tasks(path, source, found.cars, how, screen.watch, sensors)
    return _Photograph(path, tasks, source)


def _is_image(path: Path) -> bool:
    """Whether a file is an image, by its ending."""
    return path.suffix.lower() in IMAGES


def _chosen(tasks: list[VehicleTask], ids: Sequence[str] | None) -> list[VehicleTask]:
    """The vehicles of some names, or all."""
    if ids is None:
        return tasks
    known = {task.instance.name for task in tasks}
    for name in ids:
        if name not in known:
            raise InvalidInputError("id", name, f"Give one of {_listed(sorted(known))}.")
    return [task for task in tasks if task.instance.name in ids]


def _check_animated(drawings: Drawings, tasks: Sequence[VehicleTask]) -> None:
    """Refuse before the work to animate several vehicles."""
    if drawings.animation is not None and len(tasks) > 1:
        names = _listed([task.instance.name for task in tasks])
        raise InvalidInputError("animation", f"{len(tasks)} vehicles", f"Choose one with --id: {names}.")


def _listed(names: Sequence[str]) -> str:
    """The names, or the first of very many."""
    return ", ".join(names[:_NAMED]) + (", ..." if len(names) > _NAMED else "")


def _ground_of(source: CameraSource, image: str | None) -> list[str]:
    """A line that says how to use the ground plane of a calibration file; none where it has none."""
    mounted = source.mounted(image)
    if mounted is None or mounted.ground is None:
        return []
    x, y, z = mounted.ground.normal
    plane = f"{x:.5g},{y:.5g},{z:.5g},{mounted.ground.distance:.5g}"
    return [f"{source.file} says where the ground is; --ground={plane} uses it."]


def _deliver(
    file: Path,
    solved: _Solved,
    photograph: _Photograph,
    request: ReconstructRequest,
    settings: RunSettings,
    screen: Screen,
) -> None:
    """Write the results file, drawings and recordings."""
    drawings, pixels, outcomes = request.drawings, photograph.source.image, solved.outcomes
    image = file if _is_image(file) else drawings.image
    history = request.results.history
    screen.write_json(document(file, outcomes, settings, solved.images, image, history=history))
    grounds = solved.grounds(settings)
    if drawings.picture is not None:
        screen.wrote(*draw(drawings.picture, outcomes, pixels, grounds, sheet=drawings.sheet))
    if drawings.animation is not None:
        screen.wrote(*draw_moving(drawings.animation, outcomes, pixels))
    if request.delivery.requested:
        made = recordings(outcomes, pixels, grounds)
        request.delivery.deliver(made, screen, several=len(grounds) > 1 or len(made) > 1)


def reconstruct_each(files: Sequence[Path], request: ReconstructRequest, screen: Screen) -> bool:
    """Reconstruct the vehicles of each photograph; say at the end what could not be used, and why.

    Returns:
        Whether every photograph gave a vehicle.

    Raises:
        InvalidInputError: An option is of a single file, the files are no images, or would be written over.
    """
    settings = request.settings()
    models = request.car_models.read(settings.prior.category)
    targets = _targets(files, request)
    request.check_jobs(of_image=True, several=True)
    _refuse_of_one(request)
    work = _Work(request, settings, models, targets, screen)
    if request.results.same_camera and request.source().given:
        raise InvalidInputError("same_camera", "beside a camera", "Leave it out: the focal length is known.")
    for photograph in work.photographs_same_camera() if request.results.same_camera else work.photographs():
        work.deliver(*photograph)
    done = len(targets) - len(work.problems)
    screen.print(f"{counted(work.vehicles, 'vehicle')} in {done} of {counted(len(targets), 'image')}.")
    for line in work.problems:
        screen.fail(line)
    return not work.problems


def _targets(files: Sequence[Path], request: ReconstructRequest) -> dict[Path, Path]:
    """The photographs, and for each the file of its results without ending.

    Raises:
        InvalidInputError: One is no image, a folder has none, nothing says where the results go, or one would be
            written over an image or its boxes.
    """
    out, pictures = request.results.out, request.results.pictures
    if out is None:
        value = f"{len(files)} files" if len(files) > 1 else str(files[0])
        raise InvalidInputError("out", f"nothing, for {value}", "Give --out FOLDER, for a results file of each image.")
    images: dict[Path, None] = {}
    for file in files:
        if file.is_dir():
            inside = [path for path in sorted(file.iterdir()) if _is_image(path) and path.is_file()]
            if not inside:
                raise InvalidInputError("file", str(file), f"Give a folder with images ({', '.join(IMAGES)}).")
            images |= dict.fromkeys(inside)
        elif not _is_image(file):
            fix = "Give images and folders of them, or one file alone without --out."
            raise InvalidInputError("file", str(file), fix)
        else:
            images[file] = None
    if out.exists() and not out.is_dir():
        raise InvalidInputError("out", str(out), "Give a folder.")
    taken: set[str] = set()
    targets = {image: out / distinct(image.stem, taken) for image in images}
    for target in targets.values():
        for ending in (".json", ".png") if pictures else (".json",):
            check_not_over("out", _with_ending(target, ending), [*images, *files_in(request.boxes.boxes)])
    out.mkdir(parents=True, exist_ok=True)
    return targets


def _refuse_of_one(request: ReconstructRequest) -> None:
    """Refuse what is said of one photograph where there may be several."""
    given = {
        "json": request.results.json_out is not None,
        "picture": request.drawings.requested or request.drawings.image is not None,
        "save": request.delivery.requested,
        "box": bool(request.boxes.box),
        "id": bool(request.solving.ids),
    }
    fixes = {"picture": "Give --pictures, for one of each image.", "box": "Give --boxes or --detect."}
    for option, used in given.items():
        if used:
            fix = fixes.get(option, "Leave it out: --out has a results file of each image.")
            raise InvalidInputError(option, "given with --out", fix)


@dataclass
class _Work:
    """The photographs of a run, one after the other.

    Attributes:
        request: What is requested.
        settings: What holds for all of them.
        models: Car models that vehicles are compared with; may be empty.
        targets: The photographs, and for each the file of its results without ending.
        screen: Where it is said.
        problems: What could not be used, and why.
        vehicles: How many have results.
    """

    request: ReconstructRequest
    settings: RunSettings
    models: Sequence[VehicleMesh]
    targets: dict[Path, Path]
    screen: Screen
    problems: list[str] = field(default_factory=list)
    vehicles: int = 0

    def photographs(self) -> Iterator[tuple[_Photograph, list[Outcome], list[SolvedImage]]]:
        """Each photograph solved by itself, as soon as it is read."""
        together = self.request.together(of_image=True)
        for path in self.screen.watch(list(self.targets), "Images"):
            try:
                photograph = _read_photograph(path, self.request, self.settings, self.screen)
                solved = solve_tasks(photograph.tasks, self.settings, together=together, watch=self.screen.watch)
            except FgreconError as error:
                self.problems.append(f"{path}: {error}")
                continue
            yield photograph, *solved
            for image in solved[1]:
                if image.result.camera.focal_sigma:
                    self.screen.warn(assumed_focal_length(image.result.camera, photograph.source.exif))

    def photographs_same_camera(self) -> Iterator[tuple[_Photograph, list[Outcome], list[SolvedImage]]]:
        """All photographs with one focal length, which is estimated when all are read."""
        read: list[_Photograph] = []
        for path in self.screen.watch(list(self.targets), "Keypoints"):
            try:
                photograph = _read_photograph(path, self.request, self.settings, self.screen)
                if read and not _may_be_same(read[0].tasks[0].camera, photograph.tasks[0].camera):
                    value = f"another size or focal length than {read[0].path.name}"
                    raise InvalidInputError("same_camera", value, "Give images of one camera, alike in size.")
            except FgreconError as error:
                self.problems.append(f"{path}: {error}")
                continue
            without_pixels = replace(photograph.source, image=None)  # read again where it is drawn
            read.append(replace(photograph, source=without_pixels))
        if not read:
            return
        solved = solve_same_camera([(photograph.path.name, photograph.tasks) for photograph in read], self.settings)
        counts = [sum(outcome.result is not None for outcome in outcomes) for outcomes, _ in solved]
        cars = f"the {counted(sum(counts), 'car')} of {counted(sum(map(bool, counts)), 'image')}"
        self.screen.warn(assumed_focal_length(solved[0][1].result.camera, read[0].source.exif, cars))
        for photograph, (outcomes, image) in zip(read, solved, strict=True):
            yield photograph, outcomes, [image]

    def deliver(self, photograph: _Photograph, outcomes: list[Outcome], images: list[SolvedImage]) -> None:
        """Show a photograph's results, and write them to its file.

        Raises:
            InvalidInputError: The file cannot be written.
        """
        path, screen, results = photograph.path, self.screen, self.request.results
        outcomes = with_closest(outcomes, self.models)
        screen.print(f"{path}:")
        report.print_table(screen, outcomes)
        text = document(path, outcomes, self.settings, images, path, history=results.history)
        target = self.targets[path]
        screen.wrote(write_text(_with_ending(target, ".json"), text))
        if results.pictures:
            pixels: NDArray[np.uint8] | None = photograph.source.image
            pixels = read_photograph(path)[0] if pixels is None else pixels
            grounds = _Solved(photograph.tasks, outcomes, images).grounds(self.settings)
            screen.wrote(*draw(_with_ending(target, ".png"), outcomes, pixels, grounds, sheet=False))
        try:
            problem = None if check_any(path, outcomes) else outcomes[0].error or _all_failed(path)
        except InvalidInputError as error:
            problem = error
        if problem is None:
            self.vehicles += sum(outcome.result is not None for outcome in outcomes)
        else:
            self.problems.append(f"{path}: {problem}")


def _all_failed(path: Path) -> InvalidInputError:
    return InvalidInputError("image", str(path), "Solving failed on every vehicle.")


def _may_be_same(first: Camera, second: Camera) -> bool:
    """Whether two photographs' cameras may be the same: of one size, and of one focal length as far as known."""
    same = first.image_size == second.image_size and first.focal_sigma == second.focal_sigma
    return same and bool(np.allclose(first.matrix, second.matrix, rtol=1e-3))


def _with_ending(target: Path, ending: str) -> Path:
    return target.with_name(target.name + ending)
