"""`fgrecon reconstruct`: pose and shape of every vehicle in a keypoint file, or in boxes of images."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fgrecon.cli.common import about_camera, check_outputs
from fgrecon.cli.deliver import Delivery
from fgrecon.cli.models import CarModels, with_closest
from fgrecon.cli.options import (
    BOX_MODEL_HELP,
    CameraOptions,
    HistoryOption,
    JsonOption,
    NamesOption,
    SceneOptions,
    VehicleBoxes,
)
from fgrecon.cli.terminal import Terminal
from fgrecon.core.choices import BoxModel
from fgrecon.core.errors import InvalidInputError

if TYPE_CHECKING:  # the command line must start fast: what the command needs is imported when it runs
    from collections.abc import Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from fgrecon.cli.reconstruct_work import Outcome, Task
    from fgrecon.cli.terminal import Screen
    from fgrecon.cli.together import Scene
    from fgrecon.core.camera import Ground

__all__ = ["reconstruct_command"]

_NAMED = 8
"""Vehicles that an error names."""


@dataclass(frozen=True)
class Solving:
    """How the vehicles are solved."""

    box_model: Annotated[
        BoxModel | None,
        typer.Option(
            help=BOX_MODEL_HELP,
            show_default="surface for keypoint files and --box, as --boxes says, detected for --detect",
        ),
    ] = None
    joint: Annotated[bool, typer.Option("--joint/--no-joint", help="Let pose and shape move together.")] = True
    free_offsets: Annotated[
        bool,
        typer.Option(
            "--free-offsets/--no-free-offsets", help="Let every keypoint leave the shape prior by a small offset."
        ),
    ] = True
    ids: Annotated[
        list[str] | None,
        typer.Option("--id", metavar="NAME", help="Take only this vehicle of the file or image; may be repeated."),
    ] = None

    def chosen(self, tasks: list[Task]) -> list[Task]:
        """The vehicles that are wanted.

        Raises:
            InvalidInputError: There is none of a name.
        """
        if self.ids is None:
            return tasks
        known = {task.instance.name for task in tasks}
        for name in self.ids:
            if name not in known:
                raise InvalidInputError("id", name, f"Give one of {_listed(sorted(known))}.")
        return [task for task in tasks if task.instance.name in self.ids]


@dataclass(frozen=True)
class Drawings:
    """What is drawn of the results, and on which photograph."""

    image: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The photograph: to draw on, and for its size.")
    ] = None
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw the image and the scene from above (png, svg, pdf, jpg).")
    ] = None
    sheet: Annotated[
        bool,
        typer.Option("--sheet", help="Let --picture have a part of the image for each; of one vehicle the stages."),
    ] = False
    animation: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Animate the optimisation of one vehicle, of several with --id (gif, mp4)."),
    ] = None

    @property
    def wanted(self) -> bool:
        """Whether anything is to be drawn."""
        return self.picture is not None or self.animation is not None

    def check(self) -> None:
        """Refuse before the work what could not be drawn after it.

        Raises:
            InvalidInputError: The animation's ending means no format, or a sheet is asked for but no picture.
        """
        from fgrecon.viz.animation import check_format

        if self.animation is not None:
            check_format(self.animation)
        if self.sheet and self.picture is None:
            raise InvalidInputError("sheet", "without --picture", "Say with --picture where it is to be written.")

    def check_vehicles(self, tasks: Sequence[Task]) -> None:
        """Refuse before the work to animate several vehicles.

        Raises:
            InvalidInputError: There are several.
        """
        if self.animation is not None and len(tasks) > 1:
            names = _listed([task.instance.name for task in tasks])
            raise InvalidInputError("animation", f"{len(tasks)} vehicles", f"Choose one with --id: {names}.")

    def draw(
        self,
        outcomes: Sequence[Outcome],
        photograph: NDArray[np.uint8] | None,
        grounds: Mapping[str | None, Ground | None],
        screen: Screen,
    ) -> None:
        """Draw the results, and say which files were written.

        Args:
            outcomes: One per vehicle.
            photograph: (H, W, 3), or None.
            grounds: The ground of each image, by its name.
            screen: Where it is said.
        """
        from fgrecon.cli import show

        if self.picture is not None:
            screen.wrote(*show.draw(self.picture, outcomes, photograph, grounds, sheet=self.sheet))
        if self.animation is not None:
            screen.wrote(*show.draw_moving(self.animation, outcomes, photograph))


def _listed(names: Sequence[str]) -> str:
    """The names, or the first of very many."""
    return ", ".join(names[:_NAMED]) + (", ..." if len(names) > _NAMED else "")


def reconstruct_command(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...", help="Keypoints (of any known format), a track, or images and folders of them."
        ),
    ],
    camera: CameraOptions,
    scene: SceneOptions,
    solving: Solving,
    boxes: VehicleBoxes,
    drawings: Drawings,
    delivery: Delivery,
    car_models: CarModels,
    terminal: Terminal,
    names: NamesOption = None,
    json_out: JsonOption = None,
    history: HistoryOption = False,
    together: Annotated[
        bool | None,
        typer.Option(
            "--together/--apart",
            help="Solve the vehicles of an image on one ground that is a variable, or each alone.",
            show_default="together in an image, apart in a keypoint file",
        ),
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Processes; for thousands of vehicles see `fgrecon batch`.")] = 1,
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="For images: a results file NAME.json for each of them.")
    ] = None,
    same_camera: Annotated[
        bool,
        typer.Option("--same-camera", help="With --out: one camera took all, whose focal length is not known."),
    ] = False,
    pictures: Annotated[bool, typer.Option("--pictures", help="With --out: a picture NAME.png for each as well.")] = (
        False
    ),
) -> None:
    """Reconstruct the pose and shape of the vehicles in a keypoint file or in images (--box, --boxes or --detect).

    A vehicle that is refused is reported, and the others go on. --verbose tells all messages, energies and times.
    Several images, or a folder of them, need --out: each has a file of its own there, and one that cannot be used does
    not stop the others.

    Exit code 0: at least one was reconstructed, of several images in each; 1: none, since solving failed, or images
    without any; 2: none, since the input is bad, or no car was found in the image.

    Without a camera the focal length is the one in the photograph's EXIF data, or one that its cars tell together.
    """
    from fgrecon.cli import photographs, picture_tasks, reconstruct_work, show
    from fgrecon.cli.doubts import about_fits, about_keypoints
    from fgrecon.cli.picture_tasks import is_image
    from fgrecon.cli.together import grounds_of, solve_together, wants_together
    from fgrecon.core.options import Options, ShapeOptions
    from fgrecon.io.images import read_photograph

    check_outputs(json_out, drawings.animation, picture=drawings.picture)
    drawings.check()
    delivery.check()
    screen = terminal.screen(json_out)
    options = Options(
        strategy=scene.strategy,
        box=solving.box_model or BoxModel.SURFACE,
        shape=ShapeOptions(joint=solving.joint, free_offsets=solving.free_offsets),
        keep_history=history or drawings.wanted or delivery.wanted or pictures,
    )
    settings = scene.settings(options)
    models = car_models.read(settings.prior.category)
    several = photographs.wanted(files, out, boxes.boxes, pictures=pictures)
    if same_camera and (several is None or together is False or not solving.joint):
        fix = "Give several images and --out, and let their vehicles be solved together."
        raise InvalidInputError("same_camera", "without --out, or with --apart or --no-joint", fix)
    in_one_process = several is not None or together or (together is None and solving.joint and is_image(files[0]))
    if jobs > 1 and in_one_process:
        fix = "Leave it out: vehicles of an image are solved together, in one process. For many see `fgrecon batch`."
        raise InvalidInputError("jobs", jobs, fix)
    if several is not None:
        photographs.refuse(
            json_out, drawings.wanted or drawings.image is not None, delivery.wanted, boxes.box, solving.ids
        )
        how = photographs.PhotographWork(
            camera, boxes, settings, solving.box_model, together, models, history, pictures, same_camera
        )
        if not photographs.reconstruct_each(several, how, screen):
            raise typer.Exit(1)
        return
    (file,) = files
    pictured = is_image(file)
    if not pictured:
        boxes.refuse()
    path = file if pictured else drawings.image
    photograph, own = (None, None) if path is None else read_photograph(path, camera.whole)
    source = camera.source(photograph, own)
    ignored: tuple[str, ...] = ()
    if pictured and photograph is not None:
        tasks = picture_tasks.read_image_tasks(
            file, photograph, source, settings.prior.category, boxes, solving.box_model, screen
        )
    else:
        image = None if drawings.image is None else drawings.image.name
        tasks, ignored = reconstruct_work.read_tasks(file, settings.prior.category, source, names, image)
    tasks = solving.chosen(tasks)
    drawings.check_vehicles(tasks)
    doubts = [] if pictured else about_keypoints(tasks)
    if settings.ground is None and tasks:
        shown = tasks[0].instance.image or (None if path is None else path.name)
        screen.print(*reconstruct_work.ground_of(source, shown))
    scenes: list[Scene] = []
    if together is None:
        together = pictured and solving.joint
    if together or wants_together(tasks):
        outcomes, scenes = solve_together(tasks, settings, screen)
    elif jobs == 1:
        outcomes = [reconstruct_work.run(task, settings) for task in screen.watch(tasks, "Vehicles")]
    else:
        with screen.bar() as advance:
            outcomes = reconstruct_work.run_all(
                tasks, settings, jobs, lambda done: advance("Vehicles", done, len(tasks))
            )

    outcomes = with_closest(outcomes, models)
    show.print_table(screen, outcomes)
    for found in scenes:
        screen.print(*found.lines())
        if found.result.camera.focal_sigma:
            screen.warn(about_camera(found.result.camera, own))
    if not pictured:
        for line in doubts or about_fits(outcomes):
            screen.warn(line)
    if ignored:
        screen.print(f"Fields of the file without a meaning here: {', '.join(ignored)}.")
    plain = [scene.plain() for scene in scenes]
    screen.write_json(show.document(file, outcomes, settings, plain, path, history=history))
    grounds = grounds_of(tasks, settings, scenes)
    drawings.draw(outcomes, photograph, grounds, screen)
    if delivery.wanted:
        recordings = show.recordings(outcomes, photograph, grounds)
        delivery.deliver(recordings, screen, several=len(grounds) > 1 or len(recordings) > 1)
    if not reconstruct_work.check_any(file, outcomes):
        screen.fail("No vehicle could be reconstructed.")
        raise typer.Exit(1)
