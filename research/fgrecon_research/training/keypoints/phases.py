"""Trainings in a chain, by a settings file, in one folder.

Each phase has a folder of its name there, and `phase.json` in it once it is finished: its settings, and hashes of what
went in and of the network that came out. Started again, what is finished is taken over and the rest goes on. Where
drives are left out, a phase that would learn from them, and what follows it, is in `without-DRIVE+DRIVE` in that
folder; phases that learn from photographs alone serve every choice of drives. Prepared photographs, and labels that
come before any step, are in a folder of all phases that begin with the same.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.coco_keypoints import read_coco_keypoints
from fgrecon.io.files import write_bytes, write_text
from fgrecon.io.json_fields import read_json
from fgrecon.perception.keypoints.network_file import WITHOUT_STREET
from fgrecon_research.training.keypoints.began import different, file_hash, files_hash, source_hash, text_hash
from fgrecon_research.training.keypoints.labelling import read_source
from fgrecon_research.training.keypoints.networks import train_networks
from fgrecon_research.training.keypoints.posed_cars import Progress
from fgrecon_research.training.keypoints.rounds import Beginning
from fgrecon_research.training.keypoints.settings import Phase, TrainingSettings
from fgrecon_research.training.keypoints.street_cars import check_drives
from fgrecon_research.training.keypoints.trainer import Display, TrainingProgress, load_tensors

Labeller = Callable[[Sequence[Path], Path, Path, Progress], None]
"""Labels the street cars of drives (folders) by a network, to a file (COCO), and shows how far it has come."""

_FINISHED = "phase.json"
_COMMON = "_photographs"  # no phase's name begins so


def train_phases(
    settings: TrainingSettings, data: Path, work: Path, out: Path, label: Labeller, display: Display
) -> tuple[Path, ...]:
    """Run the phases, and write the last network; beside it the last one that has seen no street.

    Args:
        out: The file to write, `X.safetensors`; the network of before the first phase with street cars goes to
            `X-photographs.safetensors`.
        label: Labels street cars where a phase names drives.

    Returns:
        The files that were written.

    Raises:
        InvalidInputError: An input is missing, a drive to leave out is unknown, or a phase was run otherwise in this
            folder; names it.
    """
    begin = max((number for number, phase in enumerate(settings.phases) if phase.trained is not None), default=0)
    phases = settings.phases[begin:]  # those before a trained network leave nothing else behind
    _check(settings, phases, data)
    chain = _Chain(settings, data, work, label, display)
    network, alone = settings.start, None
    seen_street = any(phase.on_street for phase in settings.phases[:begin])  # and so has what they left behind
    for phase in phases:
        network = chain.run(phase, network)
        seen_street = seen_street or phase.on_street
        alone = alone if seen_street else network
    assert network is not None  # there is a phase
    written = [write_bytes(out, network.read_bytes())]
    if seen_street and alone is not None:
        beside = out.with_name(f"{out.stem}-{WITHOUT_STREET}{out.suffix}")
        written.append(write_bytes(beside, alone.read_bytes()))
    return tuple(written)


@dataclass
class _Chain:
    """The phases so far."""

    settings: TrainingSettings  # of all
    data: Path  # data folder
    work: Path  # folder of the phases' folders
    label: Labeller  # labels street cars
    display: Display  # shows how it goes
    left: tuple[str, ...] = ()  # drives that a phase so far would have learnt from
    done: tuple[Mapping[str, Any], ...] = ()  # records of the phases so far

    def run(self, phase: Phase, before: Path | None) -> Path:
        """The phase's network, trained, taken over or as given."""
        if phase.trained is not None:
            record = {"name": phase.name, "trained": phase.trained.name, "hash": file_hash(phase.trained)}
            self.done = (*self.done, record)
            return phase.trained
        known = _drives(phase, self.data)
        self.left = tuple(sorted({*self.left, *(name for name in self.settings.without if name in known)}))
        top = folder = self.work / phase.name
        if self.left:
            folder = top / f"without-{'+'.join(self.left)}"
        folder.mkdir(parents=True, exist_ok=True)
        beginning = self._beginning(phase, before)
        record = _record(phase, beginning, self.left)
        self.done = (*self.done, record)
        network, finished = folder / f"{phase.name}.safetensors", folder / _FINISHED
        wanted = {"settings": record, "inputs": self._inputs(phase, beginning)}
        if _taken_over(finished, wanted, network):
            self.display.log(f"{phase.name}: finished before")
            return network
        display = _Named(self.display, phase.name)
        if phase.drives:
            labels = top / f"street-{text_hash(json.dumps(wanted['inputs']['street']))}.json"
            if not labels.exists():
                display.log("Labels of street cars")
                assert before is not None  # as was checked
                self.label([self.data / drive for drive in phase.drives], before, labels, display.progress)
            beginning = replace(beginning, street=labels)
        if beginning.street is not None:  # a drive without any car that could be labelled is left out already
            there = {car.image.drive for car in read_coco_keypoints(beginning.street).vehicles}
            beginning = replace(beginning, without=tuple(name for name in self.left if name in there))
        plan = replace(phase.plan, device=self.settings.device, workers=self.settings.workers)
        more = {"settings": json.dumps(self.done)}
        alike = {name: wanted["inputs"][name] for name in ("photographs", "silhouettes")}
        common = self.work / f"{_COMMON}-{text_hash(json.dumps(alike))}"
        train_networks(self.data, folder, network, beginning, plan, display, more, common)
        write_text(finished, json.dumps({**wanted, "network": file_hash(network)}, indent=1) + "\n")
        return network

    def _beginning(self, phase: Phase, before: Path | None) -> Beginning:
        return Beginning(
            imagenet=self.settings.imagenet if before is None else None,
            start=before,
            start_share=phase.start_share,
            silhouettes=self.settings.silhouettes if phase.silhouettes else None,
            marks=self.settings.marks if phase.marks else None,
            street=phase.street,
            street_share=phase.street_share,
        )

    def _inputs(self, phase: Phase, beginning: Beginning) -> dict[str, Any]:
        """What goes into a phase, by content."""
        files = {"imagenet": beginning.imagenet, "start": beginning.start, "street": phase.street}
        hashes: dict[str, Any] = {name: None if path is None else file_hash(path) for name, path in files.items()}
        if phase.drives:
            labels = {drive: _labels_hash(self.data / drive) for drive in phase.drives}
            hashes["street"] = {"network": hashes["start"], **labels}
        outlines = beginning.silhouettes
        hashes["silhouettes"] = None if outlines is None else files_hash(sorted(outlines.glob("*.png")))
        return {"photographs": source_hash(read_source(self.data, beginning.marks)), **hashes}


@dataclass(frozen=True)
class _Named(Display):
    """A display that says of which phase it shows something."""

    display: Display
    name: str

    def log(self, line: str) -> None:
        """What begins."""
        self.display.log(f"{self.name}: {line}")

    def report(self, progress: TrainingProgress) -> None:
        """How far it is, and how good."""
        self.display.report(progress)

    def progress(self, things: Sequence[Any], heading: str) -> Iterable[Any]:
        """Go through some things and show how far that has come."""
        return self.display.progress(things, f"{self.name}: {heading}")


def _record(phase: Phase, beginning: Beginning, left: Sequence[str]) -> dict[str, Any]:
    """A phase's settings as plain values."""
    plan = {name: value for name, value in asdict(phase.plan).items() if name not in ("device", "workers")}
    record = {
        "name": phase.name,
        **plan,
        "relabel_at": list(phase.plan.relabel_at),
        "start_share": phase.start_share,
        "silhouettes": beginning.silhouettes is not None,
        "marks": beginning.marks is not None,
    }
    if phase.on_street:
        cars = {"drives": list(phase.drives)} if phase.street is None else {"street": phase.street.name}
        record |= {**cars, "street_share": phase.street_share}
    return record | ({"without": list(left)} if left else {})


def _taken_over(finished: Path, wanted: Mapping[str, Any], network: Path) -> bool:
    """Whether a phase is finished."""
    if not finished.exists():
        return False
    kept = read_json(finished)
    if changed := " ".join(filter(None, (different(kept.get(part), wanted[part]) for part in wanted))):
        what = "finished with other settings or inputs"
        fix = f"{changed} Give what it was trained with, or remove {finished.parent}."
        raise InvalidInputError(f"phase {wanted['settings']['name']}", what, fix)
    return network.exists() and file_hash(network) == kept.get("network")


def _drives(phase: Phase, data: Path) -> set[str]:
    """Names of the drives that a phase learns from."""
    if phase.street is not None:
        return {car.image.drive for car in read_coco_keypoints(phase.street).vehicles}
    return {(data / drive).absolute().name for drive in phase.drives}


def _labels_hash(drive: Path) -> str:
    """Of a drive's labels and calibration."""
    return files_hash(sorted([*drive.rglob("*.txt"), *drive.glob("*.json")]))


def _check(settings: TrainingSettings, phases: Sequence[Phase], data: Path) -> None:
    """Refuse what would fail hours later."""
    trained = [phase for phase in phases if phase.trained is None]
    begins = phases[0].trained is None
    used = {
        "imagenet": begins and settings.start is None,
        "start": begins,
        "silhouettes": any(phase.silhouettes for phase in trained),
        "marks": any(phase.marks for phase in trained),
    }
    for name, is_used in used.items():
        path: Path | None = getattr(settings, name)
        if path is None and is_used and name in settings.needs:
            raise InvalidInputError(name, "nothing", f"Give --{name}, or name it in the settings file.")
        if path is not None and is_used:
            _check_there(name, path, folder=name == "silhouettes")
    first = phases[0]
    if first.trained is not None:
        load_tensors(first.trained)
        earlier = settings.phases[: settings.phases.index(first) + 1]
        if settings.without and any(phase.on_street for phase in earlier):
            fix = "Leave no drive out, or train that phase: nothing says which drives the file has learnt from."
            raise InvalidInputError(f"phase {first.name}: trained", str(first.trained), fix)
    for phase in trained:
        if phase.street is not None:
            _check_there(f"phase {phase.name}: street", phase.street)
        for drive in phase.drives:
            _check_there(f"phase {phase.name}: drives", data / drive, folder=True)
    if begins and first.drives and settings.start is None:
        fix = "Put a phase without street cars before it, give `start`, or give labels by `street`."
        raise InvalidInputError(f"phase {first.name}: drives", "no network to label them", fix)
    check_drives(settings.without, {name for phase in trained for name in _drives(phase, data)})


def _check_there(name: str, path: Path, *, folder: bool = False) -> None:
    """Refuse a file or folder that is not there."""
    if not (path.is_dir() if folder else path.is_file()):
        raise InvalidInputError(name, str(path), f"Give a {'folder' if folder else 'file'} that exists.")
