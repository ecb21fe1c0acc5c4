"""Measurements of the paper's evaluation in one process: real keypoints, and run times.

In a process of its own with one thread: times would otherwise depend on what the linear algebra does in parallel.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from time import perf_counter

from fgrecon.calibration.labelled_frames import SceneKnowledge
from fgrecon.core.processes import processes
from fgrecon.core.robust import StrategyName
from fgrecon.io.track_file import Track
from fgrecon_research.evaluation import report
from fgrecon_research.evaluation.methods import METHODS, select
from fgrecon_research.evaluation.run import MethodScores, score_tracks
from fgrecon_research.paper.network import NetworkScores, score_network
from fgrecon_research.paper.simulated import Fleet, SimulatedInstance, simulate_frame
from fgrecon_research.paper.simulated_run import PaperSettings, Validation
from fgrecon_research.paper.simulated_scores import row_solvers
from fgrecon_research.paper.tables import Table

_TIMED = 40
_REAL_TRACKS = ("real_tracks", "Real tracks: network keypoints on KITTI tracking")
_REAL_IMAGES = ("real_images", "Real images: keypoints marked by hand on KITTI cars")
_NETWORK_IMAGES = ("network_images", "Real images: own network's keypoints on the same cars")


@dataclass(frozen=True)
class Measured:
    """What was measured."""

    real: tuple[Table, ...]  # tables of real keypoints
    times: dict[str, list[float]]  # milliseconds on each simulated instance, by the name of what was timed
    load: float  # the machine's load after that
    network: NetworkScores  # what the network found on real images


def measure(
    tracks: Sequence[Track],
    images: Sequence[Track],
    instances: Sequence[SimulatedInstance],
    settings: PaperSettings,
    advance: Callable[[str, int, int], None] = lambda *_: None,
) -> Measured:
    """Measure everything."""
    step, scene, seed = "real keypoints, run times", settings.scene, settings.seed
    with processes(1) as alone:
        by_hand = [alone.submit(_real_table, *_REAL_TRACKS, tracks, scene)]
        by_hand += [alone.submit(_real_table, *_REAL_IMAGES, images, scene)]
        timed = alone.submit(_times, instances, scene, seed)
        real = []
        for done, future in enumerate(by_hand):
            advance(step, done, 5)
            real.append(future.result())
        times, load = timed.result(), os.getloadavg()[0]
        advance(step, 3, 5)
        network = alone.submit(score_network, settings.data, seed).result()
        advance(step, 4, 5)
        real.append(alone.submit(_real_table, *_NETWORK_IMAGES, _observed(images, network), scene).result())
        advance(step, 5, 5)
    return Measured(tuple(real), times, load, network)


def _observed(tracks: Sequence[Track], network: NetworkScores) -> list[Track]:
    """The tracks of one frame with what the network found in the place of the marks."""
    return [
        replace(track, frames=(replace(track.frames[0], observation=network.observations[track.name]),))
        for track in tracks
    ]


def _real_table(key: str, title: str, tracks: Sequence[Track], scene: SceneKnowledge) -> Table:
    strategies = [f"fgrecon+ground+size:{name.value}" for name in StrategyName if name is not StrategyName.MIXTURE]
    scores = score_tracks(tracks, select([*METHODS, *strategies]), scene)
    lines = tuple((entry.name, _real_cells(entry)) for entry in scores)
    columns = ("mean °", "median °", "AOP 5° %", "AOP 15° %", "AOP 30° %", "median m", "failed", "ms")
    note = f"{len(scores[0].frames)} instances; a failure counts as 180 degrees. Names say what a method is given."
    return Table(key, title, note, columns, lines, decimals=2)


def _real_cells(entry: MethodScores) -> tuple[float | None, ...]:
    summary = report.summary(entry)
    ms = sum(value for value in summary["ms"].values() if value is not None)
    aop = tuple(summary["aop"].values())
    return (summary["mae_deg"], summary["median_deg"], *aop, summary["median_translation_m"], len(entry.failures), ms)


def some_instances(validation: Validation, fleet: Fleet) -> list[SimulatedInstance]:
    """The first simulated instances with a detection."""
    observed = (i for frame in validation.frames for i in simulate_frame(frame, fleet) if i.observation is not None)
    return list(islice(observed, _TIMED))


def _times(instances: Sequence[SimulatedInstance], scene: SceneKnowledge, seed: int) -> dict[str, list[float]]:
    """Milliseconds of each stage, one instance after the other in this process."""
    names = {"aspnp+size": "ASPnP", "aspnp_irls+size": "ASPnP + IRLS", "poselib_ransac+size": "PoseLib RANSAC"}
    times: dict[str, list[float]] = {}
    for row, name in names.items():
        (solver,) = row_solvers((row,), scene, seed)
        solver(instances[0])
        times[name] = []
        for instance in instances:
            started = perf_counter()
            solver(instance)
            times[name].append(1e3 * (perf_counter() - started))
    ours = select(["fgrecon+ground+size"])[0].bind(scene)
    stages: dict[str, list[float]] = {"pose": [], "shape": []}
    for done, instance in enumerate([instances[0], *instances]):
        assert instance.observation is not None
        for stage, ms in ours(instance.observation, instance.camera).milliseconds.items():
            if done:
                stages[stage].append(ms)
    return {**times, "fgrecon, pose stage": stages["pose"], "fgrecon, shape stages": stages["shape"]}
