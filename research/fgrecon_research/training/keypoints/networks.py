"""The whole of `fgrecon keypoints train`: KNet in rounds, the refinement networks, the calibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.settings import check_settings, count, number
from fgrecon.io.files import stored as taken_over
from fgrecon.perception.keypoints.decode import ConfidenceCalibration
from fgrecon.perception.keypoints.detect import KeypointCascade
from fgrecon.perception.keypoints.network_file import Stored, save_weights
from fgrecon_research.training.keypoints.augment import Street
from fgrecon_research.training.keypoints.began import begin_alike, file_hash
from fgrecon_research.training.keypoints.calibrate import SCORED, calibrate
from fgrecon_research.training.keypoints.labelling import Labelling, Source, read_source
from fgrecon_research.training.keypoints.rounds import Beginning, train_in_rounds
from fgrecon_research.training.keypoints.street_cars import (
    LAST,
    StreetCars,
    StreetShare,
    check_drives,
    learning,
    prepare_street_cars,
)
from fgrecon_research.training.keypoints.train import Training
from fgrecon_research.training.keypoints.train_refine import RefineTraining, train_refinement
from fgrecon_research.training.keypoints.trainer import Display, load_tensors, mean_state
from fgrecon_research.training.keypoints.views import TrainingSet


@dataclass(frozen=True)
class Plan:
    """How much is trained, and where."""

    steps: int = count(5150, least=1)  # gradient steps of KNet
    batch: int = count(32, least=1)  # samples per step
    relabel_at: tuple[int, ...] = (650, 2050, 3450)  # steps at which the labels are corrected, in rising order
    # gradient steps of the refinement networks; 0 leaves those that the training begins with, if any
    refine_steps: int = count(7000, least=0)
    rate: float = number(1e-3, least=0.0)  # KNet's learning rate; lower where a trained network goes on
    decay: float = number(0.25, least=0.0, most=1.0)  # share of KNet's steps over which the rate falls to zero
    # share of the degraded samples that have little colour (`Street`)
    dull: float = number(Street.dull, least=0.0, most=1.0)
    # share of the samples whose cabin is made higher (`Street`)
    raised: float = number(Street.raised, least=0.0, most=1.0)
    # share of the hidden cars whose box is around what is seen of them (`Street`)
    seen_alone: float = number(Street.seen_alone, least=0.0, most=1.0)
    seed: int = count(0, least=0)  # seed of everything random
    device: str = "cpu"  # Torch's name of the device
    workers: int = count(1, least=0)  # processes that make samples

    def __post_init__(self) -> None:
        """Check what is given.

        Raises:
            InvalidInputError: A number is of another kind or out of range, or steps do not rise.
        """
        check_settings(self, "plan")
        stops = tuple(self.relabel_at) if isinstance(self.relabel_at, list | tuple) else (None,)
        if not all(type(stop) is int and stop > 0 for stop in stops) or list(stops) != sorted(set(stops)):
            raise InvalidInputError("plan.relabel_at", self.relabel_at, "Give whole numbers from 1 in rising order.")
        object.__setattr__(self, "relabel_at", stops)

    def training(self) -> Training:
        """How KNet is trained."""
        shared = {
            name: getattr(self, name) for name in ("steps", "batch", "rate", "decay", "seed", "workers", "device")
        }
        return Training(**shared, street=self.samples_of(Street()))

    def samples_of(self, street: Street) -> Street:
        """A degradation with the shares of this plan."""
        return replace(street, dull=self.dull, raised=self.raised, seen_alone=self.seen_alone)


def train_networks(
    data: Path,
    work: Path,
    out: Path,
    beginning: Beginning,
    plan: Plan,
    display: Display,
    more: Mapping[str, str] | None = None,
    common: Path | None = None,
) -> None:
    """Train the networks and write them; an interrupted training goes on from what is in its folder.

    Args:
        data: Data folder, with posed_cars, apollo79 and hand_labels.
        work: Folder for everything in between.
        out: The file to write (safetensors).
        beginning: What it begins with.
        plan: How much is trained.
        display: Shows how it goes.
        more: What else the network's provenance is to say.
        common: Folder of what trainings of the same photographs, marks and silhouettes have in common; None is `work`.

    Raises:
        InvalidInputError: Something of the data cannot be used, a drive to leave out is unknown, or the training in the
            folder began otherwise.
    """
    source = read_source(data, beginning.marks)
    partner = source.prior.category.mirror
    begun = None if beginning.start is None else load_tensors(beginning.start)
    street = _street(beginning, work / "street", display)
    how = plan.training()
    network, labelling, photographs = train_in_rounds(
        *(source, work, how, plan.relabel_at, beginning), street=street, display=display, common=common
    )
    state = network.state_dict()
    if begun is not None:
        state = mean_state(begun.state, state, beginning.start_share)
    provenance = {**_provenance(source, labelling, street, beginning, begun, plan), **(more or {})}
    stored = Stored(state, how.network.to_dict(), ConfidenceCalibration(), provenance)
    if begun is not None:  # patches around an estimate look the same whichever KNet made it
        stored = replace(stored, refinement=begun.refinement, refine_settings=begun.refine_settings, trust=begun.trust)
    if plan.refine_steps:
        display.log("Refinement networks")
        samples = learning(photographs, labelling.samples(photographs, source.learn), street)
        stored = _refined(stored, source, samples, work, begun, beginning.start_share, plan, display)
    display.log("Calibration")
    rough = save_weights(work / "uncalibrated.safetensors", stored)
    held = labelling.samples(photographs, source.validate)
    if not len(held):
        fix = "Hold out shapes whose photographs' labels agree with their outlines."
        raise InvalidInputError("validation_cad_ids.json", "no trusted photograph held out", fix)
    rough_cascade, scenes = KeypointCascade(rough, device=plan.device), plan.samples_of(SCORED)
    fitted = calibrate(rough_cascade, photographs, held, partner, street=scenes, seed=plan.seed + 1)
    save_weights(out, replace(stored, calibration=fitted))  # once, whole: a file that is there is finished


def _street(beginning: Beginning, folder: Path, display: Display) -> StreetShare | None:
    """The street cars of the training, prepared where that has not been done."""
    if beginning.street is None:
        check_drives(beginning.without, ())
        return None
    folder.mkdir(parents=True, exist_ok=True)
    begin_alike(folder / "began.json", {"labels": file_hash(beginning.street)})
    cars = taken_over(folder / LAST, lambda _: StreetCars.load(folder))
    if cars is None:
        display.log("Street cars")
        prepare_street_cars(beginning.street, folder, display.progress)
        cars = StreetCars.load(folder)
    return StreetShare(cars, beginning.street_share, beginning.without)


def _refined(
    stored: Stored,
    source: Source,
    samples: TrainingSet,
    work: Path,
    begun: Stored | None,
    start_share: float,
    plan: Plan,
    display: Display,
) -> Stored:
    """The network with refinement networks."""
    refining = RefineTraining(steps=plan.refine_steps, seed=plan.seed, device=plan.device)
    refining = replace(refining, street=plan.samples_of(refining.street))
    begin_alike(work / "began-refine.json", refining.lasting())
    refining = replace(refining, street=refining.street.shaping(source.prior))
    before = None if begun is None else begun.refinement
    refinement = train_refinement(
        samples,
        source.prior.category.mirror,
        work / "refine.pt",
        refining,
        start=before,
        report=display.report,
    )
    refined = refinement.state_dict()
    if before is not None:
        refined = mean_state(before, refined, start_share)
    return replace(stored, refinement=refined, refine_settings=refining.network.to_dict())


def _provenance(
    source: Source,
    labelling: Labelling,
    street: StreetShare | None,
    beginning: Beginning,
    begun: Stored | None,
    plan: Plan,
) -> dict[str, str]:
    """What a network was learnt from, and how, in words."""
    return {
        "data": f"{len(source.learn)} photographs of posed cars; shapes from 79 car models"
        + (f"; {int(labelling.outlined.sum())} silhouettes" if beginning.silhouettes else "")
        + (f"; {source.marked} keypoints marked by hand" if beginning.marks else "")
        + ("" if street is None else f"; {street.describe()}"),
        "start": _began(beginning, begun),
        "training": f"{plan.steps} steps of {plan.batch}, labels corrected at {list(plan.relabel_at)}, "
        f"seed {plan.seed}",
    }


def _began(beginning: Beginning, begun: Stored | None) -> str:
    """What a training began with, in words."""
    if beginning.start is not None and begun is not None:
        origin, share = begun.provenance.get("start", "unknown"), beginning.start_share
        return f"{beginning.start.name} (of which {share:g} is left in the weights), itself from: {origin}"
    return "random weights" if beginning.imagenet is None else "EfficientNet-lite0, ImageNet"
