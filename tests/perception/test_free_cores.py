"""How many cores are free: by affinity, by a container's limit, and beside the load of others."""

import math
import os

import pytest

from fgrecon.perception.keypoints import sessions as module
from fgrecon.perception.keypoints.sessions import allowed_cores, free_cores, load_of_others, share_of_cgroup


def test_processors_of_one_core_count_once(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2, 5}, raising=False)
    monkeypatch.setattr(module.Path, "read_text", lambda path: "0,5" if path.parts[-3] in ("cpu0", "cpu5") else "1-2")
    assert allowed_cores() == 2

    def absent(path):
        raise FileNotFoundError(path)

    monkeypatch.setattr(module.Path, "read_text", absent)
    assert allowed_cores() == 4


@pytest.mark.parametrize(("text", "share"), [("150000 100000", 1.5), ("max 100000", math.inf), ("odd", math.inf)])
def test_a_limit_of_the_second_version(monkeypatch, tmp_path, text, share):
    monkeypatch.setattr(module, "_CGROUPS", tmp_path)
    assert share_of_cgroup() == math.inf
    (tmp_path / "cpu.max").write_text(text, encoding="ascii")
    assert share_of_cgroup() == share


@pytest.mark.parametrize(("quota", "share"), [("400000", 4.0), ("-1", math.inf)])
def test_a_limit_of_the_first_version(monkeypatch, tmp_path, quota, share):
    monkeypatch.setattr(module, "_CGROUPS", tmp_path)
    (tmp_path / "cpu").mkdir()
    (tmp_path / "cpu" / "cpu.cfs_quota_us").write_text(f"{quota}\n", encoding="ascii")
    (tmp_path / "cpu" / "cpu.cfs_period_us").write_text("100000\n", encoding="ascii")
    assert share_of_cgroup() == share


@pytest.mark.parametrize(
    ("cores", "share", "load", "free"),
    [
        (2, math.inf, 0.3, 2),
        (2, math.inf, 2.1, 1),
        (2, math.inf, 9.0, 1),
        (8, 2.9, 0.0, 2),
        (8, 0.5, 0.0, 1),
        (8, math.inf, 3.2, 5),
    ],
)
def test_cores_that_others_keep_busy_are_not_free(monkeypatch, cores, share, load, free):
    monkeypatch.setattr(module, "allowed_cores", lambda: cores)
    monkeypatch.setattr(module, "share_of_cgroup", lambda: share)
    monkeypatch.setattr(module, "load_of_others", lambda: load)
    assert free_cores() == free


def test_what_this_process_does_is_no_load_of_others(monkeypatch):
    monkeypatch.setattr(os, "getloadavg", lambda: (1.5, 0.0, 0.0), raising=False)
    monkeypatch.setattr(module.time, "monotonic", lambda: module._BEGAN + 100.0)
    monkeypatch.setattr(module.time, "process_time", lambda: 90.0)
    assert load_of_others() == pytest.approx(0.6)
    monkeypatch.setattr(module.time, "process_time", lambda: 190.0)
    assert load_of_others() == 0.0

    def unknown():
        raise OSError

    monkeypatch.setattr(os, "getloadavg", unknown)
    assert load_of_others() == 0.0
