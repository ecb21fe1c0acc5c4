"""`fgrecon sample`: small inputs for the other commands, from simulation."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fgrecon.cli.terminal import Quiet
from fgrecon.core.choices import BoxModel

if TYPE_CHECKING:  # the command line must start fast: what the command needs is imported when it runs
    from numpy.typing import NDArray

    from fgrecon.core.category import Category
    from fgrecon.core.shape_prior import ShapePrior
    from fgrecon.simulation.sample import SampleStreet, SeenCar


def sample_command(
    terminal: Quiet,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Where to write; made where it does not exist.")] = Path(
        "sample"
    ),
    seed: Annotated[int, typer.Option(min=0, help="Of cars, places, keypoints and scenery.")] = 0,
) -> None:
    """Make small inputs to try the other commands with: a rendered street of three cars, and a track of one.

    Writes street.png, its calibration calib.txt (KITTI's format), a LiDAR's points in street.npz, the cars' keypoints
    as a network would report them in cars.json, their boxes in boxes.txt and a detector's 3D boxes in detections.txt;
    and TRACK.json, one car in eight images with its true poses, and these images in the folder drive.
    """
    import numpy as np

    from fgrecon.core.size_prior import size_prior
    from fgrecon.io.arrays import write_arrays
    from fgrecon.io.catalogue import load_prior
    from fgrecon.io.images import write_png
    from fgrecon.simulation.sample import GROUND, sample_drive, sample_scan, sample_street, sample_track

    screen = terminal.screen()
    prior = load_prior("car14").for_fleet(size_prior("kitti"))  # its cars are of the size that the guides have
    out.mkdir(parents=True, exist_ok=True)
    street, track = sample_street(prior, seed), sample_track(prior, seed=seed)
    screen.wrote(write_png(out / "street.png", street.image))
    scan = sample_scan(street, seed).astype(np.float32)
    screen.wrote(write_arrays(out / "street.npz", compressed=True, points=scan))
    screen.write_text(out / "calib.txt", _calibration(_projection(street)))
    screen.write_text(out / "cars.json", _json(_keypoint_file(street, prior.category)))
    screen.write_text(out / "boxes.txt", _boxes(street, "street.png"))
    screen.write_text(out / "detections.txt", _detections(street, prior, seed))
    screen.write_text(out / "TRACK.json", _json(_track_file(street, track, prior.category)))
    (out / "drive").mkdir(exist_ok=True)
    for number, frame in enumerate(sample_drive(prior, seed=seed)):
        write_png(out / "drive" / f"{number:06d}.png", frame.image)
    screen.wrote(out / "drive")
    screen.print(
        f"Try: fgrecon reconstruct {out / 'cars.json'} --camera-height {GROUND.distance:g} --image "
        f"{out / 'street.png'} --picture {out / 'cars.png'}"
    )


def _json(content: dict[str, Any]) -> str:
    return json.dumps(content, indent=1, allow_nan=False) + "\n"


def _projection(street: SampleStreet) -> NDArray[Any]:
    """(3, 4) K [I | t] of the camera, t from the frame of the labels."""
    import numpy as np

    from fgrecon.simulation.sample import LABEL_OFFSET

    matrix = street.camera.matrix
    return np.column_stack([matrix, matrix @ LABEL_OFFSET])


def _calibration(projection: NDArray[Any]) -> str:
    """A calibration file as KITTI's object set has them; all four cameras are the one that there is."""
    numbers = " ".join(f"{number:.12e}" for number in projection.ravel())
    return "".join(f"P{camera}: {numbers}\n" for camera in range(4))


def _keypoint_file(street: SampleStreet, category: Category) -> dict[str, Any]:
    """What `fgrecon reconstruct` reads."""
    from fgrecon.cli.demo_report import observation_to_dict

    return {
        "K": street.camera.matrix.tolist(),
        "image_size": street.camera.image_size,
        "instances": [
            {"id": f"car-{number}", **observation_to_dict(car.observation, category)}
            for number, car in enumerate(street.cars, start=1)
        ],
    }


def _boxes(street: SampleStreet, image: str) -> str:
    """The cars' boxes as detections, about what is seen of them."""
    boxes = [car.observation.box for car in street.cars]
    texts = [" ".join(f"{x:.2f}" for x in box) for box in boxes if box is not None]
    return "".join(f"{image} 2 0.990 {text} {BoxModel.SURFACE}\n" for text in texts)


def _detections(street: SampleStreet, prior: ShapePrior, seed: int) -> str:
    """The cars as a monocular detector would find them: lines of KITTI's results, in the frame of its labels.

    Its 2D boxes are those of the true 3D boxes, a pixel or two off.
    """
    import numpy as np

    from fgrecon.core.box3d import Box3D, BoxErrors
    from fgrecon.core.geometry import box_around
    from fgrecon.core.reconstruction import rotation_y
    from fgrecon.io.kitti_files import Objects, format_results
    from fgrecon.simulation.keypoint_noise import HOURGLASS
    from fgrecon.simulation.sample import LABEL_OFFSET, disturbed_boxes

    operator = prior.category.dimension_operator
    true = [
        Box3D(
            car.truth.camera_T_object[:3, 3],
            rotation_y(car.truth.camera_T_object),
            np.tensordot(operator, car.truth.vehicle.keypoints, axes=2),
        )
        for car in street.cars
    ]
    rng = np.random.default_rng([seed, 2])
    found = disturbed_boxes(true, street.camera, BoxErrors(), rng)
    rows = []
    for box, exact in zip(found, true, strict=True):
        assert box.size is not None
        corners = box_around(street.camera.project(exact.corners)) + HOURGLASS.box_sigma * rng.standard_normal(4)
        place = box.location - LABEL_OFFSET
        alpha = box.rotation_y - np.arctan2(place[0], place[2])
        rows.append([-1, -1, alpha, *corners, *box.size[::-1], *place, box.rotation_y, 0.9])
    return format_results(Objects.of_rows(["Car"] * len(rows), np.array(rows)))


def _track_file(street: SampleStreet, track: list[SeenCar], category: Category) -> dict[str, Any]:
    """What `fgrecon track` and `fgrecon evaluate tracks` read; see `fgrecon.io.track_file`."""
    return {
        "K": street.camera.matrix.tolist(),
        "P2": _projection(street).tolist(),
        "keypoint_names": list(category.keypoints),
        "frames": [_frame(number, car, category) for number, car in enumerate(track)],
    }


def _frame(number: int, car: SeenCar, category: Category) -> dict[str, Any]:
    import numpy as np

    from fgrecon.core.reconstruction import rotation_y
    from fgrecon.simulation.sample import LABEL_OFFSET

    observation, pose = car.observation, car.truth.camera_T_object
    size = np.tensordot(category.dimension_operator, car.truth.vehicle.keypoints, axes=2)
    return {
        "frame": number,
        "box_xyxy": None if observation.box is None else observation.box.tolist(),
        "keypoints_uv": [uv.tolist() if np.isfinite(uv).all() else [None, None] for uv in observation.keypoints],
        "confidence": observation.confidence.tolist(),
        "gt": {
            "location": (pose[:3, 3] - LABEL_OFFSET).tolist(),
            "rotation_y": rotation_y(pose),
            **dict(zip(("length", "width", "height"), size.tolist(), strict=True)),
        },
    }
