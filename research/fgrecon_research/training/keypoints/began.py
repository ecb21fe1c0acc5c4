"""Fingerprint of a training's inputs: kept in its folder, and compared when it goes on there."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fgrecon.core.errors import InvalidInputError
from fgrecon.io import files
from fgrecon.io.files import write_text
from fgrecon.io.json_fields import read_json
from fgrecon_research.training.keypoints.labelling import Source

_DIGITS = 16  # of a hash: enough to tell inputs apart


def begin_alike(path: Path, named: Mapping[str, Any]) -> None:
    """Keep what a training began with; one that goes on has to name the same, since its networks come from that.

    Raises:
        InvalidInputError: It names something else; tells what.
    """
    wanted = json.loads(json.dumps(named))
    if not path.exists():
        write_text(path, json.dumps(wanted, indent=1) + "\n")
        return
    if changed := different(read_json(path), wanted):
        fix = f"Give what it began with, or an empty folder. {changed}"
        raise InvalidInputError("work", f"a training that began with something else is in {path.parent}", fix)


def different(before: Any, wanted: Mapping[str, Any]) -> str:
    """What two records differ in, in words; nothing where they are alike."""
    old = before if isinstance(before, Mapping) else {}
    names = [name for name in {**old, **wanted} if old.get(name) != wanted.get(name)]
    return " ".join(f"{name}: {json.dumps(old.get(name))} became {json.dumps(wanted.get(name))}." for name in names)


def file_hash(path: Path) -> str:
    """Of a file's content.

    Raises:
        InvalidInputError: It cannot be read.
    """
    return files.file_hash(path)[:_DIGITS]


def files_hash(paths: Sequence[Path]) -> str:
    """Of the names and contents of some files, in this order.

    Raises:
        InvalidInputError: One cannot be read.
    """
    return text_hash("".join(f"{path.name} {files.file_hash(path)}\n" for path in paths))


def text_hash(text: str) -> str:
    """Of a text."""
    return hashlib.sha256(text.encode()).hexdigest()[:_DIGITS]


def state_hash(state: Mapping[str, Any]) -> str:
    """Of tensors by name."""
    found = hashlib.sha256()
    for name in sorted(state):
        found.update(name.encode())
        found.update(np.ascontiguousarray(state[name].detach().cpu().numpy()).tobytes())
    return found.hexdigest()[:_DIGITS]


def source_hash(source: Source) -> str:
    """Of photographs (by name, size and pose), their split, the model of the shapes and the marks."""
    found = hashlib.sha256()
    for car in source.cars:
        found.update(f"{car.image.name} {car.size} {car.shape}\n".encode())
        for array in (car.matrix, car.rotation, car.translation):
            found.update(np.ascontiguousarray(array).tobytes())
    prior = source.prior
    surface = () if prior.surface is None else (prior.surface.mean, prior.surface.basis, prior.surface.faces)
    for part in (source.learn, source.validate, prior.mean, prior.basis, *surface, source.marks):
        found.update(b"none" if part is None else np.ascontiguousarray(part).tobytes())
    return found.hexdigest()[:_DIGITS]
