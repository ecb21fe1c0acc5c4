"""Fingerprints of a run's files when their rows were reconstructed: an edited file does not count as done.

Of images and videos they are size and time of change, since they are many or large; of keypoint files their content, so
that one to which rows were added at its end goes on.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from fgrecon.batch.inputs import InputFile
from fgrecon.core.errors import InvalidInputError
from fgrecon.core.serialise import well_formed
from fgrecon.core.text import whole_text
from fgrecon.io.files import MADE_AGAIN, stored, write_text
from fgrecon.io.json_fields import read_json

INPUTS = "_inputs.json"
"""The fingerprints of a run's files; beside the parts."""

_BLOCK_BYTES = 1 << 20


def check_unedited(folder: Path, sources: Sequence[InputFile], done: Collection[str]) -> None:
    """Refuse a file of which rows are done and that is another one now; remember the fingerprints of the others.

    Args:
        folder: Of the run.
        done: Ids of the rows that are done.

    Raises:
        InvalidInputError: A file was edited or replaced; names it.
    """
    path = folder / INPUTS
    known = stored(path, _known) or {}
    begun = {name.rpartition("#")[0] for name in done}.union(done)
    for source in sources:
        name = whole_text(str(source.path))
        before = known.get(name)
        try:
            now = _fingerprint(source)
            edited = before is not None and name in begun and not _goes_on(before, now, source.path)
        except OSError:  # a row will say so
            continue
        if before is not None and edited:
            when = "before it was edited" if before["place"] == now["place"] else f"of {before['place']}"
            fix = f"Give another folder for its results: this one has rows of that name, reconstructed {when}."
            raise InvalidInputError("input", name, fix)
        known[name] = now
    write_text(path, json.dumps(known, indent=0) + "\n")


def _known(path: Path) -> dict[str, dict[str, Any]]:
    """The fingerprints of a file, which may be damaged."""
    content = read_json(path)
    with well_formed(str(path), MADE_AGAIN):
        return {name: {"place": str(one["place"]), "bytes": int(one["bytes"]), **one} for name, one in content.items()}


def _fingerprint(source: InputFile) -> dict[str, Any]:
    state = source.path.stat()
    common = {"place": whole_text(str(source.path.resolve())), "bytes": state.st_size}
    if source.is_picture:
        return {**common, "modified_ns": state.st_mtime_ns}
    return {**common, "sha256": _hash(source.path, state.st_size)}


def _goes_on(before: dict[str, Any], now: dict[str, Any], path: Path) -> bool:
    """Whether the rows that a file had are there still."""
    if before == now:
        return True
    if "sha256" not in now or before["place"] != now["place"] or before["bytes"] > now["bytes"]:
        return False
    return _hash(path, before["bytes"]) == before.get("sha256")


def _hash(path: Path, size: int) -> str:
    """SHA-256 of a file's first bytes."""
    digest, left = hashlib.sha256(), size
    with path.open("rb") as file:
        while left > 0 and (block := file.read(min(_BLOCK_BYTES, left))):
            digest.update(block)
            left -= len(block)
    return digest.hexdigest()
