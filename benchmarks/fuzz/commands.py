"""Commands and damaged files.

Each command runs in a process of its own, which may neither crash, nor end with a traceback, nor take more than a
minute or a GiB. A server that has loaded the package forks the processes, so that a command need not load it again.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import sys
import tempfile
import time
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fuzz.mutate import mutated
from benchmarks.fuzz.run import Ended, Find, keep, numbered

__all__ = ["COMMANDS", "Command", "Outcome", "fuzz_commands", "made_inputs", "outcome"]

_SECONDS = 60.0  # by the clock, on whatever machine: a command that takes longer is a find
_MEMORY = 1024  # MiB, of the largest of the command's processes
_CODES = (0, 1, 2)  # done, done but failed, bad usage or input


@dataclass(frozen=True)
class Command:
    """A command line and which of its files are damaged.

    Attributes:
        line: Its arguments; paths are relative to the folder of the inputs, `out` is there and empty.
        inputs: Files that it reads.
        before: The command line that runs undamaged before it, and whose outputs are its inputs.
    """

    line: str
    inputs: tuple[str, ...]
    before: str | None = None


_BOXES = "--boxes boxes.txt --calib calib.txt --camera-height 1.65"
_BATCH = "batch cars.json --out out/rows -q"
_DRIVE = "run drive --calib calib.txt --camera-height 1.65 -q --out out/tracked"
_ROWS = ("out/rows/part-000000.parquet", "out/rows/_run.json")
_FOLLOWED = ("motions/part-000000.parquet", "motions/_run.json", "records/part-000000.parquet", "records/_run.json")

COMMANDS: Mapping[str, Command] = {
    "reconstruct keypoints": Command("reconstruct cars.json --json out/r.json --picture out/r.png -q", ("cars.json",)),
    "reconstruct with a prior": Command("reconstruct cars.json --prior prior.npz --json out/r.json -q", ("prior.npz",)),
    "reconstruct an image": Command(
        f"reconstruct street.png {_BOXES} --json out/r.json -q", ("street.png", "boxes.txt", "calib.txt")
    ),
    "reconstruct by a network": Command(
        f"reconstruct street.png {_BOXES} --weights net.safetensors -q", ("net.safetensors",)
    ),
    "track": Command("track TRACK.json --json out/r.json -q", ("TRACK.json",)),
    "batch": Command(_BATCH, ("cars.json",)),
    "batch goes on": Command(_BATCH, _ROWS, before=_BATCH),
    "refine": Command(
        "refine detections.txt street.png --calib calib.txt --out out/b.txt -q",
        ("detections.txt", "calib.txt", "street.png"),
    ),
    "run": Command(_DRIVE, ("calib.txt", *(f"drive/{i:06d}.png" for i in (0, 3)))),
    "run goes on": Command(_DRIVE, tuple(f"out/tracked/{name}" for name in _FOLLOWED), before=_DRIVE),
    "run with vehicles of others": Command(f"{_DRIVE} --tracks labels.txt", ("labels.txt",)),
    "run with poses": Command(f"{_DRIVE} --poses poses.txt", ("poses.txt",)),
    "run on keypoints": Command("run TRACK.json -q --out out/tracked", ("TRACK.json",)),
    "replay": Command("replay car.rrd --json out/s.json", ("car.rrd",)),
    "export a scene": Command("export result.json out/r.glb", ("result.json",)),
    "export a table": Command("export result.json out/r.csv", ("result.json",)),
    "export a log": Command("export result.json out/r.mcap --format foxglove", ("result.json",)),
    "export a batch": Command("export out/rows out/r.csv", _ROWS, before=_BATCH),
    "export a video": Command(
        "export out/tracked out/v.json --format coco", ("out/tracked/frames.jsonl",), before=_DRIVE
    ),
    "prior show": Command("prior show prior.npz --picture out/p.png", ("prior.npz",)),
    "prior learn": Command("prior learn marks.npz --out out/p.npz --bootstrap 0", ("marks.npz",)),
    "prior learn a category": Command(
        "prior learn marks.npz --category category.json --out out/p.npz --bootstrap 0", ("category.json",)
    ),
    "keypoints detect": Command("keypoints detect street.png --boxes boxes.txt --json out/k.json", ("boxes.txt",)),
    "keypoints label": Command(
        "keypoints label kitti --out out/l.json", ("kitti/label_02.txt", "kitti/calib.txt", "kitti/image_02/000000.png")
    ),
    "vehicles detect": Command("vehicles detect street.png --out out/v.txt", ("street.png",)),
    "evaluate tracks": Command("evaluate tracks TRACK.json --json out/e.json", ("TRACK.json",)),
    "evaluate boxes": Command("evaluate boxes kitti labels.txt", ("labels.txt", "kitti/label_02.txt")),
}
"""Command lines by name: those that read files of the user's."""


@dataclass(frozen=True)
class Outcome:
    """How a command ended.

    Attributes:
        code: Exit code; negative the number of the signal that ended it, None where it had to be stopped.
        said: What it wrote to output and errors.
        memory: MiB of the largest of its processes; 0 where it did not come to say so.
        seconds: By the clock.
    """

    code: int | None
    said: str
    memory: float
    seconds: float

    @property
    def fault(self) -> str | None:
        """What is wrong with it; None where nothing is."""
        if self.code is None:
            return f"TimeoutError: {self.seconds:.0f} seconds"
        if "Traceback (most recent call last)" in self.said:
            return self.said.strip().rpartition("\n")[2][:200]
        if self.code not in _CODES:
            return f"ExitCode: {self.code}, {self.said.strip().rpartition(chr(10))[2][:150]}"
        if self.memory > _MEMORY:
            return f"MemoryError: {self.memory:.0f} MiB"
        return None


def made_inputs(folder: Path) -> None:
    """Valid inputs of all commands, made by other commands.

    Raises:
        RuntimeError: A command failed.
    """
    data = Path(__file__).parents[2] / "fgrecon" / "data"
    steps = (
        "sample --out . -q",
        "reconstruct cars.json --json result.json -q",
        "reconstruct cars.json --id car-1 --save car.rrd -q",
    )
    for step in steps:
        _must(step, folder)
    shutil.copy(data / "priors" / "car14.npz", folder / "prior.npz")
    shutil.copy(data / "categories" / "car14.json", folder / "category.json")
    shutil.copy(data / "weights" / "keypoints-car14-photographs.safetensors", folder / "net.safetensors")
    with np.load(folder / "prior.npz") as prior:
        shape = prior["mean"]
    turned = np.random.default_rng(0).permuted(np.linspace(0, 2 * np.pi, 30))
    across = np.stack([np.cos(turned), np.zeros(30), np.sin(turned)], axis=1)
    pixels = np.stack([shape @ across.T, np.broadcast_to(shape[:, 1:2], (len(shape), 30))], axis=-1)
    np.savez(folder / "marks.npz", keypoints_uv=100.0 * np.moveaxis(pixels, 1, 0) + 300.0)
    detections = (folder / "detections.txt").read_text().splitlines()
    lines = [f"{frame} {i} {line}\n" for frame in (0, 1) for i, line in enumerate(detections)]
    (folder / "labels.txt").write_text("".join(lines))
    (folder / "poses.txt").write_text("".join(f"1 0 0 0 0 1 0 0 0 0 1 {i}\n" for i in range(8)))
    kitti = folder / "kitti"
    (kitti / "image_02").mkdir(parents=True)
    shutil.copy(folder / "street.png", kitti / "image_02" / "000000.png")
    shutil.copy(folder / "calib.txt", kitti / "calib.txt")
    labels = (line.rpartition(" ")[0].replace(" -1 -1 ", " 0 0 ", 1) for line in detections)
    (kitti / "label_02.txt").write_text("".join(f"0 {i} {line}\n" for i, line in enumerate(labels)))


@cache
def _inputs() -> tempfile.TemporaryDirectory[str]:
    """Valid inputs, until this process ends."""
    place = tempfile.TemporaryDirectory()
    (Path(place.name) / "out").mkdir()
    made_inputs(Path(place.name))
    return place


def fuzz_commands(name: str, start: int, seconds: float, out: Path | None = None, most: int | None = None) -> Ended:
    """Damage a file and run the command that reads it, over and over: as `benchmarks.fuzz.run.fuzz` does readers.

    Raises:
        RuntimeError: Without any damage the command fails as well.
    """
    command, ended = COMMANDS[name], Ended()
    with tempfile.TemporaryDirectory() as place:
        whole, folder = Path(place) / "whole", Path(place) / "work"
        shutil.copytree(_inputs().name, folder)
        if command.before is not None:
            _must(command.before, folder)  # where it will go on: runs keep the paths of their inputs
        shutil.copytree(folder, whole)
        _must(command.line, folder)
        shutil.rmtree(folder)
        for number in numbered(start, seconds, ended, most):
            rng = np.random.default_rng([number, *name.encode()])
            damaged = command.inputs[int(rng.integers(len(command.inputs)))]
            shutil.copytree(whole, folder)
            content = mutated((whole / damaged).read_bytes(), rng)
            (folder / damaged).write_bytes(content)
            _judge(name, Path(damaged), content, outcome(command.line, folder), ended, out)
            shutil.rmtree(folder)
    return ended


def _must(line: str, folder: Path) -> None:
    ended = outcome(line, folder)
    if ended.code != 0 or ended.fault is not None:
        raise RuntimeError(f"fgrecon {line}: {ended.fault or ended.said}")


def _judge(name: str, damaged: Path, content: bytes, result: Outcome, ended: Ended, out: Path | None) -> None:
    ended.files += 1
    ended.slowest = max(ended.slowest, result.seconds)
    fault = result.fault
    if fault is not None and all(find.error != fault for find in ended.finds):
        kept = keep(out, name, damaged.name, content)
        if out is not None:
            kept.with_name(kept.name + ".said").write_text(result.said, encoding="utf-8", errors="replace")
        ended.finds.append(Find(name, fault, str(damaged), kept))


def outcome(line: str, folder: Path) -> Outcome:
    """Run a command.

    Args:
        line: Its arguments.
        folder: Where it runs.
    """
    context = get_context("forkserver")
    context.set_forkserver_preload(["fgrecon.cli.main", "torch", "benchmarks.fuzz.commands"])
    with tempfile.TemporaryDirectory() as place:
        log, notes = Path(place) / "log", Path(place) / "memory.json"
        process: Any = context.Process(target=_run, args=(line.split(), str(folder), str(log), str(notes)))
        clock = time.perf_counter()
        process.start()
        process.join(_SECONDS)
        code = process.exitcode
        if code is None:
            process.kill()
            process.join()
        took = time.perf_counter() - clock
        memory = float(json.loads(notes.read_text())) if notes.exists() else 0.0
        said = log.read_text(encoding="utf-8", errors="replace") if log.exists() else ""
        return Outcome(code, said, memory, took)


def _run(arguments: list[str], folder: str, log: str, notes: str) -> None:
    """A command, in a process of its own, to its end."""
    from fgrecon.cli.main import main

    os.chdir(folder)
    file = os.open(log, os.O_WRONLY | os.O_CREAT, 0o600)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(file, 1)
    os.dup2(file, 2)
    sys.argv = ["fgrecon", *arguments]
    code: Any = 0
    try:
        main()
    except SystemExit as end:
        code = end.code
    except BaseException:  # noqa: BLE001  # as Python itself would say it
        traceback.print_exc()
        code = 1
    used = (resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    Path(notes).write_text(json.dumps(max(used) / 1024.0))
    sys.exit(code)
