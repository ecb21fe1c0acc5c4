"""What a worker makes of an uploaded video, and its timeline."""

import json

import numpy as np
import pytest

from fgrecon.app.requested import PageRequested
from fgrecon.app.sample import GIVEN, sample_video
from fgrecon.app.timeline import chart_of, in_words
from fgrecon.app.videos import FILM, FRAMES, RECORDING, TABLE_FILE, CarMoment, followed, progress_of, stop, track_upload
from fgrecon.app.written import as_video_command
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.vehicle_estimate import VehicleEstimate
from fgrecon.video.follow import TrackedFrame
from tests.results import changed
from tests.viz.made_up import make_example

REQUESTED = PageRequested.of([*GIVEN.items, ("every", "2")])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    pytest.importorskip("av", reason="PyAV is not installed")
    place = tmp_path_factory.mktemp("video")
    sample_video(place)
    return place


@pytest.fixture(scope="module")
def results(folder):
    out = folder / "out"
    out.mkdir()
    return out, track_upload(folder, "street.mp4", out, REQUESTED)


def test_a_video_becomes_film_tables_recording_and_timelines(results):
    out, view = results
    assert view.filmed
    assert view.words.startswith("4 frames, 1 car")
    (car,) = view.cars
    assert car.frames == len(car.moments) == 4
    for moment in car.moments:
        value, low, high = moment.bands["heading"]
        assert low < value < high
        assert moment.bands["length"][0] == pytest.approx(3.9, abs=0.8)
        assert 0.0 <= sum(share for _, share in moment.others) <= 1.0
    assert car.moments[-1].bands["speed"][1] is not None
    assert (out / FILM).read_bytes()[4:8] == b"ftyp"
    assert (out / RECORDING).read_bytes().startswith(b"RRF")
    assert len((out / FRAMES).read_text().splitlines()) == 4
    assert (out / TABLE_FILE).read_text().count("\n") == 5
    assert str(progress_of(out)).startswith("Recording: ")


def test_the_timeline_has_values_and_bands_of_a_car(results):
    (car,) = results[1].cars
    chart = chart_of(car)
    json.dumps(chart, allow_nan=False)
    named = {one["name"]: one for one in chart["series"] if "name" in one}
    assert [*named] == ["heading", "speed", "length", "width", "height", "other pose"]
    assert named["heading"]["data"][0] == [car.moments[0].time, car.moments[0].bands["heading"][0]]
    words = in_words(car, car.moments[1])
    assert words.startswith("Car 0 at 0.20 s: heading ")
    assert "probability" in words or "none" in words


def test_a_moment_of_which_little_is_known_is_reported(results):
    (car,) = results[1].cars
    bare = CarMoment(0.0, {name: [None] * 3 for name in car.moments[0].bands}, [])
    assert "heading unknown°" in in_words(car, bare)
    assert "Other poses: none." in in_words(car, bare)


def test_headings_do_not_jump_by_a_whole_turn():
    example, frames = make_example(), []
    for number, degrees in enumerate((170.0, 178.0, -174.0)):
        pose = example.reconstruction.camera_T_object.copy()
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        pose[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
        result = changed(example.reconstruction, camera_T_object=pose, alternatives=())
        estimate = VehicleEstimate(5, 0.1 * number, result, None, None, 0.9)
        boxes = {5: example.observation.box}
        frames.append(TrackedFrame(number, 0.1 * number, "f", None, None, boxes, estimates={5: estimate}))
    (car,) = followed(frames)
    assert [moment.bands["heading"][0] for moment in car.moments] == pytest.approx([170.0, 178.0, 186.0])
    ((heading, share),) = car.moments[0].others
    assert (heading, share) == (pytest.approx(-10.0), pytest.approx(0.1))
    assert car.moments[0].bands["speed"] == [None] * 3


def test_a_stopped_one_gives_what_there_is_and_one_that_is_left_ends(folder, tmp_path):
    stop(tmp_path)
    view = track_upload(folder, "street.mp4", tmp_path, REQUESTED)
    assert view.words.startswith("1 frame, ")
    left = tmp_path / "left-alone"
    left.mkdir()
    stop(left, left=True)
    with pytest.raises(FgreconError, match="Nobody waits"):
        track_upload(folder, "street.mp4", left, REQUESTED)


@pytest.mark.parametrize(
    ("name", "text"), [("every", "1.5"), ("every", "0"), ("start", "-1"), ("end", "nan"), ("start", "999")]
)
def test_frames_that_are_none_are_refused(folder, tmp_path, name, text):
    with pytest.raises(InvalidInputError):
        track_upload(folder, "street.mp4", tmp_path, PageRequested.of([(name, text)]))


def test_what_is_no_video_is_refused_without_its_folder(folder, tmp_path):
    (folder / "wrong.mp4").write_bytes(b"no video at all")
    with pytest.raises(InvalidInputError) as refused:
        track_upload(folder, "wrong.mp4", tmp_path, REQUESTED)
    assert str(folder) not in str(refused.value)
    assert "wrong.mp4" in str(refused.value)


def test_the_command_of_a_video(tmp_path):
    from typer.testing import CliRunner

    from fgrecon.cli import main

    requested = PageRequested.of([*REQUESTED.items, ("box", "1,2,30,40"), ("together", "no"), ("history", "yes")])
    words = as_video_command(requested, "none.mp4").split()
    assert {"--every=2", "--apart", "--size-prior=kitti"} < set(words)
    done = CliRunner().invoke(main.app, [*words[1:-4], "--out", str(tmp_path / "out")])
    assert "none.mp4" in str(done.exception)  # all options were understood
