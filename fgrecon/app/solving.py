"""Work of a service's processes: solve uploaded files, and make the requested outputs.

They are run in processes of their own (`fgrecon.app.workers`), by the parts that commands are made of.
"""

from __future__ import annotations

import warnings as python_warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from fgrecon.app.requested import Requested
from fgrecon.batch.file_service import FileRequest, SolvedFile, is_image, read_file, solve_file
from fgrecon.batch.solve_tasks import check_any
from fgrecon.core.errors import ContradictoryInputWarning, FgreconError, InvalidInputError
from fgrecon.perception.boxes import GivenBoxes


@dataclass(frozen=True)
class Uploaded:
    """Names of uploaded files, in the folder that a worker is given."""

    main: str  # a photograph or a keypoint file
    camera: str | None = None  # a calibration file, or None
    boxes: str | None = None  # a file of boxes, or None
    photograph: str | None = None  # what the keypoints are drawn on, or None

    @property
    def of_image(self) -> bool:
        """Whether it is a photograph."""
        return is_image(Path(self.main))


@contextmanager
def without_folder(folder: Path) -> Iterator[None]:
    """Errors say names of uploaded files as their sender knows them."""
    try:
        yield
    except InvalidInputError as error:
        where, value, fix = (
            part.replace(f"{folder}/", "") if isinstance(part, str) else part
            for part in (error.field, error.value, error.fix)
        )
        raise type(error)(str(where), value, str(fix)) from None


def solve(folder: Path, uploaded: Uploaded, requested: Requested, *, history: bool | None = None) -> SolvedFile:
    """The vehicles of a photograph or a keypoint file.

    Args:
        folder: Where the files are.
        uploaded: Their names.
        history: Whether steps are kept; None for what is requested.
    """
    with without_folder(folder), python_warnings.catch_warnings():
        python_warnings.simplefilter("ignore", ContradictoryInputWarning)  # `SolvedFile.warnings` says it
        request = _request(folder, uploaded, requested, history=history)
        photograph = None if uploaded.photograph is None else folder / uploaded.photograph
        return solve_file(read_file(folder / uploaded.main, request, photograph), request)


def _request(folder: Path, uploaded: Uploaded, requested: Requested, *, history: bool | None) -> FileRequest:
    given = requested.boxes()
    if given and not uploaded.of_image:
        raise InvalidInputError("box", requested.box[0], "Leave it out: the boxes are in the keypoint file.")
    file = None if uploaded.boxes is None or given else folder / uploaded.boxes
    source = requested.source()
    return FileRequest(
        settings=requested.settings(history=history),
        source=source if uploaded.camera is None else replace(source, file=str(folder / uploaded.camera)),
        boxes=GivenBoxes(given, file, least_score=requested.number("min_score")),
        box_model=requested.given_box_model,
        names=requested.names or None,
        together=requested.together == "yes" if requested.together else None,
    )


def results_text(folder: Path, uploaded: Uploaded, requested: Requested) -> str:
    """The results file of an upload, as `fgrecon reconstruct --json` writes it, with what there is to warn of.

    Raises:
        InvalidInputError: A file or a value cannot be used, or that is so of every vehicle.
        FgreconError: Solving failed on every vehicle.
    """
    solved = solve(folder, uploaded, requested)
    if not check_any(Path(uploaded.main), solved.outcomes):
        reason = next((str(one.error) for one in solved.outcomes if one.error is not None), "no pose was found")
        raise FgreconError(f"No vehicle could be reconstructed: {reason}")
    history = requested.keeps_history
    text = solved.document(history=history, warnings=solved.warnings, path=Path(uploaded.main))
    return text.replace(f"{folder}/", "")


@lru_cache(maxsize=1)
def make_ready() -> bool:
    """Load what solves need, so that the first request does not wait for it."""
    from fgrecon.io.catalogue import load_prior
    from fgrecon.perception.boxes import detected_boxes
    from fgrecon.perception.keypoints.detect import shipped_cascade
    from fgrecon.simulation.sample import sample_street
    from fgrecon.solve.pipeline import reconstruct

    prior = load_prior("car14")
    street = sample_street(prior)
    detected_boxes(street.image)
    shipped_cascade()
    reconstruct(street.cars[0].observation, street.camera, prior=prior)
    return True
