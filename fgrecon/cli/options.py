"""Options of several commands, each declared once: alone, or in a group that a command takes as one parameter.

See `fgrecon.cli.commands` for how a group becomes options.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import typer

from fgrecon.cli.commands import option
from fgrecon.core.choices import BoxModel, ClassSource, StrategyName, TrafficSide
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.parsing import parse_ground, parse_numbers

if TYPE_CHECKING:  # the command line must start fast: what the commands need is imported when they run
    from collections.abc import Callable, Sequence

    from fgrecon.calibration.labelled_drives import DriveRequest, GivenScene, ScoredDrives
    from fgrecon.calibration.labelled_frames import Rivals, SceneKnowledge
    from fgrecon.cli.terminal import Screen
    from fgrecon.core.box3d import BoxErrors
    from fgrecon.core.camera import Ground
    from fgrecon.core.options import Options
    from fgrecon.io.cameras.camera_source import CameraSource, PartOfImage
    from fgrecon.io.kitti_files import Drive
    from fgrecon.io.run_settings import RunSettings
    from fgrecon.perception.boxes import GivenBoxes
    from fgrecon.viz import Recording

KITTI_CAMERA_HEIGHT = 1.65
"""Height of KITTI's cameras above the road, metres."""

NOT_GIVEN = "none"
"""Where images are evaluated: the ground, or the fleet's size, is not known."""

_KITTI = "kitti"

BOX_MODEL_HELP = (
    "What 2D boxes enclose: the outline, exactly or as the shipped detector draws it, or the 3D box; off: they are no "
    "evidence."
)


def fitting_names(names: Callable[[], list[str]]) -> Callable[[str], list[str]]:
    """A shell completion from names that are looked up when the shell asks; paths are left to the shell."""

    def complete(incomplete: str) -> list[str]:
        return [name for name in names() if name.startswith(incomplete)]

    return complete


def _priors() -> list[str]:
    from fgrecon.io.catalogue import shipped_priors

    return list(shipped_priors())


def _fleets() -> list[str]:
    from fgrecon.core.size_prior import SIZE_PRIORS

    return list(SIZE_PRIORS)


PRIORS, FLEETS = fitting_names(_priors), fitting_names(_fleets)

NamesOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|FILE|A=B,...",
        help="What the keypoints are called: apollo24, apollo66, carfusion, pascal12; pairs theirs=ours; or a file.",
        show_default="from the file",
    ),
]
PriorOption = Annotated[
    str, typer.Option(help="Shape prior: a shipped name or an npz file.", autocompletion=PRIORS, metavar="NAME|FILE")
]
PriorArgument = Annotated[
    str, typer.Argument(help="Shape prior: a shipped name or an npz file.", autocompletion=PRIORS, metavar="NAME|FILE")
]
GroundOption = Annotated[
    str | None,
    typer.Option(
        metavar="NX,NY,NZ,D|D",
        help="Ground plane instead: normal pointing down, camera height in m; or the height alone, of a tilted camera.",
    ),
]
TrafficOption = Annotated[
    TrafficSide | None,
    typer.Option(
        help="Side of the road that traffic keeps to, of a camera that looks along it: says which way vehicles face.",
        show_default="nothing said",
    ),
]
WeightsOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Keypoint network; `photographs` is a shipped one that learnt from no image of KITTI.",
        show_default="the shipped one",
    ),
]
MinScoreOption = Annotated[
    float | None,
    typer.Option(
        min=0.0,
        max=1.0,
        help="Boxes of a lower score are left out.",
        show_default="0.5 in files, the detector's own otherwise",
    ),
]
ClassesOption = Annotated[
    ClassSource | None,
    typer.Option(
        help="Take vehicles in the size of their class, as their file, the vehicle detector or the keypoint networks "
        "say it; vans, lorries, buses and trams of a file are then taken as well.",
        show_default="all are cars",
    ),
]
JsonOption = Annotated[
    str | None, typer.Option("--json", metavar="FILE", help="Write the results as JSON; - for the output.")
]
HistoryOption = Annotated[
    bool, typer.Option("--history", help="Keep every step of the optimisation and its graph in the JSON.")
]
TogetherOption = Annotated[
    bool,
    typer.Option(
        "--together/--apart", help="Solve the vehicles of an image on one ground that is a variable, or each alone."
    ),
]


ScaleOption = Annotated[
    bool,
    typer.Option(
        "--scale-to-image",
        help="Scale keypoints and boxes where their file states another size of the image, of the same shape.",
    ),
]


@dataclass(frozen=True)
class CameraOptions:
    """The camera, where the input does not say."""

    calib: Path | None = option("KITTI calibration file; its P2 is the camera.", metavar="FILE")
    intrinsics: str | None = option("Camera in pixels.", metavar="FX,FY,CX,CY", show_default="from the file")
    distortion: str | None = option("OpenCV's distortion coefficients.", metavar="K1,K2,P1,P2,...")
    camera: str | None = option(
        "Calibration: KITTI, ROS, OpenCV, nuScenes, Waymo, or K in JSON.", metavar="FILE[#NAME]"
    )
    crop: str | None = option(
        "The image is a part of another (of W x H pixels) from there on; the camera is that one's.",
        metavar="LEFT,TOP[,W,H]",
        show_default="the whole image",
    )

    def source(self, *, scale_to_image: bool = False) -> CameraSource:
        """The camera as the library takes it.

        Args:
            scale_to_image: Whether keypoints and boxes of a file of another size are scaled to the image's.
        """
        from fgrecon.io.cameras.camera_source import CameraSource

        def numbers(name: str, expected: str, *counts: int) -> list[float] | None:
            text = getattr(self, name)
            return None if text is None else parse_numbers(name, text, expected, counts)

        order = "4, 5, 8, 12 or 14 numbers in OpenCV's order: k1,k2,p1,p2[,k3,...]"
        return CameraSource(
            calib=self.calib,
            intrinsics=numbers("intrinsics", "fx,fy,cx,cy: four numbers in pixels", 4),
            distortion=numbers("distortion", order, 4, 5, 8, 12, 14),
            file=self.camera,
            crop=None if self.crop is None else parse_crop(self.crop),
            scale_to_image=scale_to_image,
        )


def parse_crop(text: str) -> PartOfImage:
    """What `--crop` says."""
    from fgrecon.io.cameras.camera_source import PartOfImage

    expected = "left,top or left,top,width,height: the part's corner, and the size of the whole image, in pixels"
    left, top, *size = parse_numbers("crop", text, expected, (2, 4))
    if min(left, top) < 0:
        raise InvalidInputError("crop", text, f"Give {expected}.")
    if not all(side >= 1 and side == round(side) for side in size):
        raise InvalidInputError("crop", text, "Give width and height in whole pixels.")
    return PartOfImage(left, top, (int(size[0]), int(size[1])) if size else None)


@dataclass(frozen=True)
class SceneOptions:
    """What is known about the vehicles, and how keypoints are weighted."""

    prior: PriorOption = "car14"
    camera_height: float | None = option(
        "Height of a level camera above the ground, m (in Python `ground=HEIGHT`).", show_default="no ground plane"
    )
    ground: GroundOption = None
    size_prior: str | None = option(
        "How large vehicles are: kitti, kitti_traffic (with vans), apollo79, a JSON file of classes, or "
        "length,width,height[,their spreads] in m.",
        metavar="FLEET",
        show_default="as in the shape prior",
        autocompletion=FLEETS,
    )
    traffic: TrafficOption = None
    strategy: StrategyName = option("Robust strategy.", default=StrategyName.MIXTURE)
    min_confidence: float = option("Keypoints of less confidence count as not measured.", default=0.0, min=0.0, max=1.0)
    calibration: Path | None = option(
        "How far to trust the keypoint network: what `fgrecon calibrate` wrote.",
        metavar="FILE",
        show_default="of the shipped ones",
    )

    def settings(self, options: Options, classes: ClassSource | None = None) -> RunSettings:
        """What holds for every vehicle of a run.

        Args:
            options: How they are solved, without what is said here.
            classes: Who says of which class they are, or None.
        """
        from fgrecon.io.run_settings import RunSettings

        keypoints = replace(options.keypoints, least_confidence=self.min_confidence)
        options = replace(options, keypoints=keypoints, traffic=self.traffic)
        if self.calibration is not None:
            from fgrecon.io.catalogue import load_calibration

            options = load_calibration(self.calibration).applied(options)
        plane = parse_ground(self.ground, self.camera_height)
        ground = None if plane is None else plane[0]
        return replace(RunSettings.of(self.prior, ground, self.size_prior, options), classes=classes)


@dataclass(frozen=True)
class LabelledScene:
    """What is known of the scene on data with known poses."""

    prior: PriorOption = "car14"
    size_prior: str = option(
        "Size of the fleet: kitti, kitti_traffic, apollo79 or length,width,height in m; for images also none.",
        default=_KITTI,
        metavar="FLEET",
        autocompletion=FLEETS,
    )
    camera_height: float | None = option(
        "Height of a level camera above the ground, m (in Python `ground=HEIGHT`).",
        show_default=str(KITTI_CAMERA_HEIGHT),
    )
    ground: str | None = option(
        "Ground plane instead: normal pointing down, camera height in m; for images also none.",
        metavar="NX,NY,NZ,D|none",
    )

    def plane(self) -> tuple[Ground, str]:
        """The ground plane, and in words where it comes from."""
        from fgrecon.core.camera import Ground

        return parse_ground(self.ground, self.camera_height) or (
            Ground.level(KITTI_CAMERA_HEIGHT),
            f"level camera {KITTI_CAMERA_HEIGHT} m above the ground (KITTI's)",
        )

    def scene(self) -> SceneKnowledge:
        """The scene as methods are bound to it, whose names say what each knows of it."""
        from fgrecon.calibration.labelled_frames import SceneKnowledge
        from fgrecon.io.catalogue import load_prior, load_size_prior

        return SceneKnowledge(
            prior=load_prior(self.prior), ground=self.plane()[0], size=load_size_prior(self.size_prior)
        )

    def given(self) -> GivenScene:
        """What is given to the whole system of images: ground and fleet may be none."""
        from fgrecon.calibration.labelled_drives import GivenScene

        groundless = self.ground == NOT_GIVEN
        if groundless and self.camera_height is not None:
            parse_ground(self.ground, self.camera_height)  # refuses both
        known = replace(
            self,
            ground=None if groundless else self.ground,
            size_prior=_KITTI if self.size_prior == NOT_GIVEN else self.size_prior,
        )
        scene = known.scene()
        return GivenScene(
            scene=scene,
            ground=None if groundless else scene.ground,
            size=None if self.size_prior == NOT_GIVEN else scene.size,
            origin="no ground plane" if groundless else known.plane()[1],
        )


@dataclass(frozen=True)
class VehicleBoxes:
    """Where the cars of an image are (else the detector finds them), and the network that finds their keypoints."""

    box: list[str] | None = option(
        "2D box of a car's outline, pixels; repeat for more.", "--box", metavar="X1,Y1,X2,Y2"
    )
    boxes: Path | None = option(
        "Boxes of outlines (COCO, YOLO), of projected 3D boxes (KITTI, nuScenes, lines of detections without "
        "a word) or as lines say; a folder: a file per image.",
        metavar="FILE|FOLDER",
    )
    detect: bool = option("Find the cars in the image with the shipped detector.", "--detect", default=False)
    min_score: MinScoreOption = None
    weights: WeightsOption = None

    def source(self) -> GivenBoxes:
        """Where the boxes are from."""
        from fgrecon.perception.boxes import GivenBoxes

        given = [parse_numbers("box", text, "x1,y1,x2,y2: four numbers in pixels", (4,)) for text in self.box or ()]
        return GivenBoxes(given, self.boxes, self.detect, self.min_score)

    def refuse(self, file: Path) -> None:
        """Refuse what means nothing for a file that is no image."""
        from fgrecon.io.images import IMAGES, refuse_unread

        refuse_unread(file, "file")
        for field in ("box", "boxes", "weights", "detect", "min_score"):
            if value := getattr(self, field):
                fix = f"Give an image ({', '.join(IMAGES)}) instead, or leave this out."
                raise InvalidInputError(field, f"{value} for {file.name}", fix)


@dataclass(frozen=True)
class BoxErrorOptions:
    """How far 3D boxes are off; the defaults are a monocular detector's."""

    panel: ClassVar = "Errors of the boxes (1 sigma)"

    depth_error: float = option("Of the distance, as a share of it.", default=0.06)
    bearing_error: float = option("Of a box's place in the image, pixels.", default=2.0)
    yaw_error: float = option("Of the yaw of a box without a heading flip, degrees.", default=10.0)
    size_error: float = option("Of length, width and height, as a share.", default=0.05)
    flipped_share: float = option("Share of boxes with a heading flip.", default=0.05)

    def errors(self) -> BoxErrors:
        """They, as the solver takes them."""
        from fgrecon.core.box3d import BoxErrors

        return BoxErrors(
            self.depth_error, self.bearing_error, radians(self.yaw_error), self.size_error, self.flipped_share
        )


DrivesArgument = Annotated[
    list[Path],
    typer.Argument(
        metavar="DRIVE",
        help="Folders with image_02, calib.txt and label_02.txt of KITTI's tracking set; where nothing is followed "
        "also with image_2, calib and label_2 of its object set.",
    ),
]
FoldOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="DRIVE[,DRIVE...]=FILE",
        help="Keypoint network for these drives, such as one that was trained without them; repeat for more.",
    ),
]


@dataclass(frozen=True)
class DriveOptions:
    """How labelled drives are reconstructed."""

    weights: WeightsOption = None
    fold: FoldOption = None
    box_model: BoxModel | None = option("What the 2D boxes enclose.", show_default="cuboid; detected for --detect")
    together: TogetherOption = True
    traffic: TrafficOption = None
    detect: bool = option(
        "Look at the boxes of the shipped vehicle detector instead of the labelled ones.", "--detect", default=False
    )
    classes: ClassSource | None = option(
        "Take each vehicle in the size of its class, as its label or a network says it."
    )
    jobs: int = option("Processes.", default=1, min=1)

    def request(self, folders: Sequence[Path], labelled: LabelledScene) -> DriveRequest:
        """What is requested of the drives in some folders."""
        from fgrecon.calibration.labelled_drives import DriveRequest

        options = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "fold"}
        return DriveRequest(folders, labelled.given(), folds=self.fold or (), **options)

    def score(
        self,
        folders: Sequence[Path],
        labelled: LabelledScene,
        screen: Screen,
        *,
        read: Callable[[Path], Drive] | None = None,
        rivals: Callable[[SceneKnowledge], Callable[[], Rivals]] | None = None,
    ) -> ScoredDrives:
        """Reconstruct the labelled boxes that count, and score them; see `fgrecon.calibration.labelled_drives`."""
        from fgrecon.calibration.labelled_drives import score_drives
        from fgrecon.io.datasets import open_drive

        with screen.bar() as advance:
            return score_drives(self.request(folders, labelled), advance, read=read or open_drive, rivals=rivals)


@dataclass(frozen=True)
class Viewer:
    """The rerun viewer that a recording is sent to."""

    panel: ClassVar = "Recording"

    connect: str | None = option("Send the recording to a rerun viewer that listens there.", metavar="HOST:PORT")
    spawn: bool = option("Show the recording in a new rerun viewer.", "--spawn", default=False)

    @property
    def requested(self) -> bool:
        """Whether any of the options is given."""
        return self.connect is not None or self.spawn


@dataclass(frozen=True)
class Delivery(Viewer):
    """Where recordings go."""

    save: Path | None = option(
        "Record for the rerun viewer; several recordings: FILE-NAME.rrd each.", metavar="FILE.rrd"
    )

    @property
    def requested(self) -> bool:
        """Whether any of the options is given."""
        return self.save is not None or super().requested

    def check(self) -> None:
        """Refuse before the work what could not be delivered after it (`InvalidInputError`)."""
        from fgrecon.viz.sinks import check_delivery

        check_delivery(self.save, self.connect)

    def deliver(self, recordings: Sequence[tuple[str, Recording]], screen: Screen, *, several: bool) -> None:
        """Write and send recordings, and say which files were written."""
        from fgrecon.viz.sinks import deliver

        screen.wrote(*deliver(recordings, self.save, self.connect, spawn=self.spawn, several=several))
