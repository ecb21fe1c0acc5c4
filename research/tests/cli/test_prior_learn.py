"""`fgrecon prior learn`, `show` and `compare` as a user runs them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from typer.testing import CliRunner

from fgrecon.cli.main import app
from fgrecon.core.errors import InvalidInputError
from fgrecon.io.catalogue import load_prior
from research.tests.training.priors.nrsfm_data import CHAIR, draw_world

RUN = CliRunner()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("chair")
    (folder / "chair.json").write_text(json.dumps(CHAIR))
    np.savez(folder / "marks.npz", keypoints=draw_world(0, count=80, missing=0.2).keypoints)
    result = RUN.invoke(app, ["prior", *learn(folder, "chair.npz")], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return folder


def learn(folder, out, *more):
    arguments = [
        "learn",
        folder / "marks.npz",
        "--category",
        folder / "chair.json",
        "--basis",
        2,
        "--out",
        folder / out,
    ]
    return [str(a) for a in (*arguments, "--size-prior", "0.5,0.45,0.92", "--restarts", 1, "--min-visible", 6, *more)]


def test_learn_writes_a_prior_and_says_what_it_found(folder):
    prior = load_prior(folder / "chair.npz")
    assert prior.name == "chair"
    assert prior.category.name == "chair"
    assert prior.dimension == 2
    assert "marks.npz" in prior.provenance["source"]
    text = RUN.invoke(app, ["prior", *learn(folder, "again.npz", "--images", "60", "--perspective")]).output
    assert "60 of 60 images" in text
    assert "variance explained" in text
    assert "the mean by other vehicles: " in text
    assert "other vehicles" not in RUN.invoke(app, ["prior", *learn(folder, "unsure.npz", "--bootstrap", 0)]).output
    assert "perspective" in load_prior(folder / "again.npz").provenance["method"]


def test_the_same_command_writes_the_same_bytes(folder):
    RUN.invoke(app, ["prior", *learn(folder, "other.npz", "--name", "chair")], catch_exceptions=False)
    assert (folder / "other.npz").read_bytes() == (folder / "chair.npz").read_bytes()


@pytest.mark.parametrize(
    ("more", "field"),
    [
        (("--rename", "a"), "rename"),
        (("--out", "/no/such/folder/x.npz"), "output"),
        (("--out", "x.txt"), "out"),
        (("--size-prior", "1,2"), "size_prior"),
        (("--images", "9999"), "count"),
    ],
)
def test_bad_options_are_refused_before_the_work(folder, more, field):
    with pytest.raises(InvalidInputError) as caught:
        RUN.invoke(app, ["prior", *learn(folder, "refused.npz", *more)], catch_exceptions=False)
    assert caught.value.field == field
    assert not (folder / "refused.npz").exists()


def test_a_category_that_is_no_car_needs_a_size(folder):
    arguments = learn(folder, "x.npz")
    at = arguments.index("--size-prior")
    with pytest.raises(InvalidInputError, match="length,width,height"):
        RUN.invoke(app, ["prior", *arguments[:at], *arguments[at + 2 :]], catch_exceptions=False)


def test_show_draws_and_records(folder):
    out, rrd = folder / "chair.png", folder / "chair.rrd"
    result = RUN.invoke(
        app,
        ["prior", "show", str(folder / "chair.npz"), "--picture", str(out), "--save", str(rrd)],
        catch_exceptions=False,
    )
    assert result.exit_code == 0
    assert "left_front_foot" in result.output
    assert "±" in result.output
    assert "±" not in RUN.invoke(app, ["prior", "show", "car14"]).output
    assert out.read_bytes()[:4] == b"\x89PNG"
    from rerun.chunk import RrdReader

    times, entities = {}, set()
    for chunk in RrdReader(str(rrd)).stream():
        entities.add(str(chunk.entity_path))
        batch = chunk.to_record_batch()
        for name in ("mode", "step"):
            if name in batch.schema.names:
                times.setdefault(name, set()).update(batch.column(name).to_pylist())
    assert times["mode"] == {0, 1, 2}
    assert len(times["step"]) == 1 + 2 * 41
    assert any(entity.startswith("/prior/wireframe/left") for entity in entities)


def test_compare(folder):
    path = str(folder / "chair.npz")
    result = RUN.invoke(app, ["prior", "compare", path, path], catch_exceptions=False)
    assert "0.00 % of the length" in result.output
    with pytest.raises(InvalidInputError, match="in common"):
        RUN.invoke(app, ["prior", "compare", path, "car14"], catch_exceptions=False)


@pytest.mark.skipif(os.name != "posix", reason="sends SIGINT")
def test_interrupting_leaves_no_file(folder):
    """The work is far from done when the signal comes; nothing of the output may be there afterwards."""
    np.savez(folder / "many.npz", keypoints=draw_world(1, count=3000, missing=0.2).keypoints)
    arguments = [a.replace("marks.npz", "many.npz") for a in learn(folder, "stopped.npz", "--restarts", "50")]
    code = (  # a shell that runs the tests in the background has them ignore the signal: the child must not
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); print('ready', flush=True)\n"
        "from fgrecon.cli.main import main; main()"
    )
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-c", code, "prior", *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment) as process:
        assert process.stdout.readline() == b"ready\n"
        time.sleep(4)
        process.send_signal(signal.SIGINT)
        try:
            process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode not in (0, None)
    assert not list(folder.glob("*stopped*"))
