"""Frames of a video with what was found in them, and recordings of these."""

from dataclasses import replace

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.viz import style
from fgrecon.viz.overlay import Shown, annotated
from fgrecon.viz.sinks import LOOPBACK, free_port, viewer_command
from fgrecon.viz.video_recording import LiveRecording, ShownFrame, video_recording_of
from tests.viz.viewers import listening, wait_for


def near(image, colour, tolerance=40):
    """(H, W) whether a pixel has a colour."""
    return (np.abs(image.astype(int) - colour) < tolerance).all(axis=2)


def shown(example, **changes):
    return Shown(3, example.observation.box, example.reconstruction, "9 m", **changes)


def test_a_car_is_drawn_where_it_is(example):
    blank = np.full((375, 1242, 3), 128, np.uint8)
    before = blank.copy()
    drawn = annotated(blank, [shown(example)], example.camera, caption="frame 3")
    assert (blank == before).all()
    assert drawn.shape == blank.shape
    coloured = near(drawn, style.categorical(3))
    x1, y1, x2, y2 = example.observation.box.astype(int)
    assert coloured[max(y1, 0) : y2, x1:x2].sum() > 200
    outside = coloured.copy()
    outside[max(y1 - 40, 0) : y2 + 40, max(x1 - 40, 0) : x2 + 40] = False
    rows, columns = np.nonzero(outside)
    assert len(rows) > 10  # in the view from above, lower right
    assert rows.min() > 375 * 0.4
    assert columns.min() > 900


def test_the_view_from_above_is_to_scale(example):
    """A car twice as far away is twice as far up; one to the right is to the right."""
    blank = np.full((375, 1242, 3), 128, np.uint8)
    middles = []
    for x, z in ((0.0, 20.0), (0.0, 40.0), (10.0, 20.0)):
        pose = example.reconstruction.camera_T_object.copy()
        pose[:3, 3] = [x, 1.65, z]
        result = replace(example.reconstruction, camera_T_object=pose)
        drawn = annotated(blank, [Shown(3, np.array([0.0, 0, 5, 5]), result)], example.camera)
        rows, columns = np.nonzero(near(drawn, style.categorical(3)))
        inset = (rows > 375 * 0.45) & (columns > 1242 - 210)
        middles.append((columns[inset].mean(), rows[inset].mean()))
    (x0, y0), (x1, y1), (x2, _) = middles
    scale = (y0 - y1) / 20.0
    assert scale > 1.5
    assert x1 == pytest.approx(x0, abs=2.0)
    assert (x2 - x0) / 10.0 == pytest.approx(scale, rel=0.15)


def test_a_box_without_a_result_is_a_box(example):
    blank = np.full((375, 1242, 3), 128, np.uint8)
    drawn = annotated(blank, [Shown(3, np.array([100.0, 100, 200, 180]))], example.camera)
    assert near(drawn, style.categorical(3))[100, 110:190].all()
    assert (drawn[300:] == 128).all()
    with pytest.raises(InvalidInputError, match="image"):
        annotated(blank[..., 0], [], example.camera)


def test_a_recording_has_images_cars_and_plots(example, tmp_path):
    from rerun.chunk import RrdReader

    blank = np.full((375, 1242, 3), 128, np.uint8)
    trail = np.array([[0.0, 1.65, 10.0], [0.5, 1.65, 11.0]])
    frames = [
        ShownFrame(
            number=4,
            time=0.4,
            image=blank,
            vehicles=(shown(example, trail=trail),),
            world_T_camera=np.eye(4),
            values={3: {"speed": (7.0,), "yaw": (90.0, 88.0, 92.0)}},
            states={3: "converged, rear"},
        ),
        ShownFrame(5, 0.5, None, problem="torn", states={3: None}),
    ]
    path = video_recording_of(lambda: frames, example.camera).write(tmp_path / "video.rrd")
    entities = {str(chunk.entity_path) for chunk in RrdReader(path).stream()}
    wanted = {"/image", "/image/boxes", "/image/wireframes", "/world/cars", "/world/paths", "/world/camera"}
    assert {*wanted, "/plots/speed/3", "/plots/yaw/3", "/states/3", "/log"} <= entities


@pytest.mark.filterwarnings("ignore:RRD file has no footer")  # the viewer is not at the end of it
def test_a_viewer_is_sent_each_frame_as_it_comes(example, tmp_path, start):
    from rerun.chunk import RrdReader

    port, received = free_port(), tmp_path / "received.rrd"
    start(viewer_command("--port", str(port), "--save", str(received)))
    wait_for(lambda: listening(port))

    def frames(entity):
        """The frames in which the viewer has something at a place."""
        try:
            chunks = [chunk for chunk in RrdReader(received).stream() if chunk.entity_path == entity]
        except (OSError, ValueError, RuntimeError):  # not there yet, or amid a message
            return []
        return sorted({number for chunk in chunks for number in chunk.to_record_batch()["frame"].to_pylist()})

    live = LiveRecording("drive", f"{LOOPBACK}:{port}", example.camera)
    for number in range(3):
        live.add(ShownFrame(number, 0.1 * number, None, (shown(example),)))
        wait_for(lambda number=number: frames("/image/boxes") == [*range(number + 1)])
    live.add(ShownFrame(7, 0.7, None, problem="torn"))
    live.end()
    for entity, wanted in {"/log": [7], "/image/boxes": [0, 1, 2, 7], "/world/cars": [0, 1, 2, 7]}.items():
        wait_for(lambda entity=entity, wanted=wanted: frames(entity) == wanted)


def test_nobody_listens(example):
    with pytest.raises(InvalidInputError, match="connect"):
        LiveRecording("drive", "127.0.0.1:1", example.camera)
