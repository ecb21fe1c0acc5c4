"""Options of several commands, each declared once: alone, or in a group that a command takes as one parameter.

See `fgrecon.cli.commands` for how a group becomes options.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fgrecon.cli.common import chosen_boxes, ground_plane, parse_crop
from fgrecon.core.choices import StrategyName, TrafficSide

if TYPE_CHECKING:  # the command line must start fast: what the commands need is imported when they run
    from collections.abc import Callable

    from numpy.typing import NDArray

    from fgrecon.calibration.setup import SceneKnowledge
    from fgrecon.cli.settings import CameraSource, Settings
    from fgrecon.core.camera import Camera, Ground
    from fgrecon.core.options import Options
    from fgrecon.core.size_prior import SizePrior
    from fgrecon.io.boxes import NamedBox

__all__ = [
    "BOX_MODEL_HELP",
    "KITTI_CAMERA_HEIGHT",
    "UNTOLD",
    "CameraOptions",
    "DataOption",
    "HistoryOption",
    "JsonOption",
    "LabelledScene",
    "MarkdownOption",
    "NamesOption",
    "ResultsOption",
    "SceneOptions",
    "TogetherOption",
    "Told",
    "TrafficOption",
    "VehicleBoxes",
    "WeightsOption",
    "fitting_names",
]

KITTI_CAMERA_HEIGHT = 1.65
"""Height of KITTI's cameras above the road, metres."""

UNTOLD = "none"
"""Where images are evaluated: nothing is told of the ground, or of the fleet's size."""

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

CalibOption = Annotated[Path | None, typer.Option(metavar="FILE", help="KITTI calibration file; its P2 is the camera.")]
CameraOption = Annotated[
    str | None,
    typer.Option(metavar="FILE[#NAME]", help="Calibration: KITTI, ROS, OpenCV, nuScenes, Waymo, or K in JSON."),
]
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
JsonOption = Annotated[
    str | None, typer.Option("--json", metavar="FILE", help="Write the results as JSON; - for the output.")
]
HistoryOption = Annotated[
    bool, typer.Option("--history", help="Keep every step of the optimisation and its graph in the JSON.")
]
MarkdownOption = Annotated[
    Path | None, typer.Option("--markdown", metavar="FILE", help="Write the tables as Markdown.")
]
ResultsOption = Annotated[
    Path | None,
    typer.Option("--results", metavar="FOLDER", help="Write the boxes as KITTI's results, for `evaluate boxes`."),
]
DataOption = Annotated[Path, typer.Option(metavar="FOLDER", envvar="FGRECON_DATA", help="Folder of the data.")]
DATA = Path("../shared/data")
"""Where the data lie if nobody says."""


TogetherOption = Annotated[
    bool,
    typer.Option(
        "--together/--apart", help="Solve the vehicles of an image on one ground that is a variable, or each alone."
    ),
]


@dataclass(frozen=True)
class CameraOptions:
    """The camera, where the input does not say."""

    calib: CalibOption = None
    intrinsics: Annotated[
        str | None, typer.Option(metavar="FX,FY,CX,CY", help="Camera in pixels.", show_default="from the file")
    ] = None
    distortion: Annotated[
        str | None, typer.Option(metavar="K1,K2,P1,P2,...", help="OpenCV's distortion coefficients.")
    ] = None
    camera: CameraOption = None
    crop: Annotated[
        str | None,
        typer.Option(
            metavar="LEFT,TOP[,W,H]",
            help="The image is a part of another (of W x H pixels) from there on; the camera is that one's.",
            show_default="the whole image",
        ),
    ] = None

    @property
    def whole(self) -> tuple[int, int] | None:
        """(width, height) of the image that a photograph is a part of, or None.

        Raises:
            InvalidInputError: It is no part of an image.
        """
        return None if self.crop is None else parse_crop(self.crop).whole

    def source(self, image: NDArray[Any] | None = None, own: Camera | None = None) -> CameraSource:
        """The camera as the commands use it.

        Args:
            image: (H, W, 3) photograph, which tells the image's size.
            own: The camera that the photograph's file tells.
        """
        from fgrecon.cli.settings import CameraSource

        return CameraSource(self.calib, self.intrinsics, self.distortion, image, self.camera, own, self.crop)


@dataclass(frozen=True)
class SceneOptions:
    """What is known about the vehicles, and how keypoints are weighted."""

    prior: PriorOption = "car14"
    camera_height: Annotated[
        float | None,
        typer.Option(help="Height of a level camera above the ground, m.", show_default="no ground plane"),
    ] = None
    ground: GroundOption = None
    size_prior: Annotated[
        str | None,
        typer.Option(
            metavar="FLEET",
            help="How large vehicles are: kitti, apollo79, or length,width,height[,their spreads] in m.",
            show_default="as in the shape prior",
            autocompletion=FLEETS,
        ),
    ] = None
    traffic: TrafficOption = None
    strategy: Annotated[StrategyName, typer.Option(help="Robust strategy.")] = StrategyName.MIXTURE
    min_confidence: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Keypoints of less confidence count as not measured.")
    ] = 0.0
    calibration: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="How far to trust the keypoint network: what `fgrecon calibrate` wrote.",
            show_default="of the shipped ones",
        ),
    ] = None

    def settings(self, options: Options) -> Settings:
        """What holds for every vehicle of a run.

        Raises:
            InvalidInputError: A value names nothing, or both a plane and a height are given.
        """
        from fgrecon.cli.settings import Settings

        keypoints = replace(options.keypoints, least_confidence=self.min_confidence)
        told = replace(options, keypoints=keypoints, traffic=self.traffic)
        if self.calibration is not None:
            from fgrecon.io.catalogue import load_calibration

            told = load_calibration(self.calibration).applied(told)
        return Settings.of(self.prior, self.ground, self.camera_height, self.size_prior, told)


@dataclass(frozen=True)
class LabelledScene:
    """What methods are told on data with known poses."""

    prior: PriorOption = "car14"
    size_prior: Annotated[
        str,
        typer.Option(
            metavar="FLEET",
            help="Size of the fleet: kitti, apollo79 or length,width,height in m; for images also none.",
            autocompletion=FLEETS,
        ),
    ] = _KITTI
    camera_height: Annotated[
        float | None,
        typer.Option(help="Height of a level camera above the ground, m.", show_default=str(KITTI_CAMERA_HEIGHT)),
    ] = None
    ground: Annotated[
        str | None,
        typer.Option(
            metavar="NX,NY,NZ,D|none",
            help="Ground plane instead: normal pointing down, camera height in m; for images also none.",
        ),
    ] = None

    def plane(self) -> tuple[Ground, str]:
        """The ground plane, and in words where it comes from.

        Raises:
            InvalidInputError: Both a plane and a height are given, or one is not a plane.
        """
        from fgrecon.core.camera import Ground

        return ground_plane(self.ground, self.camera_height) or (
            Ground.level(KITTI_CAMERA_HEIGHT),
            f"level camera {KITTI_CAMERA_HEIGHT} m above the ground (KITTI's)",
        )

    def scene(self) -> SceneKnowledge:
        """The scene as methods are bound to it, whose names say what each is told of it.

        Raises:
            InvalidInputError: A value names nothing.
        """
        from fgrecon.calibration.setup import SceneKnowledge
        from fgrecon.core.size_prior import size_prior
        from fgrecon.io.catalogue import load_prior

        return SceneKnowledge(prior=load_prior(self.prior), ground=self.plane()[0], size=size_prior(self.size_prior))

    def told(self) -> Told:
        """What the whole system is told of images: ground and fleet may be none.

        Raises:
            InvalidInputError: A value names nothing.
        """
        untold = self.ground == UNTOLD
        if untold and self.camera_height is not None:
            ground_plane(self.ground, self.camera_height)  # refuses both
        known = replace(
            self,
            ground=None if untold else self.ground,
            size_prior=_KITTI if self.size_prior == UNTOLD else self.size_prior,
        )
        scene = known.scene()
        return Told(
            scene=scene,
            ground=None if untold else scene.ground,
            size=None if self.size_prior == UNTOLD else scene.size,
            origin="no ground plane" if untold else known.plane()[1],
        )


@dataclass(frozen=True)
class Told:
    """What the whole system is told of images with known poses.

    Attributes:
        scene: What rivals are told whose names ask for it: KITTI's ground and fleet where the system is told none.
        ground: Ground plane, or None.
        size: Size of the fleet, or None.
        origin: In words where the ground plane comes from.
    """

    scene: SceneKnowledge
    ground: Ground | None
    size: SizePrior | None
    origin: str


@dataclass(frozen=True)
class VehicleBoxes:
    """Where the cars of an image are, and the network that finds their keypoints."""

    box: Annotated[
        list[str] | None,
        typer.Option("--box", metavar="X1,Y1,X2,Y2", help="2D box of a car's outline, pixels; repeat for more."),
    ] = None
    boxes: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE|FOLDER",
            help="Boxes of outlines (COCO, YOLO), of projected 3D boxes (KITTI, nuScenes, lines of detections without "
            "a word) or as lines say; a folder: a file per image.",
        ),
    ] = None
    detect: Annotated[bool, typer.Option("--detect", help="Find the cars in the image with the shipped detector.")] = (
        False
    )
    min_score: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            max=1.0,
            help="Boxes of a lower score are left out.",
            show_default="0.5 in files, the detector's own otherwise",
        ),
    ] = None
    weights: WeightsOption = None

    def choose(self, path: Path, image: NDArray[Any]) -> list[NamedBox]:
        """The cars of an image.

        Args:
            path: The image's file.
            image: (H, W, 3) its pixels.

        Raises:
            InvalidInputError: Not exactly one of the ways is given, a box is none, or there is no car.
        """
        return chosen_boxes(path, image, self.box, self.boxes, detect=self.detect, least_score=self.min_score)

    def refuse(self) -> None:
        """Refuse what means nothing for a keypoint file.

        Raises:
            InvalidInputError: Something is given.
        """
        from fgrecon.core.errors import InvalidInputError

        names = ("box", "boxes", "weights", "detect", "min_score")
        given = [(name, getattr(self, name)) for name in names]
        for field, value in given:
            if value:
                raise InvalidInputError(field, str(value), "Give an image instead of keypoints, or leave this out.")
