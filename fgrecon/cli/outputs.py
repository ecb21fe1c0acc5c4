"""Checks of output paths before the work: those that cannot be written, are read, or are given twice are refused."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from glob import glob, has_magic
from itertools import combinations
from pathlib import Path
from typing import Any

OUTPUTS = ("out", "json_out", "results_out", "picture", "animation", "save", "video", "markdown", "per_frame", "table")
"""Parameters of commands that name what is written; all others are read."""
_ROOTS = ("data", "work")
"""Folders in which commands find what they need by its place: other files in them are not read."""


def check_apart(values: Mapping[str, Any], in_folder: Sequence[str] = ()) -> None:
    """Refuse outputs that are a file which the command reads, by another path or a link as well, or that are the same.

    Files in a folder that is read, or that fit a pattern, are taken to be read. What is no file (a pipe, a terminal)
    may be both: nothing is lost there.

    Args:
        values: A command's parameters.
        in_folder: Names of the files that it writes into the folder `out`.
    """
    from fgrecon.core.errors import InvalidInputError

    outputs = {name: str(values[name]) for name in OUTPUTS if values.get(name) not in (None, "-")}
    inside = [Path(outputs["out"], name) for name in in_folder] if "out" in outputs else []
    inputs = [path for name, value in values.items() if name not in OUTPUTS for path in _paths(value)]
    own = [("out", str(file)) for file in inside]
    for name, path in [*outputs.items(), *own]:
        check_not_over(_field(name), path, inputs)
    read = [path for name, value in values.items() if name not in (*OUTPUTS, *_ROOTS) for path in _paths(value)]
    for name, path in outputs.items():
        if _is_file(path) and any(_is_inside(path, source) for source in read):
            fix = "Give another file: this one is among those that are read, and would be lost."
            raise InvalidInputError(_field(name), path, fix)
    for (first, one), (second, other) in combinations([*own, *outputs.items()], 2):
        if _same_target(one, other):
            raise InvalidInputError(_field(second), other, f"Give another file: --{_field(first)} is written to it.")


def check_outputs(json_out: str | None, *paths: Path | None, picture: Path | None = None) -> None:
    """`fgrecon.io.files.check_output` for what `--json` names and for further files."""
    from fgrecon.io.files import check_output

    for path in (*paths, picture, None if json_out in (None, "-") else Path(str(json_out))):
        check_output(path)
    if picture is not None:
        from fgrecon.core.errors import InvalidInputError
        from fgrecon.viz.picture import FORMATS

        if picture.suffix.lower().removeprefix(".") not in FORMATS:
            raise InvalidInputError("picture", str(picture), f"Let the name end in one of {', '.join(FORMATS)}.")


def check_not_over(field: str, output: str | Path, inputs: Sequence[str | Path]) -> None:
    """Refuse to write over a file that is read.

    Args:
        field: Name of the option, for the error.
        output: File to write.
        inputs: Files that are read.
    """
    from fgrecon.core.errors import InvalidInputError

    if _is_file(output) and any(_is_file(path) and Path(path).samefile(output) for path in inputs):
        raise InvalidInputError(field, str(output), "Give another file: this one is read, and would be lost.")


def files_in(folder: Path | None) -> list[Path]:
    """What is in a folder that is read; nothing where the option is left out or names a file."""
    return [] if folder is None or not folder.is_dir() else list(folder.iterdir())


def _field(name: str) -> str:
    return name.removesuffix("_out").replace("_", "-")


def _paths(value: Any) -> Iterator[str]:
    """What may be a file's name in the value of an option: `FILE`, `FILE#NAME` and `NAME=FILE` as well."""
    if isinstance(value, list | tuple):
        for item in value:
            yield from _paths(item)
    elif isinstance(value, str | Path):
        text = str(value)
        yield from {text, text.rpartition("#")[0], text.partition("=")[2]} - {""}


def _is_file(path: str | Path) -> bool:
    return os.path.isfile(path)  # noqa: PTH113 - Path's own raises for what can be no name


def _is_inside(path: str, source: str) -> bool:
    """Whether a file is in a folder, or fits a pattern of files."""
    try:
        if os.path.isdir(source):  # noqa: PTH112 - Path's own raises for what can be no name
            return Path(path).resolve().is_relative_to(Path(source).resolve())
        return has_magic(source) and any(_is_file(one) and Path(one).samefile(path) for one in glob(source))  # noqa: PTH207
    except (OSError, RuntimeError, ValueError):  # no name at all
        return False


def _same_target(one: str, other: str) -> bool:
    """Whether two names are one file, there or not yet."""
    if _is_file(one) and _is_file(other):
        return Path(one).samefile(other)
    try:
        there = Path(one).exists() or Path(other).exists()
        return not there and Path(one).resolve() == Path(other).resolve()
    except (OSError, RuntimeError, ValueError):  # no name at all: refused where it is written
        return False
