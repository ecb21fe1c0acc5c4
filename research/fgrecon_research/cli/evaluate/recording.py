"""Recordings of `fgrecon evaluate tracks`: one method's results beside the labels. Imported when they are wanted."""

from __future__ import annotations

from collections.abc import Sequence

from fgrecon.calibration.setup import SceneKnowledge
from fgrecon.cli.track_report import image_numbers, truth_of
from fgrecon.core.errors import FgreconError, InvalidInputError
from fgrecon.core.reconstruction import Reconstruction, Status
from fgrecon.core.track_reconstruction import TrackReconstruction
from fgrecon.io.track_file import Track
from fgrecon.viz import Recording, TrackInputs, track_recording_of
from fgrecon_research.evaluation.methods import Method


def recorded(methods: Sequence[Method]) -> Method:
    """The method that is recorded: the last one with a result to play back.

    Raises:
        InvalidInputError: All are baselines.
    """
    known = [method for method in methods if method.reconstruct is not None]
    if not known:
        names = ", ".join(method.name for method in methods)
        raise InvalidInputError("method", names, "Run one of fgrecon's own too: the others have nothing to record.")
    return known[-1]


def recordings(tracks: Sequence[Track], method: Method, scene: SceneKnowledge) -> list[tuple[str, Recording]]:
    """Name and recording of every track, solved once more frame by frame, with the labels as the truth.

    A track of which no frame can be solved has none.
    """
    made = []
    for track in tracks:
        result = _solve(track, method, scene)
        if result is not None:
            sight = TrackInputs(
                observations=[frame.observation for frame in track.frames],
                cameras=[track.camera] * len(track.frames),
                numbers=image_numbers([frame.name for frame in track.frames]),
                truths=[truth_of(track, index) for index in range(len(track.frames))],
                ground=scene.ground if "ground" in method.name else None,
            )
            made.append((track.name, track_recording_of(result, sight)))
    return made


def _solve(track: Track, method: Method, scene: SceneKnowledge) -> TrackReconstruction | None:
    """The frames one by one as a track without a joint optimisation; None where none was solved."""
    assert method.reconstruct is not None
    solved: dict[int, Reconstruction] = {}
    refused: dict[int, str] = {}
    for index, frame in enumerate(track.frames):
        if frame.observation is None:
            refused[index] = "no keypoints"
            continue
        try:
            result = method.reconstruct(scene, frame.observation, track.camera)
        except FgreconError as error:
            refused[index] = str(error)
            continue
        if result.status is Status.FAILED:
            refused[index] = result.message
        else:
            solved[index] = result
    if not solved:
        return None
    frames = tuple(solved.values())
    terms = dict.fromkeys(term for frame in frames for term in frame.diagnostics.energies)
    stages = dict.fromkeys(stage for frame in frames for stage in frame.diagnostics.milliseconds)
    settled = all(frame.status.settled for frame in frames)
    return TrackReconstruction(
        status=Status.CONVERGED if settled else Status.AMBIGUOUS,
        message=f"{len(frames)} of {len(track.frames)} frames, each on its own, by {method.name}",
        numbers=tuple(solved),
        frames=frames,
        refused=refused,
        energies={term: sum(frame.diagnostics.energies.get(term, 0.0) for frame in frames) for term in terms},
        history=(),
        graph=(),
        milliseconds={
            stage: sum(frame.diagnostics.milliseconds.get(stage, 0.0) for frame in frames) for stage in stages
        },
    )
