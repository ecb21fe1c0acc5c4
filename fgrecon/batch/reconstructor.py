"""Tables of vehicles or images in, tables of results out: what every engine that maps tables can call."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike, NDArray

from fgrecon.batch.rows import failed_row, given_of, id_in_image, origin_of, solved_row, table_of
from fgrecon.batch.schema import EMPTY, LEFT_OUT, nested, record_of
from fgrecon.batch.vehicle_tasks import KeypointRequest, check_of_file, tasks_in_boxes
from fgrecon.core.camera import Camera, Ground, lens_of
from fgrecon.core.checks import as_finite
from fgrecon.core.choices import ClassSource
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.input_warnings import (
    InputWarning,
    camera_warning_of,
    input_warning_of,
    result_warning_of,
    summed_up,
)
from fgrecon.core.options import BoxModel, Options, checked_options
from fgrecon.core.shape_prior import ShapePrior
from fgrecon.core.size_prior import SizePrior, SizesLike
from fgrecon.io.boxes import FileBoxes, NamedBox
from fgrecon.io.catalogue import load_prior, load_size_prior
from fgrecon.io.images import decode_photograph, read_photograph
from fgrecon.io.keypoint_file import Instance
from fgrecon.io.keypoints.any_keypoints import parse_any_keypoints
from fgrecon.io.keypoints.names import Names, NamesLike, parse_names
from fgrecon.io.run_settings import RunSettings
from fgrecon.perception.boxes import GivenBoxes, detected_boxes, with_detected_classes
from fgrecon.perception.keypoints.detect import KeypointCascade, check_box, large_enough, shipped_cascade
from fgrecon.perception.keypoints.sessions import at_most
from fgrecon.perception.sensor_source import SensorSource
from fgrecon.perception.vehicles import NanodetVehicleDetector

if TYPE_CHECKING:
    from fgrecon.io.source_frames import SourceFrame
Row = dict[str, Any]


class Reconstructor:
    """Pose and shape of the vehicles of a table: called with a `pyarrow.Table`, it returns one.

    A row is one of these; further columns are left aside:

    - a vehicle: the fields of an instance of a keypoint file as columns (`keypoints`, `confidence`, `box`, `K`, ...),
      or its JSON text in the column `instance`;
    - an image: `image`, a file or the bytes of one, where wanted with `boxes` (x1, y1, x2, y2 of each vehicle's
      outline, unless `options.box` says otherwise) and `camera`, the JSON text of `{"K": ...}`; with `frame` it is a
      video. Without boxes the detector looks for cars.

    `row_id`, `source` and `frame` are taken over. Every row gives at least one row of results (`result_schema`),
    whatever is wrong with it: a vehicle gives one, an image one for each vehicle, or one of status `empty`.

    Prior and networks are loaded at the first call and stay; a pickled reconstructor does not carry them.
    """

    def __init__(
        self,
        *,
        prior: ShapePrior | str | Path = "car14",
        camera: Camera | ArrayLike | None = None,
        ground: Ground | float | None = None,
        size_prior: SizesLike | None = None,
        options: Options | None = None,
        names: NamesLike | None = None,
        weights: str | Path | None = None,
        threads: int | None = None,
        scale_to_image: bool = False,
        sensors: SensorSource | None = None,
        boxes: GivenBoxes | str | Path | None = None,
        classes: ClassSource | None = None,
    ) -> None:
        """Take the settings; nothing is loaded.

        Args:
            prior: Shape prior, or its name, or the path of its file.
            camera: The camera of all rows, which goes before their own; None has each row bring its own. Images that do
                not have the focal length of their EXIF data, or else the one that their vehicles tell.
            ground: Ground plane, or the height in metres of a level camera.
            size_prior: Fleet, or a size prior.
            options: Settings; histories are not kept.
            names: What the keypoints are called, as `fgrecon.keypoints_from` takes it; None where they tell themselves.
            weights: Keypoint network; None for the shipped one.
            scale_to_image: Whether keypoints are scaled to the camera's image where a row states another size of the
                same shape.
            sensors: Other sensors' files, named as the images; or None.
            boxes: Boxes of images: a file or folder as `--boxes` takes it, or also with the least score; None lets the
                detector look.
            classes: Who says of which class vehicles are, which tells their size; None where all are cars.
            threads: Threads that OpenCV and what runs the networks use from the first image on; None leaves them as
                they are.

        Raises:
            InvalidInputError: The camera or the options are none.
        """
        self._prior, self._ground = prior, ground
        self._camera = None if camera is None else Camera.of(camera)
        self._size, self._names = size_prior, names
        self._options = replace(checked_options(options), keep_history=False)
        self._weights, self._threads, self._scale_to_image = weights, threads, scale_to_image
        self._sensors = sensors
        self._boxes = boxes if boxes is None or isinstance(boxes, GivenBoxes) else GivenBoxes(file=Path(boxes))
        self._classes, self._pictures = classes, Pictures()

    def __getstate__(self) -> dict[str, Any]:
        """The settings alone: what is loaded is loaded again elsewhere."""
        loaded = ("prior", "_known_names", "_size_prior", "_networks", "_pictures")
        return {name: value for name, value in vars(self).items() if name not in loaded}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take the settings."""
        vars(self).update(state, _pictures=Pictures())

    @cached_property
    def prior(self) -> ShapePrior:
        """The shape prior.

        Raises:
            InvalidInputError: It cannot be loaded.
        """
        return load_prior(self._prior)

    @cached_property
    def _known_names(self) -> Names | None:
        return None if self._names is None else parse_names(self._names, self.prior.category)

    @cached_property
    def _size_prior(self) -> SizePrior | None:
        return None if self._size is None else load_size_prior(self._size)

    @cached_property
    def _networks(self) -> tuple[NanodetVehicleDetector, KeypointCascade]:
        if self._threads is not None:
            import cv2

            cv2.setNumThreads(self._threads)
        with at_most(self._threads):
            cascade = KeypointCascade(self._weights) if self._weights else shipped_cascade()
        if self._threads is not None and "torch" in sys.modules:  # it runs them, or something else did load it
            sys.modules["torch"].set_num_threads(self._threads)
        return NanodetVehicleDetector(), cascade

    def __call__(self, table: pa.Table) -> pa.Table:
        """The results of a table's rows, in their order."""
        with summed_up():
            rows = [row for position, task in enumerate(table.to_pylist()) for row in self._results(task, position)]
        return table_of(rows)

    def _results(self, task: Mapping[str, Any], position: int) -> list[Row]:
        """The rows of a task; an error of any kind becomes one."""
        origin = origin_of(task, position)
        try:
            return list(self._solve(task, origin))
        except Exception as error:  # noqa: BLE001 - one bad row never ends a run: it becomes a row with its error
            return [failed_row(origin, error)]

    def _solve(self, task: Mapping[str, Any], origin: Row) -> Iterator[Row]:
        if task.get("problem") is not None:
            fix = f"Give a file that can be read: {task['problem']}"
            raise InvalidInputError("source", task.get("source"), fix)
        if task.get("image") is not None:
            yield from self._image(task, origin)
            return
        category = self.prior.category
        record = nested(record_of(task), category.size)
        named = isinstance(record, dict) and record.get("id") is not None
        file = parse_any_keypoints(record, category, self._known_names)
        unknown = "".join(f" Left out: {error}" for error in file.unknown)
        for vehicle, instance in enumerate(file.instances):
            name = instance.name if named or vehicle or isinstance(record, list) else str(origin["row_id"])
            row = self._vehicle(origin, vehicle, name, instance, self._camera or instance.camera)
            yield row | ({"message": f"{row['message']}{unknown}"} if unknown and "message" in row else {})
        for error in file.left_out:
            yield failed_row(origin, error)

    def _vehicle(self, origin: Row, vehicle: int, name: str, instance: Instance, camera: Camera | None) -> Row:
        """The row of one vehicle."""
        from fgrecon.solve.pipeline import reconstruct  # on use: whoever hands out the work needs no solver

        warning: InputWarning | None = None
        try:
            if self._classes is not None:
                check_of_file(self._classes)
                instance = instance.classed
            if camera is None:
                raise InvalidInputError("intrinsics", "nothing", "Give K with the row, or a camera for all of them.")
            instance = instance.fitted(camera.image_size, scale=self._scale_to_image)
            if camera.image_size is None:
                camera = replace(camera, image_size=instance.image_size)
            observation = instance.observation
            warning = input_warning_of(observation, camera)
            result = reconstruct(
                observation,
                camera,
                prior=self.prior,
                ground=self._ground,
                size_prior=self._size_prior,
                initial=instance.initial,
                options=self._options,
            )
        except Exception as error:  # noqa: BLE001 - one bad vehicle must not take the others of its row along
            return failed_row(origin, error, vehicle, name) | given_of(instance) | {"input_warning": warning}
        warning = warning or result_warning_of(observation, result)
        return solved_row(origin, vehicle, name, result, camera) | given_of(instance) | {"input_warning": warning}

    def _image(self, task: Mapping[str, Any], origin: Row) -> Iterator[Row]:
        """A row for each vehicle of an image; they are solved together, as by `fgrecon.reconstruct_image`."""
        from fgrecon.batch.solve_tasks import solve_tasks  # on use: whoever hands out the work needs no solver
        from fgrecon.solve.inputs import as_ground

        image, exif_camera = self._pictures.get(task["image"], task.get("frame"))
        if isinstance(task["image"], str):
            origin = origin | {"image": task["image"]}
        found = self._boxes_in(task, image)
        if not found.cars:
            of_file = self._boxes is not None and self._boxes.file is not None
            yield {**origin, "status": EMPTY, "left_out": [found.left_out] if of_file else []}
            return
        camera, model = self._camera_of(task, image, exif_camera), self._options.box.model
        given_model = None if model is BoxModel.SURFACE else model  # an outline is one as its source draws it
        how = KeypointRequest(self.prior.category, None, given_model, self._networks[1], self._classes)
        evidence = () if self._sensors is None else self._sensors.evidence(_place(task))
        tasks = [replace(one, evidence=evidence) for one in tasks_in_boxes(image, camera, found.cars, how)]
        settings = RunSettings(self.prior, as_ground(self._ground), self._size_prior, self._options)
        outcomes, _ = solve_tasks(tasks, settings, together=self._options.shape.joint)
        for vehicle, one in enumerate(outcomes):
            name = id_in_image(origin["row_id"], vehicle)
            given = given_of(one.task.instance) | {"input_warning": camera_warning_of(camera)}
            if one.result is None:
                assert one.error is not None
                yield failed_row(origin, one.error, vehicle, name) | given | origin
            else:
                yield solved_row(origin, vehicle, name, one.result, one.task.camera) | given | origin
        if notes := found.notes(self.prior.category.name):
            yield {**origin, "status": LEFT_OUT, "left_out": list(notes)}

    def _boxes_in(self, task: Mapping[str, Any], image: NDArray[np.uint8]) -> FileBoxes:
        """The cars of an image: as its row says, as the file of boxes, or as the detector finds them."""
        source, detector = self._boxes or GivenBoxes(), self._networks[0]
        source.check_classes(self._classes)
        if (given := task.get("boxes")) is not None:
            found = FileBoxes(_given(given, image))
        elif source.file is not None:
            scale = self._scale_to_image
            found = source.in_file(_place(task), image, scale_to_image=scale, classes=self._classes)
        else:
            return FileBoxes(detected_boxes(image, source.least_score, detector))
        if self._classes is not ClassSource.DETECTED:
            return found
        return replace(found, cars=with_detected_classes(found.cars, image, detector))

    def _camera_of(self, task: Mapping[str, Any], image: NDArray[np.uint8], exif_camera: Camera | None) -> Camera:
        """The camera of an image, which knows its size; its vehicles tell the focal length where nobody else does."""
        height, width = image.shape[:2]
        text = task.get("camera")
        own = self._camera or (_camera(json.loads(text)) if text else exif_camera)
        return Camera.of_unknown(width, height) if own is None else own.with_size_of(image)


def _place(task: Mapping[str, Any]) -> Path:
    """The file of an image; of a frame of a video its number, and of bytes the row's id, which stand for its name."""
    if task.get("frame") is None and isinstance(task["image"], str):
        return Path(task["image"])
    return Path(str(task["row_id"] if task.get("frame") is None else task["frame"]))


def _camera(fields: Mapping[str, Any]) -> Camera:
    """A camera from the fields that a keypoint file has for it."""
    return Camera(np.array(fields["K"]), **lens_of(fields))


def _given(boxes: Iterable[Iterable[float]], image: NDArray[np.uint8]) -> list[NamedBox]:
    """Boxes that the row brings, of outlines."""
    corners = np.array([list(box) for box in boxes], dtype=np.float64).reshape(-1, 4)
    for number, box in enumerate(corners):
        check_box(as_finite(f"boxes[{number}]", box, (4,)), image, f"boxes[{number}]")
    large = large_enough(corners)
    return [NamedBox(str(number), box, BoxModel.SURFACE) for number, box in enumerate(corners[large])]


class Pictures:
    """Opens images; the video that was read last stays open, since a later frame of it is probably wanted next."""

    def __init__(self) -> None:
        """Nothing is open yet."""
        self._path: str | None = None
        self._frames: Iterator[SourceFrame] = iter(())
        self._next = 0

    def get(self, image: str | bytes, frame: int | None = None) -> tuple[NDArray[np.uint8], Camera | None]:
        """An image (H, W, 3) of RGB bytes, and the camera that its EXIF data tell, or None.

        Args:
            image: File of an image, or of a video where a frame is given; or the bytes of an image file.
            frame: Number of the frame from 0.
        """
        if isinstance(image, bytes):
            return decode_photograph(image, "image")
        if "\0" in image:
            raise InvalidInputError("image", image, "Give the name of a file: none has a null character.")
        return read_photograph(image) if frame is None else (self._frame(image, frame), None)

    def _frame(self, path: str, frame: int) -> NDArray[np.uint8]:
        from fgrecon.io.source_frames import Choice
        from fgrecon.io.video_frames import open_video

        if path != self._path or frame < self._next:
            self._path, self._frames = path, open_video(Path(path), Choice()).read(after=frame - 1)
        self._next = frame + 1
        found = next((one for one in self._frames if one.number == frame), None)
        if found is None or found.image is None:
            problem = f"{path}: it has no frame {frame}" if found is None else found.problem
            raise InvalidInputError("image", path, f"Give a whole video ({problem}).")
        return found.image
