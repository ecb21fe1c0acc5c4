"""The options of `fgrecon reconstruct` as one request."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from fgrecon.cli.commands import option
from fgrecon.cli.options import (
    BOX_MODEL_HELP,
    CameraOptions,
    ClassesOption,
    Delivery,
    HistoryOption,
    JsonOption,
    NamesOption,
    ScaleOption,
    SceneOptions,
    VehicleBoxes,
)
from fgrecon.cli.outputs import check_outputs
from fgrecon.cli.sensor_options import SensorOptions
from fgrecon.core.choices import BoxModel
from fgrecon.core.errors import InvalidInputError

if TYPE_CHECKING:  # the command line must start fast: what the command needs is imported when it runs
    from fgrecon.batch.file_service import FileRequest
    from fgrecon.batch.vehicle_tasks import Watch
    from fgrecon.core.category import Category
    from fgrecon.core.vehicle_mesh import VehicleMesh
    from fgrecon.io.cameras.camera_source import CameraSource
    from fgrecon.io.run_settings import RunSettings


@dataclass(frozen=True)
class Solving:
    """How the vehicles are solved."""

    box_model: BoxModel | None = option(
        BOX_MODEL_HELP, show_default="surface for keypoint files and --box, as --boxes says, detected for --detect"
    )
    classes: ClassesOption = None
    joint: bool = option("Let pose and shape move together.", "--joint/--no-joint", default=True)
    free_offsets: bool = option(
        "Let every keypoint leave the shape prior by a small offset.", "--free-offsets/--no-free-offsets", default=True
    )
    ids: list[str] | None = option(
        "Take only this vehicle of the file or image; may be repeated.", "--id", metavar="NAME"
    )


@dataclass(frozen=True)
class Drawings:
    """What is drawn of the results, and on which photograph."""

    image: Path | None = option("The photograph: to draw on, and for its size.", metavar="FILE")
    picture: Path | None = option("Draw the image and the scene from above (png, svg, pdf, jpg).", metavar="FILE")
    sheet: bool = option(
        "Let --picture have a part of the image for each; of one vehicle the stages.", "--sheet", default=False
    )
    animation: Path | None = option(
        "Animate the optimisation of one vehicle, of several with --id (gif, mp4).", metavar="FILE"
    )

    @property
    def requested(self) -> bool:
        """Whether anything is to be drawn."""
        return self.picture is not None or self.animation is not None


@dataclass(frozen=True)
class CarModels:
    """The models that vehicles are compared with."""

    panel: ClassVar = "Car models"

    models: Path | None = option(
        "Find the closest of these car models (obj, ply, glb, npz), in metres; it is drawn as well.",
        metavar="FOLDER|FILE",
    )
    models_axes: str | None = option(
        "What points forward and up in meshes, such as x,z.", metavar="FORWARD,UP", show_default="x,-y; z,y in glb"
    )

    def read(self, category: Category) -> list[VehicleMesh]:
        """The models; none where none are requested."""
        from fgrecon.io.models import read_models

        if self.models is not None:
            return read_models(self.models, category, self.models_axes)
        if self.models_axes is not None:
            raise InvalidInputError("models_axes", "without --models", "Say with --models where the models are.")
        return []


@dataclass(frozen=True)
class Results:
    """How the results are made, and where they go."""

    names: NamesOption = None
    json_out: JsonOption = None
    history: HistoryOption = False
    together: bool | None = option(
        "Solve the vehicles of an image on one ground that is a variable, or each alone.",
        "--together/--apart",
        show_default="together in an image, apart in a keypoint file",
    )
    scale_to_image: ScaleOption = False
    jobs: int = option("Processes; for thousands of vehicles see `fgrecon batch`.", default=1, min=1)
    out: Path | None = option("For images: a results file NAME.json for each of them.", metavar="FOLDER")
    same_camera: bool = option(
        "With --out: one camera took all, whose focal length is not known.", "--same-camera", default=False
    )
    pictures: bool = option("With --out: a picture NAME.png for each as well.", "--pictures", default=False)


@dataclass(frozen=True)
class ReconstructRequest:
    """What is requested of the files."""

    camera: CameraOptions
    scene: SceneOptions
    solving: Solving
    boxes: VehicleBoxes
    sensors: SensorOptions
    drawings: Drawings
    delivery: Delivery
    car_models: CarModels
    results: Results

    def source(self) -> CameraSource:
        """What is given of the camera."""
        return self.camera.source(scale_to_image=self.results.scale_to_image)

    def check(self) -> None:
        """Refuse before the work what could not be written or drawn after it."""
        from fgrecon.viz.animation import check_format

        drawings = self.drawings
        check_outputs(self.results.json_out, drawings.animation, picture=drawings.picture)
        if drawings.animation is not None:
            check_format(drawings.animation)
        if drawings.sheet and drawings.picture is None:
            raise InvalidInputError("sheet", "without --picture", "Say with --picture where it is to be written.")
        self.delivery.check()

    def check_jobs(self, *, of_image: bool, several: bool) -> None:
        """Refuse what only other inputs can have.

        Args:
            of_image: Whether the only or first file is an image.
            several: Whether there may be several images.
        """
        together, joint = self.results.together, self.solving.joint
        if self.results.same_camera and (not several or together is False or not joint):
            fix = "Give several images and --out, and let their vehicles be solved together."
            raise InvalidInputError("same_camera", "without --out, or with --apart or --no-joint", fix)
        if self.results.jobs > 1 and (several or together or (together is None and joint and of_image)):
            fix = (
                "Leave it out: vehicles of an image are solved together, in one process. For many see `fgrecon batch`."
            )
            raise InvalidInputError("jobs", self.results.jobs, fix)

    def of_one(self, files: Sequence[Path]) -> bool:
        """Whether a single file is meant, whose results do not go to a folder."""
        to_folder = self.results.out is not None or self.results.pictures
        return not to_folder and len(files) == 1 and not files[0].is_dir()

    def of_files(self, watch: Watch) -> FileRequest:
        """What is requested of each file."""
        from fgrecon.batch.file_service import FileRequest

        settings, source = self.settings(), self.source()
        return FileRequest(
            settings=settings,
            source=source,
            boxes=self.boxes.source(),
            weights=self.boxes.weights,
            box_model=self.solving.box_model,
            names=self.results.names,
            sensors=self.sensors.source(source),
            together=self.results.together,
            jobs=self.results.jobs,
            models=self.car_models.read(settings.prior.category),
            watch=watch,
        )

    def settings(self) -> RunSettings:
        """What holds for every vehicle."""
        from fgrecon.core.options import Options, ShapeOptions

        keep = self.results.history or self.results.pictures or self.drawings.requested or self.delivery.requested
        return self.scene.settings(
            Options(
                strategy=self.scene.strategy,
                box=self.solving.box_model or BoxModel.SURFACE,
                shape=ShapeOptions(joint=self.solving.joint, free_offsets=self.solving.free_offsets),
                keep_history=keep,
            ),
            self.solving.classes,
        )
