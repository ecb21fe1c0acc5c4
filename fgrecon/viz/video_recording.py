"""Recordings of a video for rerun: images with what was found in them, the cars in space, and their motion as plots.

Timelines are `frame` and `time`. Frames are logged one by one, so that a run can be watched while it goes on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.camera import Camera
from fgrecon.core.geometry import transform
from fgrecon.core.text import whole_text
from fgrecon.viz import style
from fgrecon.viz.geometry import BOX_EDGES, outline_corners
from fgrecon.viz.overlay import Shown
from fgrecon.viz.overview import STATES, named_boxes, state_view
from fgrecon.viz.sinks import APPLICATION, Recording, connected

__all__ = ["LiveRecording", "ShownFrame", "log_shown_frame", "video_recording_of"]

_JPEG = 85  # quality
_IMAGE, _WORLD, _PLOTS, _LOG = "image", "world", "plots", "log"
_CAMERA = f"{_WORLD}/camera"


@dataclass(frozen=True, eq=False)
class ShownFrame:
    """One frame as it is recorded.

    Attributes:
        number: Of the frame.
        time: Seconds.
        image: (H, W, 3) RGB bytes, or None.
        vehicles: What it shows.
        world_T_camera: (4, 4) pose of the camera; None takes the camera's frame for the world.
        problem: Why it could not be read, or None.
        values: What is plotted of each vehicle, by its id: name and numbers, such as a value and its band.
        states: What becomes of each vehicle, by its id: a word or two; None for one that is no longer seen.
    """

    number: int
    time: float
    image: NDArray[np.uint8] | None
    vehicles: tuple[Shown, ...] = ()
    world_T_camera: NDArray[np.float64] | None = None
    problem: str | None = None
    values: Mapping[int, Mapping[str, tuple[float, ...]]] = field(default_factory=dict)
    states: Mapping[int, str | None] = field(default_factory=dict)


class LiveRecording:
    """A recording that a viewer shows while it grows."""

    def __init__(self, name: str, address: str, camera: Camera) -> None:
        """Begin it.

        Args:
            name: Of the recording.
            address: `host:port` of a viewer that listens.
            camera: The camera.

        Raises:
            InvalidInputError: Nobody listens there.
        """
        self._stream = connected(f"{APPLICATION}: {name}", address, _layout())
        self._camera = camera

    def add(self, frame: ShownFrame) -> None:
        """Send one more frame."""
        log_shown_frame(self._stream, frame, self._camera)

    def end(self) -> None:
        """Send what is left, and leave the viewer."""
        self._stream.flush()
        self._stream.disconnect()


def video_recording_of(frames: Callable[[], Iterable[ShownFrame]], camera: Camera) -> Recording:
    """The recording of a video.

    Args:
        frames: Makes the frames, in order; asked when the recording is made.
        camera: The camera.
    """

    def make() -> Callable[[Any], None]:
        def send(stream: Any) -> None:
            for frame in frames():
                log_shown_frame(stream, frame, camera)

        return send

    return Recording(make, _layout, in_memory=False)


def log_shown_frame(stream: Any, frame: ShownFrame, camera: Camera) -> None:
    """Log one frame into a `rerun.RecordingStream`; what was seen before and is not now is cleared."""
    import rerun as rr

    stream.set_time("frame", sequence=frame.number)
    stream.set_time("time", duration=frame.time)
    if frame.problem is not None:
        stream.log(_LOG, rr.TextLog(whole_text(frame.problem), level=rr.TextLogLevel.WARN))
    if frame.image is not None:
        stream.log(_IMAGE, rr.EncodedImage(contents=_jpeg(frame.image), media_type="image/jpeg"))
    seen = [vehicle for vehicle in frame.vehicles if vehicle.result is not None]
    stream.log(f"{_IMAGE}/boxes", named_boxes(frame.vehicles))
    world_T_camera = np.eye(4) if frame.world_T_camera is None else frame.world_T_camera
    stream.log(_CAMERA, rr.Transform3D(translation=world_T_camera[:3, 3], mat3x3=world_T_camera[:3, :3]))
    size = camera.image_size
    pinhole = rr.Pinhole(
        image_from_camera=camera.matrix,
        resolution=size,
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=2.0,
    )
    stream.log(_CAMERA, pinhole)
    flat, solid, flat_colours, solid_colours, trails, trail_colours = [], [], [], [], [], []
    for vehicle in seen:
        result, colour = vehicle.result, style.categorical(vehicle.identity)
        assert result is not None
        flat += list(result.wireframe_uv[result.edges])
        flat_colours += [colour] * len(result.edges)
        world_T_object = world_T_camera @ result.camera_T_object
        lines = [*outline_corners(result.box_size)[BOX_EDGES], *result.wireframe[result.edges]]
        solid += [transform(world_T_object, line) for line in lines]
        solid_colours += [colour] * len(lines)
        if vehicle.trail is not None and len(vehicle.trail) > 1:
            trails.append(transform(world_T_camera, vehicle.trail))
            trail_colours.append(colour)
    stream.log(f"{_IMAGE}/wireframes", rr.LineStrips2D(flat, colors=flat_colours))
    stream.log(f"{_WORLD}/cars", rr.LineStrips3D(solid, colors=solid_colours))
    stream.log(f"{_WORLD}/paths", rr.LineStrips3D(trails, colors=trail_colours))
    for identity, values in frame.values.items():
        for name, numbers in values.items():
            stream.log(f"{_PLOTS}/{name}/{identity}", rr.Scalars(numbers))
    for identity, state in frame.states.items():
        stream.log(f"{STATES}/{identity}", rr.StateChange(state=[state]))


def _layout() -> Any:
    """Image and space above, plots and words below."""
    import rerun.blueprint as rrb

    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                rrb.Spatial2DView(origin=_IMAGE, name="Image"),
                rrb.Spatial3DView(origin=_WORLD, name="Space"),
            ),
            rrb.Horizontal(
                *(
                    rrb.TimeSeriesView(origin=f"{_PLOTS}/{name}", name=name.replace("_", " "))
                    for name in ("yaw", "length", "distance", "speed", "facing_probability")
                ),
                rrb.Vertical(
                    state_view(),
                    rrb.TextLogView(origin=_LOG, name="Gaps"),
                ),
            ),
            row_shares=[3, 1],
        ),
        collapse_panels=True,
    )


def _jpeg(image: NDArray[np.uint8]) -> bytes:
    import cv2

    flags = [cv2.IMWRITE_JPEG_QUALITY, _JPEG]
    return bytes(cv2.imencode(".jpg", np.ascontiguousarray(image[..., ::-1]), flags)[1])
