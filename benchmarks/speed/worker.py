"""A process that solves cases with the `fgrecon` that its PYTHONPATH gives: this tree's, or an earlier release's.

It is started as a file, reads one JSON request a line and answers with one. Of the package it uses nothing but
`reconstruct`, `reconstruct_track` and `load_prior`, so that any version of it can be asked; of later ones also
`reconstruct_scene` and `Tracker`.

Requests, on the cases of the file in its first argument:
    {"solve": index, "history": bool}   milliseconds, pose, coefficients, and a digest of their bits
    {"track": [index, ...]}             milliseconds for one car in these images, and the memory that it took at most
    {"scene": [index, ...]}             milliseconds for these cars in one image
    {"frames": file}                    milliseconds of CPU a car, for every frame of a file with vehicles over time
    {"bits": [index, ...]}              digests by one thread, eight threads and forked processes
    {"memory": null}                    resident memory now
"""

from __future__ import annotations

import gc
import hashlib
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

import fgrecon
from fgrecon import load_prior, reconstruct

CASES: list[dict[str, Any]] = []


@cache
def prior(name: str) -> Any:
    """The prior, read once."""
    return load_prior(name)


def options(case: dict[str, Any], *, history: bool = False) -> Any:
    """Settings; releases before settings had groups take the same word for the box."""
    try:
        from fgrecon import BoxOptions

        return fgrecon.Options(box=BoxOptions(model=case["box_model"]), keep_history=history)
    except ImportError:
        return fgrecon.Options(box_model=case["box_model"], keep_history=history)


def clocked(call: Callable[[], Any]) -> tuple[Any, float, float]:
    """What a call gives, and its milliseconds of CPU and by the clock."""
    wall, cpu = time.perf_counter(), time.process_time()
    result = call()
    return result, 1e3 * (time.process_time() - cpu), 1e3 * (time.perf_counter() - wall)


def solve(index: int, *, history: bool = False) -> Any:
    """The reconstruction of one case."""
    case = CASES[index]
    arrays = {name: np.array(case[name], dtype=float) for name in ("keypoints", "confidence", "box", "camera")}
    return reconstruct(
        arrays["keypoints"],
        arrays["camera"],
        confidence=arrays["confidence"],
        box=arrays["box"],
        prior=prior(case["prior"]),
        ground=case["ground"],
        size_prior=case["size"],
        options=options(case, history=history),
    )


def part(result: Any, group: str, name: str) -> Any:
    """A part of a result; earlier releases have no groups."""
    return getattr(getattr(result, group, result), name)


def digest(result: Any) -> str:
    """The bits of pose and shape, in short."""
    parts = (result.camera_T_object, part(result, "shape", "coefficients"), result.wireframe)
    return hashlib.sha256(b"".join(np.ascontiguousarray(one).tobytes() for one in parts)).hexdigest()[:16]


def answer_solve(index: int, *, history: bool = False) -> dict[str, Any]:
    """One case, timed."""
    try:
        result, cpu, wall = clocked(lambda: solve(index, history=history))
    except fgrecon.errors.FgreconError as error:
        return {"refused": str(error)}
    return {
        "cpu": cpu,
        "wall": wall,
        "stages": dict(part(result, "diagnostics", "milliseconds")),
        "pose": result.camera_T_object.tolist(),
        "coefficients": part(result, "shape", "coefficients").tolist(),
        "status": str(result.status),
        "digest": digest(result),
    }


def answer_track(indices: list[int]) -> dict[str, Any]:
    """One car in several images, timed."""
    from fgrecon import Camera, Observation, reconstruct_track

    first = CASES[indices[0]]
    arrays = [{k: np.array(CASES[i][k], dtype=float) for k in ("keypoints", "confidence", "box")} for i in indices]
    seen = [Observation(a["keypoints"], a["confidence"], a["box"]) for a in arrays]
    solve(indices[0])  # loads what is loaded on use
    gc.collect()
    forget_peak()
    before = resident()
    result, cpu, wall = clocked(
        lambda: reconstruct_track(
            seen,
            Camera(np.array(first["camera"])),
            prior=prior(first["prior"]),
            ground=first["ground"],
            size_prior=first["size"],
            options=options(first),
        )
    )
    return {
        "cpu": cpu,
        "wall": wall,
        "memory": resident("VmHWM") - before,
        "stages": dict(result.milliseconds),
    }


def answer_scene(indices: list[int]) -> dict[str, Any]:
    """Cars of one image on one ground, timed."""
    from fgrecon import Camera, Observation, reconstruct_scene

    first = CASES[indices[0]]
    seen = [
        Observation(*(np.array(CASES[i][k], dtype=float) for k in ("keypoints", "confidence", "box"))) for i in indices
    ]
    given = {"prior": prior(first["prior"]), "ground": first["ground"], "size_prior": first["size"]}
    camera = Camera(np.array(first["camera"]))
    _, cpu, wall = clocked(lambda: reconstruct_scene(seen, camera, options=options(first), **given))
    return {"cpu": cpu, "wall": wall}


def answer_frames(file: str) -> dict[str, list[float]]:
    """Vehicles over time, followed by `Tracker`: milliseconds of CPU a car of each frame."""
    from fgrecon import Camera, Observation, Tracker

    content = json.loads(Path(file).read_text(encoding="utf-8"))
    tracker = Tracker(size_prior=content["size"], options=fgrecon.Options(keep_history=False))
    given = {"camera": Camera(np.array(content["camera"])), "ground": content["ground"]}
    taken = []
    for frame in content["frames"]:
        pose = None if frame["world_T_camera"] is None else np.array(frame["world_T_camera"])
        seen = {
            int(identity): Observation(**{k: np.array(v) if isinstance(v, list) else v for k, v in one.items()})
            for identity, one in frame["vehicles"].items()
        }
        _, cpu, _ = clocked(partial(tracker.update, frame["time"], seen, world_T_camera=pose, **given))
        if seen:
            taken.append(cpu / len(seen))
    return {"cpu": taken}


def answer_bits(indices: list[int]) -> dict[str, list[str]]:
    """The same cases by one thread, by eight at once, and by forked processes."""
    one = [digest(solve(index)) for index in indices]
    with ThreadPoolExecutor(8) as pool:
        eight = list(pool.map(digest_of, indices * 2))[len(indices) :]
    found = {"one thread": one, "eight threads": eight}
    if hasattr(os, "fork"):
        with multiprocessing.get_context("fork").Pool(2) as pool:
            found["forked"] = pool.map(digest_of, indices)
    return found


def digest_of(index: int) -> str:
    """The bits of a case's result."""
    return digest(solve(index))


def resident(name: str = "VmRSS") -> float:
    """Resident memory now, MiB, or with `VmHWM` the most since `forget_peak`; 0 where the system does not say."""
    status = Path("/proc/self/status")
    lines = status.read_text(encoding="ascii").splitlines() if status.exists() else []
    return sum(int(line.split()[1]) for line in lines if line.startswith(f"{name}:")) / 1024.0


def forget_peak() -> None:
    """Let the most resident memory be that of now."""
    with suppress(OSError):  # not on Linux, or not allowed
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def main() -> None:
    """Answer requests until there are no more."""
    CASES.extend(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8")))
    for line in sys.stdin:
        request = json.loads(line)
        if "solve" in request:
            answer: dict[str, Any] = answer_solve(request["solve"], history=request.get("history", False))
        elif "track" in request:
            answer = answer_track(request["track"])
        elif "scene" in request:
            answer = answer_scene(request["scene"])
        elif "frames" in request:
            answer = answer_frames(request["frames"])
        elif "bits" in request:
            answer = answer_bits(request["bits"])
        else:
            gc.collect()
            answer = {"memory": resident()}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
