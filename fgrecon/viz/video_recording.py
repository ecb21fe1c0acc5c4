"""Recordings of a video for rerun: images with boxes and wireframes, the cars in space, and their motion as plots.

The names are those of `fgrecon.viz.entities`. Frames are logged one by one, so that a run can be watched while it goes
on.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from itertools import chain
from typing import Any

import numpy as np
import rerun as rr

from fgrecon.core.arrays import Array
from fgrecon.core.camera import Camera
from fgrecon.core.geometry import transform
from fgrecon.core.text import whole_text
from fgrecon.viz import entities, style
from fgrecon.viz.blueprint import video_blueprint
from fgrecon.viz.factor_graph import graph_archetypes, lay_out
from fgrecon.viz.geometry import BOX_EDGES, NOSE, outline_corners
from fgrecon.viz.scene_recording import named_boxes
from fgrecon.viz.sinks import APPLICATION, Recording, connected
from fgrecon.viz.subjects import DrawnVehicle, RecordedFrame, jpeg

_JPEG = 85  # quality
_RING, _RINGS = 10.0, 5  # metres between circles, and how many there are
_BAND = 0.75  # width of the lines of a band; the value between them has 2


class LiveRecording:
    """A recording that a viewer shows while it grows."""

    def __init__(self, name: str, address: str, camera: Camera) -> None:
        """Begin it.

        Args:
            name: Of the recording.
            address: `host:port` of a viewer that listens.

        Raises:
            InvalidInputError: Nobody listens there.
        """
        self._stream = connected(f"{APPLICATION}: {name}", address, video_blueprint())
        self._log = _FrameLog(self._stream, camera)

    def add(self, frame: RecordedFrame) -> None:
        """Send one more frame."""
        self._log.add(frame)
        self._log.send_plots()

    def end(self) -> None:
        """Send what is left, and leave the viewer."""
        self._stream.flush()
        self._stream.disconnect()


def video_recording_of(frames: Callable[[], Iterable[RecordedFrame]], camera: Camera) -> Recording:
    """The recording of a video, whose frames are made in order when the recording is."""

    def make() -> Callable[[Any], None]:
        def send(stream: Any) -> None:
            log = _FrameLog(stream, camera)
            for frame in frames():
                log.add(frame)
            log.send_plots()

        return send

    return Recording(make, video_blueprint, in_memory=False)


class _FrameLog:
    """Logs frame after frame into a `rerun.RecordingStream`; what does not change is logged once.

    Plots are kept until they are sent: to send them costs more than the numbers themselves.
    """

    def __init__(self, stream: Any, camera: Camera) -> None:
        self._stream = stream
        self._plotted: set[str] = set()
        self._has_points = False
        self._plots: defaultdict[tuple[str, int], list[tuple[int, float, Sequence[float]]]] = defaultdict(list)
        axes = rr.ViewCoordinates.RDF
        stream.log(entities.WORLD, axes, static=True)
        stream.log(
            entities.WORLD_CAMERA,
            rr.Pinhole(
                image_from_camera=camera.matrix,
                resolution=camera.image_size,
                camera_xyz=axes,
                image_plane_distance=2.0,
            ),
            static=True,
        )
        turns = np.linspace(0.0, 2 * np.pi, 49)
        circle = np.stack([np.cos(turns), np.zeros_like(turns), np.sin(turns)], axis=1)
        circles = [_RING * (number + 1) * circle for number in range(_RINGS)]
        stream.log(entities.RINGS, rr.LineStrips3D(circles, colors=style.GROUND, radii=-0.5), static=True)
        distances = [_RING * (number + 1) for number in range(_RINGS)]
        marks = rr.Points3D(
            [(0.0, 0.0, distance) for distance in distances],
            colors=style.GROUND,
            radii=-1.0,
            labels=[f"{distance:.0f} m" for distance in distances],
            show_labels=True,
        )
        stream.log(f"{entities.RINGS}/distances", marks, static=True)

    def add(self, frame: RecordedFrame) -> None:
        """Log one frame; what was observed before and is not now is cleared."""
        log = self._stream.log
        self._stream.set_time("frame", sequence=frame.number)
        self._stream.set_time("time", duration=frame.time)
        if frame.problem is not None:
            log(entities.LOG, rr.TextLog(whole_text(frame.problem), level=rr.TextLogLevel.WARN))
        if frame.image is not None:
            log(entities.VIDEO_IMAGE, rr.EncodedImage(contents=jpeg(frame.image, _JPEG), media_type="image/jpeg"))
        log(f"{entities.VIDEO_IMAGE}/boxes", named_boxes(frame.vehicles))
        world_T_camera = np.eye(4) if frame.world_T_camera is None else frame.world_T_camera
        for entity in (entities.WORLD_CAMERA, entities.HERE):
            log(entity, rr.Transform3D(translation=world_T_camera[:3, 3], mat3x3=world_T_camera[:3, :3]))
        self._log_vehicles([vehicle for vehicle in frame.vehicles if vehicle.pose is not None], world_T_camera)
        for identity, values in frame.values.items():
            for name, numbers in values.items():
                self._plots[name, identity].append((frame.number, frame.time, numbers))
        for identity, state in frame.states.items():
            log(f"{entities.STATES}/{identity}", rr.StateChange(state=[state]))
        if frame.window:
            for archetype in graph_archetypes(lay_out(frame.window)):
                log(entities.GRAPH, archetype)

    def _log_vehicles(self, vehicles: Sequence[DrawnVehicle], world_T_camera: Array) -> None:
        """Boxes, wireframes, headings and paths of the vehicles that have a pose."""
        flat, solid, noses, trails = [], [], [], []  # of each vehicle
        for vehicle in vehicles:
            result = vehicle.result
            assert result is not None
            world_T_object = world_T_camera @ result.camera_T_object
            lines = [*outline_corners(result.box_size)[BOX_EDGES], *result.wireframe[result.shape.edges]]
            flat.append(list(result.pose.wireframe_uv[result.shape.edges]))
            solid.append([transform(world_T_object, line) for line in lines])
            noses.append(transform(world_T_object, np.array([(0, 0, 0), (result.box_size[0] / 2 + NOSE, 0, 0)])))
            trail = vehicle.trail
            trails.append([] if trail is None or len(trail) < 2 else [transform(world_T_camera, trail)])
        colours = np.array([style.categorical(vehicle.identity) for vehicle in vehicles], np.uint8).reshape(-1, 3)

        def look(strips: list[list[Array]]) -> dict[str, Any]:
            return {
                "radii": -1.0,
                "strips": list(chain.from_iterable(strips)),
                "colors": np.repeat(colours, [len(s) for s in strips], axis=0),
            }

        ends = np.array(noses).reshape(-1, 2, 3)
        arrows = rr.Arrows3D(
            origins=ends[:, 0],
            vectors=ends[:, 1] - ends[:, 0],
            colors=style.readable(colours),
            radii=-1.5,
            labels=[vehicle.label for vehicle in vehicles],
            show_labels=True,
        )
        self._stream.log(f"{entities.VIDEO_IMAGE}/wireframes", rr.LineStrips2D(**look(flat)))
        self._stream.log(f"{entities.WORLD}/cars", rr.LineStrips3D(**look(solid)))
        self._stream.log(f"{entities.WORLD}/headings", arrows)
        self._stream.log(f"{entities.WORLD}/paths", rr.LineStrips3D(**look(trails)))
        self._log_points(vehicles, world_T_camera)

    def _log_points(self, vehicles: Sequence[DrawnVehicle], world_T_camera: Array) -> None:
        """The points of other sensors, of a video that has any; those of the frame before go."""
        known = [v.result.diagnostics for v in vehicles if v.result is not None and len(v.result.diagnostics.points)]
        self._has_points = self._has_points or bool(known)
        if self._has_points:
            places = np.concatenate([np.zeros((0, 3)), *(one.points for one in known)])
            weights = np.concatenate([np.zeros(0), *(one.point_weights for one in known)])
            shown = rr.Points3D(transform(world_T_camera, places), colors=style.weight_colours(weights), radii=-1.5)
            self._stream.log(entities.WORLD_POINTS, shown)

    def send_plots(self) -> None:
        """Send the values of the vehicles that were not sent yet, in their colours, with their bands."""
        for (name, identity), rows in self._plots.items():
            entity = f"{entities.PLOTS}/{name}/{identity}"
            frames, times, values = zip(*rows, strict=True)
            lengths = [len(numbers) for numbers in values]
            if entity not in self._plotted:
                self._plotted.add(entity)
                names = [str(identity), f"{identity}, 95 % from", f"{identity}, 95 % to"][: lengths[0]]
                widths = [2.0, _BAND, _BAND][: lengths[0]]
                colour = style.readable(style.categorical(identity))
                lines = rr.SeriesLines(colors=[colour] * lengths[0], names=names, widths=widths)
                self._stream.log(entity, lines, static=True)
            timelines = [rr.TimeColumn("frame", sequence=frames), rr.TimeColumn("time", duration=times)]
            columns = rr.Scalars.columns(scalars=list(chain.from_iterable(values))).partition(lengths)
            self._stream.send_columns(entity, timelines, columns)
        self._plots.clear()
