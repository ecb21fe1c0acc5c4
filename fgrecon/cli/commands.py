"""How a command becomes part of the command line: groups of options as one parameter, and old spellings.

A command's parameter whose type is a dataclass stands for its fields: each is an option, declared once where several
commands share it.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from functools import wraps
from typing import Any, get_type_hints

import typer
from typer.core import TyperCommand

from fgrecon.cli.overwrites import check_apart

__all__ = ["add_command", "current_spelling", "grouped"]

Command = Callable[..., None]


def add_command(
    app: typer.Typer,
    name: str,
    command: Command,
    *,
    renamed: Mapping[str, str] | None = None,
    once_flags: Mapping[str, str] | None = None,
    in_folder: Sequence[str] = (),
) -> None:
    """Add a command to a group of the command line.

    Args:
        app: The group.
        name: What the user types.
        command: The function; parameters whose types are dataclasses stand for their fields.
        renamed: Old spellings of options, and today's. They work for one release, with a warning.
        once_flags: Options that took no value once, and the value that stands for that.
        in_folder: Names of the files that it writes into the folder `--out`, for `check_apart`.
    """
    old, flags = renamed or {}, once_flags or {}

    class Spelled(TyperCommand):
        def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
            current, warnings = current_spelling(args, old, flags)
            for warning in warnings:
                print(f"fgrecon: {warning}", file=sys.stderr)  # noqa: T201
            return super().parse_args(ctx, current)

        def collect_usage_pieces(self, ctx: Any) -> list[str]:
            shown = [parameter for parameter in self.get_params(ctx) if not getattr(parameter, "hidden", False)]
            pieces = [piece for parameter in shown for piece in parameter.get_usage_pieces(ctx)]
            return [self.options_metavar, *pieces] if self.options_metavar else pieces

    app.command(name, cls=Spelled, help=_flowing(inspect.getdoc(command) or ""))(grouped(command, in_folder))


def _flowing(text: str) -> str:
    """Paragraphs without line breaks of their own, so that they fit any terminal."""
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in text.split("\n\n"))


def current_spelling(
    arguments: Sequence[str], renamed: Mapping[str, str], once_flags: Mapping[str, str]
) -> tuple[list[str], list[str]]:
    """Arguments with today's names of options, and a warning for each that had another.

    Args:
        arguments: What the user typed after the command.
        renamed: Old spellings of options, and today's.
        once_flags: Options that took no value once, and the value that stands for that.
    """
    current: list[str] = []
    warnings: list[str] = []
    end = arguments.index("--") if "--" in arguments else len(arguments)
    for position, argument in enumerate(arguments):
        name, equals, value = argument.partition("=")
        if position < end and name in renamed:
            warnings.append(f"{name} is now called {renamed[name]}; the old name goes with the next release.")
            argument = f"{renamed[name]}{equals}{value}"
        current.append(argument)
        if position < end and argument in once_flags and not _is_value(arguments[position + 1 : end]):
            current.append(once_flags[argument])
            usage = f"{argument} {once_flags[argument]}"
            warnings.append(f"{argument} takes a file now: say {usage}; without one it goes with the next release.")
    return current, warnings


def _is_value(following: Sequence[str]) -> bool:
    """Whether what follows an option is its value: no further option, and no recording, which is an argument."""
    if not following:
        return False
    return following[0] == "-" or not (following[0].startswith("-") or following[0].endswith(".rrd"))


def grouped(command: Command, in_folder: Sequence[str] = ()) -> Command:
    """The command with an option in the place of every field of its parameters that are dataclasses.

    It refuses to write over what it reads; see `fgrecon.cli.overwrites`.
    """
    hints = get_type_hints(command, include_extras=True)
    groups: dict[str, type[Any]] = {}
    options: list[inspect.Parameter] = []
    for parameter in inspect.signature(command).parameters.values():
        kind = hints[parameter.name]
        if is_dataclass(kind) and isinstance(kind, type):
            groups[parameter.name] = kind
            options += _options(kind)
        else:
            options.append(parameter.replace(annotation=kind))

    @wraps(command)
    def run(**values: Any) -> None:
        check_apart(values, in_folder)
        made = {name: kind(**{f.name: values.pop(f.name) for f in fields(kind)}) for name, kind in groups.items()}
        command(**values, **made)

    keyword = [option.replace(kind=inspect.Parameter.KEYWORD_ONLY) for option in options]
    run.__signature__ = inspect.Signature(keyword)  # type: ignore[attr-defined]  # what typer reads
    run.__annotations__ = {option.name: option.annotation for option in keyword}
    return run


def _options(group: type[Any]) -> list[inspect.Parameter]:
    hints = get_type_hints(group, include_extras=True)
    kind = inspect.Parameter.KEYWORD_ONLY
    return [
        inspect.Parameter(
            field.name,
            kind,
            default=inspect.Parameter.empty if field.default is MISSING else field.default,
            annotation=hints[field.name],
        )
        for field in fields(group)
    ]
