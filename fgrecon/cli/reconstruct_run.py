"""The run of `fgrecon reconstruct`: one file, or images and folders of them with a results file each.

files ---- tasks, one for each vehicle ---- outcomes ---- table, JSON, drawings, recordings
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from fgrecon.batch.file_service import FileRequest, ReadFile, SolvedFile, is_image, read_file, solve_file
from fgrecon.batch.solve_tasks import check_any, count_results, solve_same_camera, with_closest
from fgrecon.batch.vehicle_tasks import VehicleTask
from fgrecon.cli import reconstruct_report as report
from fgrecon.cli.outputs import check_not_over, files_in
from fgrecon.cli.reconstruct_options import Drawings, ReconstructRequest
from fgrecon.cli.reconstruct_report import NAMED
from fgrecon.cli.terminal import Screen
from fgrecon.core.camera import Camera
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.input_warnings import InputWarnings
from fgrecon.core.text import counted, distinct
from fgrecon.io.cameras.camera_source import CameraSource, assumed_focal_length
from fgrecon.io.files import write_text
from fgrecon.io.images import IMAGES, read_photograph, refuse_unread
from fgrecon.viz.animation import animate
from fgrecon.viz.outcomes import draw, recordings, sights_of


def reconstruct_file(files: Sequence[Path], request: ReconstructRequest, screen: Screen) -> bool:
    """Reconstruct the vehicles of one file.

    Returns:
        Whether at least one was reconstructed.
    """
    (file,) = files
    request.check_jobs(of_image=is_image(file), several=False)
    if not is_image(file) and file.exists():
        request.boxes.refuse(file)
    what = request.of_files(screen.watch)
    if what.sensors is not None and is_image(file):
        what.sensors.check([file.name])
    read = read_file(file, what, request.drawings.image)
    _say_left_out(read, screen)
    read = replace(read, tasks=_chosen(read.tasks, request.solving.ids))
    _check_animated(request.drawings, read.tasks)
    if what.settings.ground is None and read.tasks:
        image = None if read.photograph is None else read.photograph.name
        screen.print(*_ground_of(read.source, read.tasks[0].instance.image or image))
    solved = solve_file(read, what)
    _report(solved, screen)
    _deliver(solved, request, screen)
    if not check_any(file, solved.outcomes):
        screen.fail("No vehicle could be reconstructed.")
        return False
    return True


def _say_left_out(read: ReadFile, screen: Screen) -> None:
    for line in read.notes:
        screen.note(line)
    for line in read.warnings:
        screen.warn(line)


def _report(solved: SolvedFile, screen: Screen) -> None:
    """Say what became of the vehicles, and what there is to warn of."""
    report.print_table(screen, solved.outcomes)
    for image in solved.images:
        screen.print(*report.image_lines(image))
    for line in solved.focal_lengths:
        screen.warn(line)
    left_out = solved.parts_left_out
    more = [f"... and {len(left_out) - NAMED} more left out."] if left_out[NAMED:] else []
    screen.print(*left_out[:NAMED], *more)
    for line in solved.contradictions:
        screen.warn(line)
    if ignored := solved.read.ignored:
        screen.print(f"Fields of the file without a meaning here: {', '.join(ignored)}.")


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
    return ", ".join(names[:NAMED]) + (", ..." if len(names) > NAMED else "")


def _ground_of(source: CameraSource, image: str | None) -> list[str]:
    """A line that says how to use the ground plane of a calibration file; none where it has none."""
    mounted = source.mounted(image)
    if mounted is None or mounted.ground is None:
        return []
    x, y, z = mounted.ground.normal
    plane = f"{x:.5g},{y:.5g},{z:.5g},{mounted.ground.distance:.5g}"
    return [f"{source.file} says where the ground is; --ground={plane} uses it."]


def _deliver(solved: SolvedFile, request: ReconstructRequest, screen: Screen) -> None:
    """Write the results file, drawings and recordings."""
    drawings, pixels, outcomes = request.drawings, solved.read.source.image, solved.outcomes
    screen.write_json(solved.document(history=request.results.history))
    grounds = solved.grounds
    if drawings.picture is not None:
        screen.wrote(*draw(drawings.picture, outcomes, pixels, grounds, sheet=drawings.sheet))
    if drawings.animation is not None:
        screen.wrote(*(animate(drawings.animation, sight) for sight in sights_of(outcomes, pixels)))  # one at most
    if request.delivery.requested:
        made = recordings(outcomes, pixels, grounds)
        request.delivery.deliver(made, screen, several=len(grounds) > 1 or len(made) > 1)


def reconstruct_each(files: Sequence[Path], request: ReconstructRequest, screen: Screen) -> bool:
    """Reconstruct the vehicles of each photograph; say at the end what could not be used, and why.

    Returns:
        Whether every photograph gave a vehicle.
    """
    what = request.of_files(screen.watch)
    targets = _targets(files, request)
    what.boxes.check_images(len(targets))
    request.check_jobs(of_image=True, several=True)
    _refuse_of_one(request)
    work = _Work(request, what, targets, screen)
    if request.results.same_camera and what.source.given:
        raise InvalidInputError("same_camera", "beside a camera", "Leave it out: the focal length is known.")
    for solved in work.photographs_same_camera() if request.results.same_camera else work.photographs():
        work.deliver(solved)
    done = len(targets) - len(work.problems)
    screen.print(f"{counted(work.vehicles, 'vehicle')} in {done} of {counted(len(targets), 'image')}.")
    for line in work.warnings.lines():
        screen.warn(line)
    for line in work.problems:
        screen.fail(line)
    return not work.problems


def _targets(files: Sequence[Path], request: ReconstructRequest) -> dict[Path, Path]:
    """The photographs, and for each the file of its results without ending."""
    out, pictures = request.results.out, request.results.pictures
    if out is None:
        value = f"{len(files)} files" if len(files) > 1 else str(files[0])
        raise InvalidInputError("out", f"nothing, for {value}", "Give --out FOLDER, for a results file of each image.")
    images: dict[Path, None] = {}
    for file in files:
        if file.is_dir():
            inside = [path for path in sorted(file.iterdir()) if is_image(path) and path.is_file()]
            if not inside:
                refuse_unread(file, "file")
                raise InvalidInputError("file", str(file), f"Give a folder with images ({', '.join(IMAGES)}).")
            images |= dict.fromkeys(inside)
        elif not is_image(file):
            refuse_unread(file, "file")
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
    """The photographs of a run, one after the other."""

    request: ReconstructRequest  # what is requested
    what: FileRequest  # what of that is requested of each of them
    targets: dict[Path, Path]  # the photographs, and for each the file of its results without ending
    screen: Screen  # where it is said
    problems: list[str] = field(default_factory=list)  # what could not be used, and why
    vehicles: int = 0  # how many have results
    warnings: InputWarnings = field(default_factory=InputWarnings)  # of these

    def _read(self, path: Path) -> ReadFile:
        read = read_file(path, self.what)
        _say_left_out(read, self.screen)
        return read

    def photographs(self) -> Iterator[SolvedFile]:
        """Each photograph solved by itself, as soon as it is read."""
        for path in self.screen.watch(list(self.targets), "Images"):
            try:
                solved = solve_file(self._read(path), self.what)
            except FgreconError as error:
                self.problems.append(f"{path}: {error}")
                continue
            yield solved
            for line in solved.focal_lengths:
                self.screen.warn(line)

    def photographs_same_camera(self) -> Iterator[SolvedFile]:
        """All photographs with one focal length, which is estimated when all are read."""
        read: list[ReadFile] = []
        for path in self.screen.watch(list(self.targets), "Keypoints"):
            try:
                photograph = self._read(path)
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
        settings = self.what.settings
        solved = solve_same_camera([(photograph.path.name, photograph.tasks) for photograph in read], settings)
        counts = [sum(outcome.result is not None for outcome in outcomes) for outcomes, _ in solved]
        cars = f"the {counted(sum(counts), 'car')} of {counted(sum(map(bool, counts)), 'image')}"
        self.screen.warn(assumed_focal_length(solved[0][1].result.camera, read[0].source.exif, cars))
        for photograph, (outcomes, image) in zip(read, solved, strict=True):
            yield SolvedFile(photograph, settings, with_closest(outcomes, self.what.models), [image])

    def deliver(self, solved: SolvedFile) -> None:
        """Show a photograph's results, and write them to its file."""
        path, screen, results, outcomes = solved.read.path, self.screen, self.request.results, solved.outcomes
        screen.print(f"{path}:")
        report.print_table(screen, outcomes)
        target = self.targets[path]
        screen.wrote(write_text(_with_ending(target, ".json"), solved.document(history=results.history)))
        if results.pictures:
            pixels = solved.read.source.image
            pixels = read_photograph(path)[0] if pixels is None else pixels
            screen.wrote(*draw(_with_ending(target, ".png"), outcomes, pixels, solved.grounds, sheet=False))
        failed = InvalidInputError("image", str(path), "Solving failed on every vehicle.")
        try:
            problem = None if check_any(path, outcomes) else outcomes[0].error or failed
        except InvalidInputError as error:
            problem = error
        count_results(self.warnings, outcomes, f"{path.name}:")
        if problem is None:
            self.vehicles += sum(outcome.result is not None for outcome in outcomes)
        else:
            self.problems.append(f"{path}: {problem}")


def _may_be_same(first: Camera, second: Camera) -> bool:
    """Whether two photographs' cameras may be the same: of one size, and of one focal length as far as known."""
    same = first.image_size == second.image_size and first.focal_sigma == second.focal_sigma
    return same and bool(np.allclose(first.matrix, second.matrix, rtol=1e-3))


def _with_ending(target: Path, ending: str) -> Path:
    return target.with_name(target.name + ending)
