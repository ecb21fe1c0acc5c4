"""Make the files of our own estimates that a release has for download: keypoints in, poses out, for each data set.

    python docs/results.py OUT --data DATA [NAME...]

Names: sample (needs no data), tracks, images, drives; without one all are made. Of each input there is a results file
(`docs/reference/formats.md`) and a CSV of the same vehicles, made by `fgrecon reconstruct` with the options of the
protocol (`docs/explanation/comparing.md`). `manifest.json` says by what they were made, `sha256sum -c SHA256SUMS`
checks them. Nothing of the data sets is in them: no image, no label, no 2D box.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from fgrecon.io.export import export, read_results
from fgrecon_research.evaluation.report import machine, versions

ROOT = Path(__file__).parents[1]
KNOWN = ["--size-prior", "kitti", "--camera-height", "1.65"]
PIXELS = ["--weights", "photographs", *KNOWN]
"""Options of images: networks that have learnt from no image of KITTI."""
TERMS = {"sample": "of the repository"}
"""Of the data that the estimates are of, where they are not KITTI's."""
Input = tuple[str, list[str | Path]]


def sample(_data: Path, work: Path) -> Iterator[Input]:
    """The simulated street that every installation can make."""
    subprocess.run([sys.executable, "-m", "fgrecon", "sample", "--out", work / "sample", "-q"], check=True)
    yield "street", [work / "sample/cars.json", *KNOWN]


def tracks(data: Path, _work: Path) -> Iterator[Input]:
    """Keypoints of a stacked-hourglass network, each frame by itself."""
    for file in sorted((data / "kitti_tracking_keypoints14").glob("*.json")):
        yield file.stem, [file, *KNOWN]


def images(data: Path, _work: Path) -> Iterator[Input]:
    """KITTI's single images with labelled 2D boxes."""
    kitti = data / "kitti_object/training"
    yield "kitti_object", [kitti / "image_2", "--calib", kitti / "calib", "--boxes", kitti / "label_2", *PIXELS]


def drives(data: Path, _work: Path) -> Iterator[Input]:
    """KITTI's drives with labelled 2D boxes, each image by itself."""
    for drive in sorted((data / "kitti_video").iterdir()):
        if (drive / "image_02").is_dir():
            given = ["--calib", drive / "calib.txt", "--boxes", drive / "label_02.txt"]
            yield drive.name, [drive / "image_02", *given, *PIXELS]


DATA_SETS = {made.__name__: made for made in (sample, tracks, images, drives)}


def solved(arguments: Sequence[str | Path], name: str, work: Path) -> dict[str, Any]:
    """One results document of an input, whether it is a file of keypoints or a folder of images.

    Raises:
        RuntimeError: Nothing was reconstructed.
    """
    out = work / name
    many = Path(arguments[0]).is_dir()
    wanted = ["--out", out] if many else ["--json", out.with_suffix(".json")]
    command = [sys.executable, "-m", "fgrecon", "reconstruct", *map(str, [*arguments, *wanted]), "-q"]
    done = subprocess.run(command, check=False, capture_output=True, text=True)  # 1 where an image has no car
    documents = [
        json.loads(file.read_text(encoding="utf-8"))
        for file in (sorted(out.glob("*.json")) if many else [out.with_suffix(".json")])
        if file.exists()
    ]
    if done.returncode not in (0, 1) or not documents:
        raise RuntimeError(done.stderr)
    whole = {**documents[0], "file": name, "left_out": {}, "scenes": [], "instances": []}
    for document in documents:
        for vehicle in document["instances"]:
            image = f"{Path(vehicle['image']).stem}:" if many else ""
            whole["instances"].append({**vehicle, "id": f"{image}{vehicle['id']}", "box": None})
    return whole


def commit() -> str:
    """The repository's commit, `-dirty` where files differ from it."""
    command = ["git", "describe", "--always", "--dirty"]
    return subprocess.run(command, cwd=ROOT, check=False, capture_output=True, text=True).stdout.strip() or "unknown"


def manifest(names: Sequence[str]) -> dict[str, Any]:
    """By what the files were made."""
    return {
        "format": "fgrecon.release_results/1",
        "fgrecon": metadata.version("fgrecon"),
        "commit": commit(),
        "packages": versions(),
        "machine": machine(),
        "data_sets": {
            name: {
                "input": (DATA_SETS[name].__doc__ or "").strip(),
                "options": KNOWN if name in ("sample", "tracks") else PIXELS,
                "terms_of_the_data": TERMS.get(name, "KITTI: CC BY-NC-SA 3.0"),
            }
            for name in names
        },
    }


def make(out: Path, data: Path, names: Sequence[str]) -> None:
    """Write the files of some data sets into a folder, and their manifest and checksums.

    Raises:
        RuntimeError: Nothing of an input was reconstructed.
    """
    for name in names:
        (folder := out / name).mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory() as work:
            for stem, arguments in DATA_SETS[name](data, Path(work)):
                document = solved(arguments, stem, Path(work))
                (folder / f"{stem}.json").write_text(json.dumps(document, allow_nan=False) + "\n", encoding="utf-8")
                vehicles = read_results(folder / f"{stem}.json")
                export(folder / f"{stem}.csv", vehicles)
                print(f"{name}/{stem}: {len(vehicles)} vehicles")
    there = [name for name in DATA_SETS if (out / name).is_dir()]
    (out / "manifest.json").write_text(json.dumps(manifest(there), indent=1) + "\n", encoding="utf-8")
    files = sorted(path for path in out.rglob("*") if path.is_file() and path.name != "SHA256SUMS")
    lines = [f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.relative_to(out).as_posix()}\n" for file in files]
    (out / "SHA256SUMS").write_text("".join(lines), encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("names", nargs="*", choices=[[], *DATA_SETS], default=[])
    parser.add_argument("--data", type=Path, default=Path("DATA"))
    given = parser.parse_args()
    make(given.out, given.data, given.names or list(DATA_SETS))
