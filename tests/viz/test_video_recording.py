"""Recordings of videos: what a file holds, what a viewer is sent, and the layout."""

from dataclasses import replace

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.reconstruction import GraphFactor, Status
from fgrecon.viz import DrawnVehicle, entities
from fgrecon.viz.sinks import LOOPBACK, free_port, viewer_command
from fgrecon.viz.subjects import RecordedFrame
from fgrecon.viz.video_recording import LiveRecording, video_recording_of
from tests.viz.test_blueprint import layout_of
from tests.viz.viewers import listening, wait_for

WINDOW = (
    GraphFactor("reprojection", "9 keypoints", ("X(v=3,t=0)", "L(v=3)")),
    GraphFactor("reprojection", "8 keypoints", ("X(v=3,t=1)", "L(v=3)")),
    GraphFactor("extra", "motion", ("X(v=3,t=0)", "V(v=3,t=0)", "X(v=3,t=1)")),
    GraphFactor("extra", "velocity", ("V(v=3,t=1)",)),
)


def shown(example, **changes):
    return DrawnVehicle(3, example.observation.box, example.reconstruction, "9 m", **changes)


def frames_of(example):
    blank = np.full((375, 1242, 3), 128, np.uint8)
    moved = np.eye(4)
    moved[2, 3] = 1.5
    values = [{"speed": (7.0 + n,), "yaw": (90.0, 88.0, 92.0), "width": (1.8, 1.7, np.nan)} for n in range(2)]
    return [
        RecordedFrame(
            4, 0.4, blank, (shown(example),), np.eye(4), values={3: values[0]}, states={3: "converged, rear"}
        ),
        RecordedFrame(
            number=5,
            time=0.5,
            image=blank,
            vehicles=(shown(example, trail=np.array([[0.0, 1.65, 10.0], [0.5, 1.65, 11.0]])),),
            world_T_camera=moved,
            values={3: values[1]},
            window=WINDOW,
        ),
        RecordedFrame(6, 0.6, None, problem="torn", states={3: None}),
    ]


@pytest.fixture
def written(example, tmp_path):
    return video_recording_of(lambda: frames_of(example), example.camera).write(tmp_path / "video.rrd")


def rows_of(path, entity, column):
    """Frame (None where it holds always) and value of a component."""
    from rerun.chunk import RrdReader

    found = []
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if str(chunk.entity_path) == f"/{entity}" and column in batch.schema.names:
            frames = [None] if chunk.is_static else batch.column("frame").to_pylist()
            found += zip(frames, batch.column(column).to_pylist(), strict=True)
    return sorted(found, key=str)


def test_a_recording_has_images_cars_and_plots(written):
    from rerun.chunk import RrdReader

    found = {str(chunk.entity_path) for chunk in RrdReader(written).stream()}
    wanted = {"/image", "/image/boxes", "/image/wireframes", "/world/cars", "/world/paths", "/world/camera"}
    assert {*wanted, "/plots/speed/3", "/plots/yaw/3", "/states/3", "/log"} <= found


def test_plots_have_their_bands_and_names(written):
    speeds, widths = (rows_of(written, f"plots/{name}/3", "Scalars:scalars") for name in ("speed", "width"))
    assert speeds == [(4, [7.0]), (5, [8.0])]
    assert [(frame, value[:2], np.isnan(value[2])) for frame, value in widths] == [
        (4, [1.8, 1.7], True),
        (5, [1.8, 1.7], True),
    ]
    ((always, names),) = rows_of(written, "plots/width/3", "SeriesLines:names")
    assert (always, names) == (None, ["3", "3, 95 % from", "3, 95 % to"])


def test_headings_have_names_and_go_with_the_world(example, written):
    labels, origins = (rows_of(written, "world/headings", f"Arrows3D:{name}") for name in ("labels", "origins"))
    assert labels == [(4, ["3"]), (5, ["3"]), (6, [])]
    places = [np.array(value[0]) for _, value in origins[:2]]
    np.testing.assert_allclose(places[0], example.reconstruction.location, rtol=1e-5)
    np.testing.assert_allclose(places[1] - places[0], [0.0, 0.0, 1.5], atol=1e-5)
    here = dict(rows_of(written, "world/here", "Transform3D:translation"))
    assert here[5] == [[0.0, 0.0, 1.5]]


def test_the_window_is_a_graph(written):
    ((frame, nodes),) = rows_of(written, entities.GRAPH, "GraphNodes:node_ids")
    assert frame == 5
    assert set(nodes) == {
        *("X(v=3,t=0)", "X(v=3,t=1)", "V(v=3,t=0)", "V(v=3,t=1)", "L(v=3)"),
        *("reprojection 0", "reprojection 1", "extra 2", "extra 3"),
    }
    ((_, labels),) = rows_of(written, entities.GRAPH, "GraphNodes:labels")
    assert {"pose X(3, 1)", "velocity V(3, 0)", "shape L(3)", "9 keypoints", "motion", "velocity"} <= set(labels)
    ((_, places),) = rows_of(written, entities.GRAPH, "GraphNodes:positions")
    assert len(set(map(tuple, places))) == len(nodes)
    x, y = np.array(places).T
    place = {name: (x[i], y[i]) for i, name in enumerate(nodes)}
    assert place["V(v=3,t=1)"][1] == place["X(v=3,t=1)"][1] > place["X(v=3,t=0)"][1]
    assert place["X(v=3,t=0)"][1] < place["extra 2"][1] < place["X(v=3,t=1)"][1]
    assert place["extra 3"][0] < place["V(v=3,t=1)"][0] < place["extra 2"][0] < place["X(v=3,t=1)"][0]
    ((_, edges),) = rows_of(written, entities.GRAPH, "GraphEdges:edges")
    ends = {(edge["first"], edge["second"]) for edge in edges}
    assert {("extra 2", "X(v=3,t=0)"), ("extra 2", "V(v=3,t=0)"), ("extra 2", "X(v=3,t=1)")} <= ends


def test_a_pose_that_is_not_determined_is_a_box_alone(example, tmp_path):
    lost = replace(example.reconstruction, status=Status.DEGENERATE)
    frame = RecordedFrame(0, 0.0, None, (DrawnVehicle(3, example.observation.box, lost, "degenerate"),))
    path = video_recording_of(lambda: [frame], example.camera).write(tmp_path / "lost.rrd")
    assert rows_of(path, "image/boxes", "Boxes2D:labels") == [(0, ["3 degenerate"])]
    for entity, column in (("world/cars", "LineStrips3D:strips"), ("image/wireframes", "LineStrips2D:strips")):
        assert rows_of(path, entity, column) == [(0, [])]


def test_the_layout_has_a_view_from_above_sizes_and_the_graph(written):
    layout = layout_of(written)
    assert {"Image", "Space", "From above: a circle every 10 m", "Factor graph of a window", "Gaps"} < set(layout.views)
    assert {"yaw [degrees]", "length [m]", "width [m]", "height [m]", "speed [m/s]"} < set(layout.views)
    heights = sorted(-place[0][1] for place in layout.eyes)
    assert len(heights) == 2
    assert heights[1] > 50.0 > heights[0] > 5.0
    assert {"/world/**", "/world/** - /world/here/rings/**"} < set(layout.contents)


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
        live.add(RecordedFrame(number, 0.1 * number, None, (shown(example),)))
        wait_for(lambda number=number: frames("/image/boxes") == [*range(number + 1)])
    live.add(RecordedFrame(7, 0.7, None, problem="torn"))
    live.end()
    for entity, wanted in {"/log": [7], "/image/boxes": [0, 1, 2, 7], "/world/cars": [0, 1, 2, 7]}.items():
        wait_for(lambda entity=entity, wanted=wanted: frames(entity) == wanted)


def test_nobody_listens(example):
    with pytest.raises(InvalidInputError, match="connect"):
        LiveRecording("drive", "127.0.0.1:1", example.camera)


def test_rings_say_their_distance():
    from fgrecon.simulation.vehicles import KITTI_CAMERA
    from fgrecon.viz.video_recording import _FrameLog

    logged = {}

    class Stream:
        def log(self, entity, *archetypes, static=False):
            logged[entity] = (archetypes, static)

    _FrameLog(Stream(), KITTI_CAMERA)
    (marks,), static = logged["world/here/rings/distances"]
    assert static
    assert marks.labels.as_arrow_array().to_pylist() == ["10 m", "20 m", "30 m", "40 m", "50 m"]
    assert [place[2] for place in marks.positions.as_arrow_array().to_pylist()] == [10.0, 20.0, 30.0, 40.0, 50.0]
