"""`fgrecon run`: vehicles that have gone are smoothed and let go of, and nothing else is different."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from fgrecon.cli import main
from fgrecon.solve.tracker import Tracker
from tests.video.streets import make_drive


def smaller(box):
    """A box around the same middle, a quarter less long and high."""
    middle, half = np.add(box[:2], box[2:]) / 2, np.subtract(box[2:], box[:2]) * 0.375
    return [*(middle - half), *(middle + half)]


@pytest.mark.parametrize(("ids", "left"), [(False, 2), (True, 0)], ids=["associated", "given"])
def test_it_lets_go_of_vehicles_that_have_gone(tmp_path, monkeypatch, ids, left):
    """The results are those of a tracker that keeps them, the warning of boxes that are all wrong alike as well."""
    _, file = make_drive(tmp_path / "drive", 2, tracks=ids)
    content = json.loads(file.read_text())
    seen = [{**one, "box": smaller(one["box"])} for one in content["instances"]]
    again = [
        {**one, "id": f"{one['id']}-{t}", "frame": one["frame"] + t} | ({"track": one["track"] + t} if ids else {})
        for t in range(0, 120, 40)
        for one in seen
    ]
    file.write_text(json.dumps({**content, "instances": again}))
    trackers, said = [], []

    class Watched(Tracker):
        def __init__(self, **arguments):
            super().__init__(**arguments)
            trackers.append(self)

    monkeypatch.setattr("fgrecon.video.video_job.Tracker", Watched)
    given = ["run", str(file), "--fps", "10", "--size-prior", "kitti", "--camera-height", "1.65"]
    lets_go, ways = Watched.forget, {"smoothed": [], "online": ["--online"]}
    for name, forget in (("forgets", lets_go), ("keeps", lambda *_: None)):
        monkeypatch.setattr(Watched, "forget", forget)
        for way, options in ways.items():
            done = CliRunner().invoke(main.app, [*given, "--out", str(tmp_path / way / name), *options])
            assert done.exit_code == 0, done.output
            said.append(done.stderr)
    assert [len(tracker.smooth()) for tracker in trackers] == [left, left, 6, 6]
    assert all("smaller than their vehicles look" in one for one in said)
    assert said[:2] == said[2:]
    files = ("tracks.txt", "tracks.csv", "tracks.parquet", "frames.jsonl")
    for way in ways:
        written = [[(tmp_path / way / name / file).read_bytes() for file in files] for name in ("forgets", "keeps")]
        assert written[0] == written[1]
