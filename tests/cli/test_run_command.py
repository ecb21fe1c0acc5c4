"""`fgrecon run`: its files, what it refuses, and what is left when it is killed or interrupted."""

import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections import Counter

import numpy as np
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from fgrecon.cli import main
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.frames import open_frames
from fgrecon.io.kitti_files import read_tracking
from fgrecon.io.video_frames import write_video
from tests.conftest import REPOSITORY
from tests.video.streets import make_drive

SLOWLY = """
import sys, time
import fgrecon.batch.parts as parts
from fgrecon.video.frame_detector import FrameDetector
from fgrecon.cli.main import main
parts._ROWS = 1
look = FrameDetector.vehicles
FrameDetector.vehicles = lambda self, frame: (time.sleep(0.15), look(self, frame))[1]
main()
"""


def run(*arguments):
    return CliRunner().invoke(main.app, ["run", *map(str, arguments)])


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    images, file = make_drive(tmp_path_factory.mktemp("drive"))
    (images / "000009.png").write_bytes(b"torn")
    return images, file


@pytest.fixture(scope="module")
def whole(drive, tmp_path_factory):
    """The folder of a run that nobody stopped, and what the command said."""
    images, file = drive
    out = tmp_path_factory.mktemp("whole") / "out"
    done = run(images, "--tracks", file, "--fps", 10, "--out", out, "--json", out.parent / "run.json", "--verbose")
    assert done.exit_code == 0, done.output
    return out, done.output


def contents(out):
    return {name: (out / name).read_text() for name in ("tracks.txt", "tracks.csv")}


def test_its_tables_agree(whole):
    out, said = whole
    rows = pq.read_table(out / "tracks.parquet").to_pylist()
    assert len(rows) > 12
    assert {row["id"] for row in rows} == {10, 11}
    assert [row["frame"] for row in rows] == sorted(row["frame"] for row in rows)
    assert rows[-1]["time"] == pytest.approx(1.1)
    tracked = read_tracking(out / "tracks.txt")
    assert sum(len(found.tracks) for found in tracked.values()) == len(rows)
    first = rows[0]
    line = tracked[first["frame"]]
    assert line.objects.location[0] == pytest.approx([first["x"], first["y"], first["z"]], abs=1e-4)
    assert line.objects.box[0] == pytest.approx([first[name] for name in ("x1", "y1", "x2", "y2")], abs=0.01)
    frames = [json.loads(text) for text in (out / "frames.jsonl").read_text().splitlines()]
    assert [frame["frame"] for frame in frames] == [3, 4, 5, 6, 8, 9, 10, 11]
    assert sum(v["result"] is not None for frame in frames for v in frame["vehicles"]) == len(rows)
    assert "000009.png" in frames[5]["problem"]
    assert "8 frames, 1 of them gaps, 2 cars" in said
    assert "gap 000009.png" in said
    assert "Warning: 1 frame could not be used, the first: " in said
    document = json.loads((out.parent / "run.json").read_text())
    assert document["tracks"] == [{"id": i, "frames": 8, "first": 3, "last": 11} for i in (10, 11)]
    assert (document["estimates"], document["stopped"]) == (len(rows), False)


def test_the_most_frequent_reasons_are_told(whole):
    """By the frames, which have all of them with their numbers."""
    out, said = whole
    frames = [json.loads(text) for text in (out / "frames.jsonl").read_text().splitlines()]
    rows = [vehicle["result"] for frame in frames for vehicle in frame["vehicles"]]
    statuses = json.loads((out.parent / "run.json").read_text())["statuses"]
    assert {name: one["boxes"] for name, one in statuses.items()} == Counter(row["status"] for row in rows)
    assert any(one["reasons"] for one in statuses.values())
    for name, one in statuses.items():
        of_status = [reason for row in rows if row["status"] == name for reason in row["reasons"]]
        assert one["reasons"] == Counter(re.sub(r"[0-9.]+", "n", reason) for reason in of_status)
        assert [*one["reasons"].values()] == sorted(one["reasons"].values(), reverse=True)
        for reason, count in [*one["reasons"].items()][:3]:
            assert f"{count} {reason}"[:30] in said


def export(out, name, *options):
    done = CliRunner().invoke(main.app, ["export", str(out), str(out.parent / name), *map(str, options)])
    if done.exception is not None:
        raise done.exception
    return (out.parent / name).read_bytes()


def test_its_frames_are_exported_at_their_times(whole):
    reader = pytest.importorskip("mcap.reader", reason="mcap is not installed: pip install fgrecon[mcap]")
    out, _ = whole
    content = io.BytesIO(export(out, "w.mcap", "--format", "foxglove"))
    messages = list(reader.make_reader(content).iter_messages("/fgrecon/scene"))
    frames = [json.loads(text) for text in (out / "frames.jsonl").read_text().splitlines()]
    assert [m.log_time for _, _, m in messages] == [round(frame["time"] * 1e9) for frame in frames]
    entities = [json.loads(m.data)["entities"] for _, _, m in messages]
    assert [[e["id"] for e in found] for found in entities] == [
        [str(v["id"]) for v in frame["vehicles"] if v["result"] is not None] for frame in frames
    ]
    first = frames[0]["vehicles"][0]["result"]
    cube = entities[0][0]["cubes"][0]["size"]
    assert list(cube.values()) == pytest.approx(first["box_size"], abs=1e-6)


def test_its_frames_are_images_for_coco_and_have_tables_already(whole):
    out, _ = whole
    (out.parent / "i.json").write_text(json.dumps({"000003": {"image_id": 7}}))
    arguments = ("c.json", "--format", "coco", "--images", out.parent / "i.json")
    found = json.loads(export(out, *arguments))
    assert {entry["image_id"] for entry in found} >= {7, "000004.png"}
    for name in ("x.csv", "x.txt", "x.glb"):
        with pytest.raises(InvalidInputError, match=r"tracks\.csv.*tracks\.txt"):
            export(out, name)
    (torn := out.parent / "torn.jsonl").write_text('{"format": "fgrecon.video-frame/1"}\n')
    with pytest.raises(InvalidInputError, match="line 1"):
        export(torn, "x.json", "--format", "coco")


def test_again_it_looks_at_nothing_and_other_options_are_solved(drive, whole, tmp_path):
    images, file = drive
    arguments = (images, "--tracks", file, "--fps", 10, "--out", tmp_path / "out")
    assert run(*arguments, "--end", 0.5).exit_code == 0
    with pytest.raises(InvalidInputError, match=r"other settings \(end\)"):
        raise run(*arguments).exception
    again = run(*arguments, "--end", 0.5, "--size-prior", "kitti", "--online")
    assert again.exit_code == 0, again.output
    assert "each estimate as of its frame; 4 were looked at before" in again.stdout
    before = [row["length"] for row in pq.read_table(whole[0] / "tracks.parquet").to_pylist()][:4]
    after = [row["length"] for row in pq.read_table(tmp_path / "out" / "tracks.parquet").to_pylist()][:4]
    assert np.abs(np.subtract(before, after)).max() > 1e-3


def test_frames_per_second_that_were_assumed_may_be_given_later(drive, tmp_path):
    images, file = drive
    arguments = (images, "--tracks", file, "--end", 0.3, "--out", tmp_path / "out")
    assert "10 frames per second are assumed" in run(*arguments).stderr
    later = run(*arguments, "--fps", 10)
    assert later.exit_code == 0, later.output
    with pytest.raises(InvalidInputError, match=r"other settings \(fps\)"):
        raise run(*arguments, "--fps", 20).exception


def test_the_ground_is_shared_or_each_car_is_alone(drive, tmp_path):
    """With a ground that is given, and with one that is estimated from the two cars."""
    images, file = drive
    tracks = {}
    for name, options in {
        "neither": (),
        "neither, apart": ("--apart",),
        "together": ("--camera-height", 1.65),
        "apart": ("--camera-height", 1.65, "--apart"),
    }.items():
        done = run(images, "--tracks", file, "--fps", 10, "--online", "--out", tmp_path / name, *options)
        assert done.exit_code == 0, done.output
        tracks[name] = contents(tmp_path / name)["tracks.txt"]
    for pair in (("neither", "neither, apart"), ("together", "apart")):
        assert tracks[pair[0]] != tracks[pair[1]]
        places = [read_tracking(tmp_path / name / "tracks.txt")[11].objects.location for name in pair]
        assert np.abs(places[0] - places[1]).max() < 2.0


def test_the_cameras_motion_is_estimated_where_it_helps(tmp_path):
    """Where the ground is given, unless somebody says otherwise or no time is looked at; on another ground again."""
    images, file = make_drive(tmp_path / "drive", 4, metres=0.4)

    def went(out, *options):
        arguments = ("--tracks", file, "--fps", 10, "--json", tmp_path / "run.json", *options)
        done = run(images, "--out", tmp_path / out, *arguments)
        assert done.exit_code == 0, done.output
        moving = json.loads((tmp_path / "run.json").read_text())["settings"]["estimate_motion"]
        found = re.search(r"the camera went ([\d.]+) m", done.stdout)
        return moving, None if found is None else float(found[1])

    level = ("--camera-height", 1.65)
    assert went("a") == (False, None)
    assert went("a", *level) == (True, pytest.approx(1.2, abs=0.1))
    assert went("a", "--camera-height", 3.3) == (True, pytest.approx(2.4, abs=0.2))
    assert went("a", *level, "--no-estimate-motion") == (False, None)
    assert went("a", *level, "--online") == (True, pytest.approx(1.2, abs=0.1))
    assert went("a", *level, "--online", "--no-estimate-motion") == (False, None)
    assert went("a", *level, "--alone") == (False, None)


def slowly(drive, out):
    images, file = drive
    arguments = ["run", str(images), "--tracks", str(file), "--fps", "10", "--out", str(out)]
    return subprocess.Popen(
        [sys.executable, "-c", SLOWLY, *arguments],
        env=os.environ | {"PYTHONPATH": str(REPOSITORY)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def wait_for_parts(running, out, count):
    deadline = time.monotonic() + 120
    while len(list(out.glob("records/part-*.parquet"))) < count and time.monotonic() < deadline:
        assert running.poll() is None, running.communicate()
        time.sleep(0.02)


def test_killed_it_goes_on_where_it_was(drive, whole, tmp_path):
    images, file = drive
    out = tmp_path / "out"
    running = slowly(drive, out)
    wait_for_parts(running, out, 3)
    running.kill()
    running.communicate()
    assert not (out / "tracks.csv").exists()
    done = run(images, "--tracks", file, "--fps", 10, "--out", out)
    assert done.exit_code == 0, done.output
    before = int(done.stdout.partition("; ")[2].split()[0])
    assert 3 <= before < 8
    assert contents(out) == contents(whole[0])


def test_interrupted_it_leaves_what_there_is(drive, whole, tmp_path):
    out = tmp_path / "out"
    running = slowly(drive, out)
    wait_for_parts(running, out, 2)
    running.send_signal(signal.SIGINT)
    said, complaint = running.communicate(timeout=60)
    assert running.returncode == 130, complaint
    assert "Stopped before the end" in complaint
    some = pq.read_table(out / "tracks.parquet").to_pylist()
    everything = pq.read_table(whole[0] / "tracks.parquet").to_pylist()
    assert 2 <= len(some) < len(everything)
    places, whole_places = ([(row["frame"], row["id"]) for row in rows] for rows in (some, everything))
    assert places == whole_places[: len(places)]
    assert "frames" in said


def test_a_video_in_and_a_video_out(drive, tmp_path):
    from rerun.chunk import RrdReader

    images, file = drive
    film = tmp_path / "in.mp4"
    with write_video(film, rate=10) as add:
        for frame in open_frames(images, rate=10).read():
            if frame.image is not None:
                add(frame.image, frame.time)
    content = json.loads(file.read_text())
    for place, instance in enumerate(content["instances"]):  # in a video, frames count from 0
        instance["frame"] = place // 2
    (tmp_path / "keypoints.json").write_text(json.dumps(content))
    out, drawn = tmp_path / "out", tmp_path / "drawn.mp4"
    done = run(
        film, "--tracks", tmp_path / "keypoints.json", "--out", out, "--video", drawn, "--save", tmp_path / "r.rrd"
    )
    assert done.exit_code == 0, done.output
    read, written = (list(open_frames(path).read()) for path in (film, drawn))
    assert len(read) == len(written) == 7
    assert [frame.time for frame in written] == pytest.approx([frame.time for frame in read], abs=1e-3)
    assert all(frame.image.shape == (374, 1242 + 394, 3) for frame in written)  # with the view from above
    chunks = [
        (str(chunk.entity_path), chunk.to_record_batch().nbytes) for chunk in RrdReader(tmp_path / "r.rrd").stream()
    ]
    wanted = {f"/plots/{name}/10" for name in ("yaw", "length", "width", "height", "speed")} | {"/graph"}
    assert wanted <= {name for name, _ in chunks}
    images = sum(size for name, size in chunks if name == "/image")
    assert (tmp_path / "r.rrd").stat().st_size - images < 7 * 100_000


def test_a_frame_is_drawn_as_a_scene(drive, whole, tmp_path):
    """From a folder that is finished, without the networks; by default the frame with the most cars."""
    images, file = drive
    arguments = (images, "--tracks", file, "--fps", 10, "--out", whole[0])
    for name, options in (("most.png", ()), ("eight.svg", ("--picture-frame", 8))):
        done = run(*arguments, "--picture", tmp_path / name, *options)
        assert done.exit_code == 0, done.output
        assert name in done.stdout
    assert "ahead [m]" in (tmp_path / "eight.svg").read_text()
    done = run(*arguments, "--picture", tmp_path / "none.png", "--picture-frame", 99)
    assert done.exception.field == "picture_frame"
    assert not (tmp_path / "none.png").exists()


def test_keypoints_alone_give_the_same(drive, whole, tmp_path):
    _, file = drive
    done = run(file, "--fps", 10, "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert contents(tmp_path / "out")["tracks.txt"] == contents(whole[0])["tracks.txt"]
    for option, field in ((["--video", tmp_path / "a.mp4"], "video"), (["--tracks", file], "tracks")):
        assert run(file, "--out", tmp_path / "x", *option).exception.field == field


def test_a_viewer_sees_it_while_it_goes_on(drive, tmp_path):
    import rerun as rr

    from fgrecon.viz.sinks import free_port

    images, file = drive
    port = free_port()
    viewer = rr.RecordingStream("viewer")
    viewer.serve_grpc(grpc_port=port)
    shown = ("--tracks", file, "--end", 0.3, "--fps", 10, "--connect", f"127.0.0.1:{port}")
    done = run(images, "--out", tmp_path / "out", *shown)
    assert done.exit_code == 0, done.output
    viewer.disconnect()


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        (["--video", "a.avi"], "a.avi"),
        (["--forget-ids"], "forget_ids"),
        (["--estimate-motion"], "estimate_motion"),
        (["--estimate-motion", "--camera-height", "1.65", "--poses", "x.txt"], "poses"),
        (["--poses", "none.txt"], "poses"),
        (["--tracks", "none.json"], "file"),
        (["--save", "a.mp4"], "save"),
        (["--picture", "a.bmp"], "picture"),
        (["--picture-frame", "5"], "picture_frame"),
        (["--picture-frame", "99", "--picture", "a.png"], "picture_frame"),
        (["--end", "0"], "end"),
    ],
)
def test_what_cannot_be_done_is_refused_before_the_work(drive, tmp_path, arguments, field):
    done = run(drive[0], "--out", tmp_path / "out", *arguments)
    assert isinstance(done.exception, InvalidInputError), done.output
    assert done.exception.field == field
    assert not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_made_is_refused_before_a_camera_is_sought(drive, tmp_path, monkeypatch):
    monkeypatch.setattr("fgrecon.video.video_job.estimate_camera", pytest.fail)
    (tmp_path / "a.txt").touch()
    for out in (tmp_path / "a.txt", tmp_path / "a.txt" / "deeper"):
        refused = run(drive[0], "--out", out).exception
        assert (refused.field, "is a file" in refused.fix) == ("out", True)


@pytest.mark.parametrize(("options", "number"), [((), 99), (("--every", 3), 4), ((), -1)])
def test_a_frame_that_a_video_cannot_have(drive, tmp_path, options, number):
    pytest.importorskip("av", reason="PyAV is not installed: pip install fgrecon[video]")
    with write_video(tmp_path / "drive.mp4", rate=10) as add:
        for _ in range(6):
            add(np.zeros((96, 128, 3), np.uint8))
    picture = ("--picture", tmp_path / "a.png", "--picture-frame", number)
    done = run(tmp_path / "drive.mp4", "--out", tmp_path / "out", *picture, *options)
    assert done.exception.field == "picture_frame"
    assert not (tmp_path / "out").exists()


def test_a_folder_of_a_batch_is_refused(drive, tmp_path):
    (tmp_path / "_run.json").write_text("{}")
    refused = run(drive[0], "--out", tmp_path, "--tracks", drive[1]).exception
    assert (refused.field, "a batch" in refused.fix) == ("out", True)
    assert [p.name for p in tmp_path.iterdir()] == ["_run.json"]


def test_a_codec_that_is_missing_is_reported_before_the_work(drive, tmp_path, monkeypatch):
    monkeypatch.setattr("fgrecon.io.video_frames._CODEC", "libnone")
    done = run(drive[0], "--out", tmp_path / "out", "--video", tmp_path / "a.mp4")
    assert "codec libnone" in str(done.exception)
    assert not (tmp_path / "out").exists()


def test_frames_of_which_none_can_be_read(tmp_path):
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / "0.png").write_bytes(b"torn")
    done = run(tmp_path / "images", "--out", tmp_path / "out")
    assert done.exception.field == "source"


def test_no_car_is_exit_code_1(drive, tmp_path):
    labels = tmp_path / "labels.txt"
    labels.write_text("5 1 Car 0 0 0 -90 30 -10 80 1.5 1.6 4.0 0.5 1.6 15.0 1.5\n")
    done = run(drive[0], "--tracks", labels, "--out", tmp_path / "out", "--fps", 10, "--end", 0.3)
    assert done.exit_code == 1
    assert (tmp_path / "out" / "tracks.txt").read_text() == ""


def test_without_a_camera_the_cars_tell_the_focal_length(drive, tmp_path):
    images, file = drive
    content = json.loads(file.read_text())
    true = content.pop("K")[0][0]
    bare = tmp_path / "keypoints.json"
    bare.write_text(json.dumps(content))
    done = run(
        images, "--tracks", bare, "--fps", 1, "--out", tmp_path / "out", "--json", tmp_path / "run.json", "--online"
    )
    assert done.exit_code == 0, done.output
    assert "from what 16 cars of 8 frames look like" in " ".join(done.stderr.split())
    focal = json.loads((tmp_path / "run.json").read_text())["settings"]["camera"]["matrix"][0][0]
    assert focal == pytest.approx(true, rel=0.35)
