"""The settings file of `fgrecon keypoints train`: trainings in a chain, each from the network of the one before (TOML).

Paths are relative to the file, drives to the data folder.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

from fgrecon.core.errors import InvalidInputError
from fgrecon.core.settings import check_settings, count, flag, number
from fgrecon.io.json_fields import read_toml
from fgrecon_research.training.keypoints.networks import Plan

NEEDED = ("imagenet", "start", "silhouettes", "marks")
"""Inputs that a file may say it needs: who runs it has to name them where the file does not."""

Made = TypeVar("Made")

_PLAN = tuple(entry.name for entry in fields(Plan) if entry.name not in ("device", "workers"))
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")


@dataclass(frozen=True)
class Phase:
    """One training."""

    name: str  # of its folder
    plan: Plan = field(default_factory=Plan)  # how much is trained; device and workers are those of `TrainingSettings`
    # share of the network before in the resulting weights, 0 to 1
    start_share: float = number(0.5, least=0.0, most=1.0)
    street: Path | None = None  # street cars (COCO, of `fgrecon keypoints label`), or None
    # folders of drives in the data folder, whose street cars the network before labels first
    drives: tuple[str, ...] = ()
    street_share: float = number(0.5, least=0.0, most=1.0)  # share of the samples that show street cars, 0 to 1
    silhouettes: bool = flag(default=True)  # whether silhouettes make the first labels
    marks: bool = flag(default=True)  # whether marks are learnt from
    trained: Path | None = None  # a network that takes the place of this training and of those before, or None

    def __post_init__(self) -> None:
        """Check what is given.

        Raises:
            InvalidInputError: A value is out of range, the name is no folder's, or street cars are given in two ways.
        """
        check_settings(self, "phase")
        if not _NAME.fullmatch(self.name) or self.name.startswith("without-"):
            raise InvalidInputError(
                "phase.name", self.name, "Give letters, digits, _ and -; the phase's folder has it."
            )
        if self.street is not None and self.drives:
            raise InvalidInputError("phase.drives", ", ".join(self.drives), "Give either `street` or `drives`.")

    @property
    def on_street(self) -> bool:
        """Whether street cars are learnt from."""
        return self.street is not None or bool(self.drives)


@dataclass(frozen=True)
class TrainingSettings:
    """Trainings in a chain."""

    phases: tuple[Phase, ...]  # the trainings, at least one
    needs: tuple[str, ...] = ()  # names of the inputs without which they are not run (`NEEDED`)
    imagenet: Path | None = None  # weights of the encoder that the first begins with (torch), or None for random ones
    start: Path | None = None  # a trained network that the first goes on from instead, or None
    silhouettes: Path | None = None  # folder of silhouettes, or None
    marks: Path | None = None  # keypoints marked by hand in photographs that are learnt from (JSON), or None
    without: tuple[str, ...] = ()  # drives whose street cars no phase learns from
    device: str = "cpu"  # Torch's name of the device
    workers: int = count(1, least=0)  # processes that make samples

    def __post_init__(self) -> None:
        """Check what is given.

        Raises:
            InvalidInputError: There is no phase, two have the same name, or something is needed that is no input.
        """
        check_settings(self, "settings")
        names = [phase.name for phase in self.phases]
        if not names:
            raise InvalidInputError("settings.phase", "nothing", "Give at least one [[phase]].")
        if twice := [name for name in names if names.count(name) > 1]:
            raise InvalidInputError("settings.phase", twice[0], "Give every phase a name of its own.")
        for name in self.needs:
            if name not in NEEDED:
                raise InvalidInputError("settings.needs", name, f"Give some of {', '.join(NEEDED)}.")

    def with_trained(self, networks: Mapping[str, Path]) -> TrainingSettings:
        """The same with trained networks in the place of some phases.

        Raises:
            InvalidInputError: There is no phase of a name.
        """
        known = [phase.name for phase in self.phases]
        for name in networks:
            if name not in known:
                raise InvalidInputError("trained", name, f"The phases are {', '.join(known)}.")
        phases = (replace(phase, trained=networks.get(phase.name, phase.trained)) for phase in self.phases)
        return replace(self, phases=tuple(phases))


def shipped_settings() -> tuple[str, ...]:
    """Names of the settings that come with fgrecon."""
    return tuple(sorted(path.stem for path in _folder().glob("*.toml")))


def read_settings(source: str | Path) -> TrainingSettings:
    """Settings by their name (`keypoints-car14`) or from a file.

    Raises:
        InvalidInputError: There is no such file, it is not TOML, or a key is unknown or of another type; names file,
            key and value.
    """
    path = _folder() / f"{source}.toml" if str(source) in shipped_settings() else Path(source)
    if not path.is_file():
        raise InvalidInputError(
            "settings", str(source), f"Give a TOML file, or one of {', '.join(shipped_settings())}."
        )
    table = read_toml(path)
    tables = table.pop("phase", [])
    if not isinstance(tables, list) or not all(isinstance(each, dict) for each in tables):
        raise InvalidInputError(f"{path}: phase", tables, "Give tables: [[phase]].")
    phases = tuple(
        _phase(each, f"{path}: phase {each.get('name', number)}: ", path.parent)
        for number, each in enumerate(tables, 1)
    )
    values = _values(table, _SETTINGS, f"{path}: ", path.parent)
    return _made(lambda: TrainingSettings(phases, **values), f"{path}: ", "settings.")


def _folder() -> Path:
    return Path(str(resources.files("fgrecon") / "data" / "training"))


def _phase(table: Mapping[str, Any], where: str, folder: Path) -> Phase:
    values = _values(table, _PHASE, where, folder)
    if "name" not in values:
        raise InvalidInputError(f"{where}name", "nothing", "Give this key.")
    plan = {name: values.pop(name) for name in _PLAN if name in values}
    made = _made(lambda: Plan(**plan), where, "plan.")
    return _made(lambda: Phase(plan=made, **values), where, "phase.")


def _made(make: Callable[[], Made], where: str, prefix: str) -> Made:
    """Something made of a table's values; its errors name the table."""
    try:
        return make()
    except InvalidInputError as error:
        raise InvalidInputError(where + error.field.removeprefix(prefix), error.value, error.fix) from error


def _values(
    table: Mapping[str, Any], known: Mapping[str, Callable[[str, Any, Path], Any]], where: str, folder: Path
) -> dict[str, Any]:
    """The values of a table, each checked."""
    for key in table:
        if key not in known:
            raise InvalidInputError(f"{where}{key}", table[key], f"No such key; there are {', '.join(sorted(known))}.")
    return {key: known[key](where + key, value, folder) for key, value in table.items()}


def _text(key: str, value: Any, _: Path) -> str:
    if not isinstance(value, str) or not value:
        raise InvalidInputError(key, value, "Give a text.")
    return value


def _texts(key: str, value: Any, folder: Path) -> tuple[str, ...]:
    if not isinstance(value, list):
        raise InvalidInputError(key, value, "Give a list of texts.")
    return tuple(_text(f"{key}[{number}]", each, folder) for number, each in enumerate(value))


_READERS: Mapping[str, Callable[[str, Any, Path], Any]] = {
    "str": _text,
    "tuple[str, ...]": _texts,
    "Path | None": lambda key, value, folder: folder / _text(key, value, folder),
}
"""What reads a value, by the type of its field; those of other types are checked where they are made."""


def _keys(kind: type, *left_out: str) -> dict[str, Callable[[str, Any, Path], Any]]:
    """What reads the keys of a table, by the fields of what is made of it."""
    known = ((entry.name, str(entry.type)) for entry in fields(kind) if entry.name not in left_out)
    return {name: _READERS.get(of_type, lambda _key, value, _folder: value) for name, of_type in known}


_SETTINGS = _keys(TrainingSettings, "phases")
_PHASE = _keys(Phase, "plan") | _keys(Plan, "device", "workers")
