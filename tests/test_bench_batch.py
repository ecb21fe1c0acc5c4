"""`benchmarks.bench_batch`: a short run of it, its clocks and its view of the processes."""

import os
import sys
import time

import pytest

from benchmarks.batch_shares import Clocked, image_shares, keypoint_shares, share_lines
from benchmarks.bench_batch import Sample, check, make_cars, plot, run_and_keep, summary
from benchmarks.process_tree import Usage, memory_of, usage_of_tree
from fgrecon.io.catalogue import load_prior
from fgrecon.io.images import write_png
from fgrecon.simulation.sample import sample_street

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")


@pytest.mark.slow
def test_a_short_run_is_counted_to_the_last_row(tmp_path):
    files = make_cars(tmp_path, 20)
    assert make_cars(tmp_path, 20) == files, "made once"
    samples = run_and_keep(files, tmp_path, 1)
    assert "every row once" in check(tmp_path / "results", 20)
    assert samples[-1].rows == 20
    assert 0.0 < max(one.memory for one in samples) <= max(one.resident for one in samples)
    assert samples[-1].workers > samples[-1].parent >= 0.0  # a short run may end before it is looked at
    again = run_and_keep(files, tmp_path, 1)
    assert [one.rows for one in again[: len(samples)]] == [one.rows for one in samples]
    assert again[-1].seconds > samples[-1].seconds
    plot(again, tmp_path / "run.svg")
    assert "cars written" in (tmp_path / "run.svg").read_text()


@pytest.mark.slow
def test_shares_are_of_everything(tmp_path):
    (file,) = make_cars(tmp_path, 64)
    shares = keypoint_shares(file, 32)
    assert {"read keypoints", "solve: graph", "rows of results", "write the parts"} < shares.keys()
    assert all(value >= 0.0 for value in shares.values())
    assert share_lines(shares)[-1].startswith("| all |")


@pytest.mark.slow
def test_shares_of_images_are_of_everything(tmp_path):
    street = sample_street(load_prior("car14"))
    for number in range(9):
        write_png(tmp_path / f"{number}.png", street.image)
    shares, cars = image_shares([tmp_path], 1)
    assert {"read the image", "detector", "keypoints", "solve"} < shares.keys()
    assert shares["the rest"] < 0.1 * sum(shares.values())
    assert cars > 0


def test_what_an_inner_stage_takes_is_none_of_the_outer_ones():
    clock = Clocked()

    def work():
        until = time.process_time() + 0.02
        while time.process_time() < until:
            pass

    with clock.stage("outer"):
        clock.wrap("inner", work)()
    assert clock.seconds["inner"] >= 0.02 > clock.seconds["outer"] >= 0.0


def test_the_pages_of_a_file_count_once():
    two = Usage(10.0, {"lib": 5.0, "one": 1.0}, 0.0), Usage(20.0, {"lib": 4.0}, 0.0)
    assert memory_of(two) == 36.0
    assert two[0].resident == 16.0
    (own, *_) = usage_of_tree(os.getpid()).values()
    assert own.own > 5.0
    assert any("python" in name for name in own.files)


def test_a_summary_says_whether_memory_grows():
    growing = [Sample(float(i), 100 * i, 200.0 + i, 300.0 + i, 0.1 * i, 0.9 * i) for i in range(101)]
    lines = summary([*growing, Sample(101.0, 10_100, 0.0, 0.0, 10.1, 90.9)], 2)
    assert lines[0] == "10100 cars in 101 s by 2 workers: 100 cars/s"
    assert "CPU ms a car: 10.00, of them 1.00" in lines[1]
    assert "300 MB at most" in lines[2]
    assert lines[3].endswith("(+81.0)")
