"""The commands, what they are given and what must be the same at their end."""

from __future__ import annotations

import io
import json
import warnings
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from benchmarks.kills.child import made_up_source
from fgrecon.core.errors import FgreconError
from fgrecon.io.images import write_png
from tests.batch.support import instances, untimed, write_lines
from tests.video.streets import make_drive

__all__ = ["JOBS", "Job", "torn"]


@dataclass(frozen=True)
class Job:
    """A command that can be killed.

    Attributes:
        prepare: Makes its input in a folder.
        arguments: For the child, given the input's folder and the output's.
        end: What it wrote in the output's folder, by name, without what differs from run to run.
    """

    prepare: Callable[[Path], None]
    arguments: Callable[[Path, Path], list[str]]
    end: Callable[[Path], Mapping[str, bytes]]


def _rows(out: Path) -> Mapping[str, bytes]:
    rows = pq.read_table(out).to_pylist()
    if len({row["row_id"] for row in rows}) != len(rows):
        return {"a row stands there twice": b""}
    return {row["row_id"]: json.dumps(untimed(row)).encode() for row in rows}


def _tables(out: Path) -> Mapping[str, bytes]:
    names = ("tracks.txt", "tracks.csv")
    rows = [untimed(row) for row in pq.read_table(out / "tracks.parquet").to_pylist()]
    return {**{name: (out / name).read_bytes() for name in names}, "tracks.parquet": json.dumps(rows).encode()}


def _drive(folder: Path) -> None:
    make_drive(folder, metres=0.4)


def _photographs(folder: Path) -> None:
    (folder / "photographs").mkdir()
    rng = np.random.default_rng(1)
    for car in made_up_source(folder / "photographs").cars:
        write_png(car.image, rng.integers(0, 255, (*car.size[::-1], 3)).astype(np.uint8))
    plan = "steps = 6\nbatch = 2\nrelabel_at = [2, 4]\nrefine_steps = 4\n"
    (folder / "training.toml").write_text(f'workers = 0\n\n[[phase]]\nname = "one"\n{plan}', encoding="utf-8")


def _training(folder: Path, out: Path) -> list[str]:
    (out / "work").mkdir(parents=True, exist_ok=True)
    where = ["--work", str(out / "work"), "--out", str(out / "w.safetensors")]
    return ["train", *where, "--settings", str(folder / "training.toml")]


JOBS: Mapping[str, Job] = {
    "batch": Job(
        lambda folder: (write_lines(folder / "cars.jsonl", instances(40)), None)[1],
        lambda given, out: [
            *("batch", str(given / "cars.jsonl"), "--out", str(out)),
            *("--jobs", "2", "--batch-rows", "2", "--size-prior", "kitti"),
        ],
        _rows,
    ),
    "run": Job(
        _drive,
        lambda given, out: ["run", *_streets(given), "--fps", "10", "--camera-height", "1.65", "--out", str(out)],
        _tables,
    ),
    "train": Job(_photographs, _training, lambda out: {"w": (out / "w.safetensors").read_bytes()}),
}
"""Every command by its name."""


def _streets(given: Path) -> list[str]:
    images = next(path for path in sorted(given.iterdir()) if path.is_dir())
    (tracks,) = given.glob("*.json")
    return [str(images), "--tracks", str(tracks)]


def torn(out: Path) -> list[str]:
    """Files that are there under their own names but cannot be read to the end."""
    found = []
    for path in sorted(out.rglob("*")):
        if not path.is_file() or path.name.startswith(".") or path.suffix in (".lock", ".log"):
            continue
        try:
            _read(path)
        except (FgreconError, OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
            found.append(f"{path.relative_to(out)}: {type(error).__name__}: {error}")
    return found


def _read(path: Path) -> None:
    kind = path.suffix
    if kind == ".parquet":
        pq.read_table(path)
    elif kind == ".json":
        json.loads(path.read_text())
    elif kind == ".npz":
        with np.load(io.BytesIO(path.read_bytes())) as arrays:
            for name in arrays:
                arrays[name]
    elif kind == ".safetensors":
        from safetensors.numpy import load_file

        load_file(path)
    elif kind == ".pt":
        from fgrecon_research.training.keypoints.trainer import load_checkpoint

        with warnings.catch_warnings():
            warnings.simplefilter("error")
            load_checkpoint(path)
    elif kind in (".csv", ".txt") and path.stat().st_size and not path.read_bytes().endswith(b"\n"):
        raise ValueError("its last line has no end")
