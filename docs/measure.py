"""Make the tables of docs/tables again, each headed by its command, commit and machine.

    python docs/measure.py --data DATA [NAME...]

Names: tracks, together, over_tracks, kitti, icra2017, shape, models, priors_in_use, priors, paper; without one all are
made (an hour on one core).
Every figure that the documentation quotes without another source stands in one of these tables.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from results import commit

from fgrecon import Options, Tracker
from fgrecon.core.metrics import orientation_error
from fgrecon.io.catalogue import load_category
from fgrecon.io.track_file import GroundTruth, read_track
from fgrecon_research.evaluation.measures import THRESHOLDS, orientation_precision
from fgrecon_research.evaluation.report import machine

TABLES = Path(__file__).parent / "tables"
GIVEN = {"+size": ["--size-prior", "kitti"], "+ground+size": ["--size-prior", "kitti", "--camera-height", "1.65"]}
"""What `fgrecon track` is given, by the name of the row."""
RATE = 10.0
"""Images of KITTI's drives in a second."""


def run(arguments: Sequence[str | Path]) -> None:
    """Run `fgrecon` with the arguments; its own output is not shown."""
    command = [sys.executable, "-m", "fgrecon", *map(str, arguments)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def loaded(arguments: Sequence[str | Path], folder: Path) -> dict[str, Any]:
    """What a command writes as JSON."""
    file = folder / "out.json"
    run([*arguments, "--json", file])
    return json.loads(file.read_text(encoding="utf-8"))


def table(heads: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A Markdown table; the first column is text."""
    lines = [heads, ["---", *["---:"] * (len(heads) - 1)], *rows]
    return "".join(f"| {' | '.join(map(str, line))} |\n" for line in lines)


def track_files(data: Path) -> list[Path]:
    """The three tracks with keypoints of a network."""
    return sorted((data / "kitti_tracking_keypoints14").glob("*.json"))


def kitti_folders(data: Path) -> list[str | Path]:
    """Options that name KITTI's images, labels and calibrations."""
    training = data / "kitti_object/training"
    return ["--images", training / "image_2", "--labels", training / "label_2", "--calib", training / "calib"]


def tracks(data: Path, folder: Path) -> str:
    """Every method and every robust strategy on the three tracks."""
    every, robust = folder / "every.md", folder / "robust.md"
    run(["evaluate", "tracks", *track_files(data), "--markdown", every])
    strategies = ["mixture", "paper", "paper_literal", "none", "huber", "cauchy", "geman_mcclure", "tukey", "gnc"]
    methods = [part for name in strategies for part in ("--method", f"fgrecon+ground+size:{name}")]
    run(["evaluate", "tracks", *track_files(data), *methods, "--markdown", robust])
    return f"{_without_times(every)}\nBy robust strategy:\n\n{_without_times(robust)}"


def _without_times(file: Path) -> str:
    """A table without its columns of milliseconds: those of a busy machine say nothing."""
    heads, rule, *rows = [line.strip("| ").split(" | ") for line in file.read_text(encoding="utf-8").splitlines()]
    kept = [i for i, head in enumerate(heads) if not head.startswith("ms ")]
    return "".join(f"| {' | '.join(line[i] for i in kept)} |\n" for line in (heads, rule, *rows))


def together(data: Path, folder: Path) -> str:
    """The images of each track solved with one shape, beside the same images one by one."""
    rows = []
    for name, given in GIVEN.items():
        for kind, errors in _from_images(data, folder, given).items():
            yaw, metres, size = np.mean(errors, axis=0)
            rows.append([f"{kind}, {name}", len(errors), f"{yaw:.2f}", f"{metres:.2f}", f"{100 * size:.0f}"])
    return table(["solved", "images", "mean yaw °", "mean position m", "mean of length, width, height cm"], rows)


def over_tracks(data: Path, folder: Path) -> str:
    """The same, and the images followed over time."""
    rows = []
    for name, given in GIVEN.items():
        height = float(given[-1]) if "--camera-height" in given else None
        for kind, errors in (_from_images(data, folder, given) | _over_time(data, height)).items():
            yaw, metres, size = np.array(errors).T
            within = " / ".join(f"{100 * orientation_precision(yaw, threshold):.1f}" for threshold in THRESHOLDS)
            position = [f"{np.median(metres):.2f}", f"{metres.mean():.2f}"]
            rows.append(
                [f"{kind}, {name}", len(yaw), f"{yaw.mean():.2f}", within, *position, f"{100 * size.mean():.0f}"]
            )
    heads = ["solved", "images", "mean yaw °", "AOP 5 / 15 / 30° %", "median m", "mean m"]
    return table([*heads, "mean of length, width, height cm"], rows)


Errors = tuple[float, float, float]
"""Of yaw in degrees, of position and of size in metres."""


def _from_images(data: Path, folder: Path, given: Sequence[str]) -> dict[str, list[Errors]]:
    """Errors of all images of the tracks, solved with one shape for each track and by themselves."""
    category = load_category("car14")
    truth = {frame.name: frame.truth for file in track_files(data) for frame in read_track(file, category).frames}
    options = [*given, "--box-model", "cuboid"]
    joint = loaded(["track", *track_files(data), *options], folder)["instances"]
    alone = [car for f in track_files(data) for car in loaded(["reconstruct", f, *options], folder)["instances"]]
    return {
        kind: [
            _errors(car["rotation_y"], car["location_in_label_frame"], car["result"]["box_size"], truth[car["id"]])
            for car in cars
        ]
        for kind, cars in (("one shape", joint), ("image by image", alone))
    }


def _over_time(data: Path, height: float | None) -> dict[str, list[Errors]]:
    """Errors of all images of the tracks as `fgrecon.Tracker` has them, after each image and at the end."""
    found: dict[str, list[Errors]] = {"online": [], "in batch": []}
    for file in track_files(data):
        track = read_track(file, load_category("car14"))
        tracker = Tracker(size_prior="kitti", options=Options(box="cuboid"))
        online = []
        for frame in track.frames:
            time = int(frame.name.rpartition(":")[2]) / RATE
            assert frame.observation is not None
            online.append(tracker.update(time, {0: frame.observation}, camera=track.camera, ground=height)[0])
        for kind, estimates in (("online", online), ("in batch", tracker.smooth()[0])):
            for frame, estimate in zip(track.frames, estimates, strict=True):
                result = estimate.reconstruction
                place = result.location - track.label_offset
                found[kind].append(_errors(result.rotation_y, place, result.box_size, frame.truth))
    return found


def _errors(yaw: float, location: ArrayLike, size: ArrayLike, label: GroundTruth) -> Errors:
    """Of a yaw in radians, a location in the label's frame and a size."""
    assert label.box_size is not None
    degrees = float(orientation_error([yaw], [label.rotation_y])[0])
    metres = float(np.linalg.norm(np.subtract(location, label.location)))
    return degrees, metres, float(np.abs(np.subtract(size, label.box_size)).mean())


def kitti(data: Path, folder: Path) -> str:
    """From 19 photographs to poses, by kind of box."""
    release, own = folder / "release.txt", folder / "own.txt"
    detections = data / "kitti_object/detections_2d"
    release.write_text("".join(file.read_text(encoding="utf-8") for file in sorted(detections.glob("*.txt"))), "utf-8")
    images = sorted((data / "kitti_object/training/image_2").glob("*.png"))
    run(["vehicles", "detect", *images, "--out", own])
    surface = ["--box-model", "surface"]
    kinds: dict[str, list[str | Path]] = {
        "labelled": [],
        "labelled, `--box-model surface`": surface,
        "a detector's, trained on KITTI": ["--boxes", release],
        "`--detect`, overlap above 0.5": ["--boxes", own, "--overlap", "0.5", *surface],
    }
    rows = []
    for kind, options in kinds.items():
        for regime in loaded(["evaluate", "kitti", *kitti_folders(data), *options], folder)["regimes"]:
            within = " / ".join(str(count) for count in regime["within"].values())
            degrees, metres = f"{regime['mean_degrees']:.1f}", f"{regime['median_metres']:.2f}"
            rows.append([kind, regime["name"], regime["cars"], within, degrees, metres, regime["failures"]])
    heads = ["boxes", "regime", "cars", "within 5 / 15 / 30°", "mean °", "median m", "without a box or result"]
    return table(heads, rows)


def icra2017(data: Path, folder: Path) -> str:
    """The two images of the authors' release."""
    found = loaded(["evaluate", "icra2017", data / "icra2017"], folder)
    images, release = found["images"], found["release"]
    rows = [
        [
            name,
            *(f"{source[name][what]:.2f}" for source in (images, release) for what in ("orientation_deg", "centre_m")),
        ]
        for name in images
    ]
    return table(["image", "orientation °", "box centre m", "release: orientation °", "release: centre m"], rows)


def shape(data: Path, folder: Path) -> str:
    """Simulated views of real car models that the prior does not know, with every energy term switched off in turn."""
    file = folder / "shape.md"
    run(["evaluate", "shape", "--data", data, "--markdown", file])
    return file.read_text(encoding="utf-8")


def models(data: Path, folder: Path) -> str:
    """How often the right one of 79 car models is among the closest."""
    file = folder / "models.md"
    run(["evaluate", "models", "--data", data, "--markdown", file])
    return file.read_text(encoding="utf-8")


def priors_in_use(data: Path, folder: Path) -> str:
    """The shipped prior and priors learnt from 300 annotated images, on the three tracks."""
    marks = data / "veri_keypoints14/keypoints.npz"
    learn = ["prior", "learn", marks, "--category", "car14", "--images", "300"]
    learnt, freed = folder / "learnt.npz", folder / "perspective.npz"
    run([*learn, "--out", learnt])
    run([*learn, "--perspective", "--out", freed])
    names = ["fgrecon", "fgrecon+size", "fgrecon+ground+size"]
    methods = [part for name in names for part in ("--method", name)]
    rows = []
    for label, prior in (("`car14`", "car14"), ("learnt", learnt), ("learnt, `--perspective`", freed)):
        found = loaded(["evaluate", "tracks", *track_files(data), *methods, "--prior", prior], folder)["methods"]
        for name, score in found.items():
            aop = " / ".join(f"{share:.1f}" for share in score["aop"].values())
            rows.append([label, name, f"{score['mae_deg']:.2f}", aop, f"{score['median_translation_m']:.2f}"])
    return table(["prior", "method", "mean °", "AOP 5 / 15 / 30° %", "median m"], rows)


def priors(data: Path, folder: Path) -> str:
    """What priors learnt from 2D annotations are like, by `benchmarks/bench_nrsfm.py`."""
    del folder
    command = [sys.executable, "-m", "benchmarks.bench_nrsfm", "--data", str(data), "--repeats", "3"]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.lstrip()


PAPER_LEFT_OUT = ("APK of each part", "Harder keypoints", "Known shape by", "Real tracks", "Run")
"""Beginnings of the titles of what `fgrecon evaluate paper` writes beside: details, and what other tables have."""


def paper(data: Path, folder: Path) -> str:
    """The paper's claims and tables, of the whole simulated set."""
    run(["evaluate", "paper", "--data", data, "--out", folder])
    text = (folder / "evaluation.md").read_text(encoding="utf-8")
    sections = text.partition("# Evaluation\n")[2].split("\n## ")
    kept = [part for part in sections if not part.startswith(PAPER_LEFT_OUT)]
    return "\n### ".join(kept).strip() + "\n"


MADE: Mapping[str, Callable[[Path, Path], str]] = {
    made.__name__: made
    for made in (tracks, together, over_tracks, kitti, icra2017, shape, models, priors_in_use, priors, paper)
}
"""What makes each table, by its name."""


def main() -> None:
    """Make the tables that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(MADE))
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    arguments = parser.parse_args()
    made = f"fgrecon {metadata.version('fgrecon')}, {commit()}; {machine()['processor']}"
    for name in arguments.names or MADE:
        with tempfile.TemporaryDirectory() as folder:
            text = MADE[name](arguments.data, Path(folder))
        head = f"*`python docs/measure.py {name} --data DATA` ({made})*\n\n"
        (TABLES / f"{name}.md").write_text(head + text, encoding="utf-8")
        print(TABLES / f"{name}.md", flush=True)


if __name__ == "__main__":
    main()
