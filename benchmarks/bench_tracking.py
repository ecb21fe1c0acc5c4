"""How well `fgrecon run` follows the cars of labelled drives: HOTA, CLEAR MOT and identity, by TrackEval.

Run from the repository root:
    python -m benchmarks.bench_tracking DRIVE ... --run NAME=FOLDER [--run ...] --trackeval PYTHON [--json FILE]
FOLDER has the folder that `fgrecon run DRIVE --out FOLDER/DRIVE` filled for each drive. PYTHON is the interpreter of an
environment with `trackeval`, which needs another build of OpenCV than fgrecon does. Frames that were not labelled are
left out. TrackEval judges as KITTI does, on cars: vans and cars that are hidden or cut off too far count neither way,
nor does what is found in areas that were not labelled; here, cars that something is drawn over are such areas as well.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from fgrecon.io.files import write_text
from fgrecon.io.kitti_files import Drive, TrackedObjects, format_tracking, read_drive, read_tracking

_IGNORED = "DontCare"
_NUMBERS = {"HOTA": "HOTA", "DetA": "HOTA", "AssA": "HOTA", "MOTA": "CLEAR", "IDSW": "CLEAR", "IDF1": "Identity"}
_COUNTED = {"IDSW"}  # no shares
_TOGETHER = "COMBINED_SEQ"

_WORKER = """
import json, sys
import numpy, trackeval
folder = sys.argv[1]
quiet = {"PRINT_CONFIG": False}
dataset = trackeval.datasets.Kitti2DBox(
    {"GT_FOLDER": folder + "/labels", "TRACKERS_FOLDER": folder + "/runs", "CLASSES_TO_EVAL": ["car"], **quiet})
metrics = [trackeval.metrics.HOTA(), trackeval.metrics.CLEAR(quiet), trackeval.metrics.Identity(quiet)]
outputs = dict.fromkeys(["PRINT_RESULTS", "OUTPUT_SUMMARY", "OUTPUT_DETAILED", "PLOT_CURVES", "TIME_PROGRESS"], False)
found, _ = trackeval.Evaluator({**quiet, **outputs, "LOG_ON_ERROR": None}).evaluate([dataset], metrics)
plain = {
    run: {drive: {name: {key: float(numpy.mean(value)) for key, value in numbers.items()}
                  for name, numbers in parts["car"].items()} for drive, parts in drives.items()}
    for run, drives in found["Kitti2DBox"].items()
}
with open(folder + "/found.json", "w") as file:
    json.dump(plain, file)
"""


def labels(drive: Drive) -> dict[int, TrackedObjects]:
    """What is labelled in each frame that is labelled, numbered from 0: what is drawn over is an area to ignore."""
    found = {}
    for number, frame in enumerate(frame for frame in drive.frames if frame.labelled):
        kinds = np.array(frame.objects.kind, dtype=object)
        kinds[~frame.usable] = _IGNORED
        tracks = np.where(kinds == _IGNORED, -1, frame.tracks)
        found[number] = TrackedObjects(replace(frame.objects, kind=tuple(kinds.tolist())), tracks)
    return found


def followed(drive: Drive, path: Path) -> dict[int, TrackedObjects]:
    """What a run found in those frames, numbered alike.

    Raises:
        InvalidInputError: The file is not there, or is none of tracking results.
    """
    rows = read_tracking(path)
    numbers = [frame.number for frame in drive.frames if frame.labelled]
    return {number: rows[frame] for number, frame in enumerate(numbers) if frame in rows}


def prepare(drives: Sequence[Drive], runs: Mapping[str, Path], folder: Path) -> None:
    """Fill a folder with files as TrackEval reads KITTI's."""
    lengths = []
    for drive in drives:
        labelled = labels(drive)
        lengths.append(f"{drive.name} empty 000000 {len(labelled):06d}\n")
        _write(folder / "labels" / "label_02" / f"{drive.name}.txt", labelled)
        for name, run in runs.items():
            found = followed(drive, run / drive.name / "tracks.txt")
            _write(folder / "runs" / name / "data" / f"{drive.name}.txt", found)
    write_text(folder / "labels" / "evaluate_tracking.seqmap.training", "".join(lengths))


def _write(path: Path, frames: Mapping[int, TrackedObjects]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, format_tracking(frames))


def judge(folder: Path, interpreter: Path) -> dict[str, dict[str, dict[str, float]]]:
    """TrackEval's numbers by run, drive and name: percent, but for the number of times that an id changes."""
    subprocess.run([interpreter, "-c", _WORKER, folder], check=True, stdout=subprocess.DEVNULL)
    found = json.loads((folder / "found.json").read_text())
    return {
        run: {
            drive: {
                name: numbers[family][name] * (1.0 if name in _COUNTED else 100.0) for name, family in _NUMBERS.items()
            }
            for drive, numbers in drives.items()
        }
        for run, drives in found.items()
    }


def table(found: Mapping[str, Mapping[str, Mapping[str, float]]]) -> list[str]:
    """Markdown: a row for each run on each drive, and on all."""
    lines = [f"| run | drive | {' | '.join(_NUMBERS)} |", f"| --- | --- |{' ---: |' * len(_NUMBERS)}"]
    for run, drives in found.items():
        for drive, numbers in drives.items():
            cells = [f"{value:.0f}" if name in _COUNTED else f"{value:.1f}" for name, value in numbers.items()]
            lines.append(f"| {run} | {'all' if drive == _TOGETHER else drive} | {' | '.join(cells)} |")
    return lines


def main() -> None:
    """Prepare, judge, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("drives", nargs="+", type=Path, metavar="DRIVE")
    parser.add_argument("--run", action="append", required=True, metavar="NAME=FOLDER")
    parser.add_argument("--trackeval", type=Path, required=True, metavar="PYTHON", help="Interpreter with trackeval")
    parser.add_argument("--json", type=Path, metavar="FILE")
    given = parser.parse_args()
    runs = {name: Path(folder) for name, _, folder in (text.partition("=") for text in given.run)}
    with tempfile.TemporaryDirectory() as folder:
        prepare([read_drive(path.absolute()) for path in given.drives], runs, Path(folder))
        found = judge(Path(folder), given.trackeval)
    print("\n".join(table(found)))
    if given.json is not None:
        write_text(given.json, json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
