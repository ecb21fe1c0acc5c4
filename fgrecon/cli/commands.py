"""Commands as parts of the command line: groups of options as one parameter.

A parameter of a command whose type is a dataclass stands for its fields: each is an `option`, or an annotation of typer
that several commands share, or a dataclass of further options. So a command gets its whole request as one value.
"""

from __future__ import annotations

import ast
import inspect
from collections.abc import Callable, Sequence
from dataclasses import MISSING, field, fields, is_dataclass
from functools import wraps
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, ClassVar, cast, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from fgrecon.cli.outputs import check_apart
from fgrecon.core.errors import MissingPackageError

Command = Callable[..., None]

_OPTION = "option"  # in the metadata of a field: how typer shows it

RESEARCH = "fgrecon-research"
"""The distribution that brings the commands which train, label and evaluate."""


def option(words: str, *names: str, default: Any = None, **look: Any) -> Any:
    """A field of a group that is an option of the command line.

    Args:
        words: Its help.
        names: As `--name`; by default the field's.
        default: Its value where it is not given.
        look: Further arguments of `typer.Option`.
    """
    return field(default=default, metadata={_OPTION: typer.Option(*names, help=words, **look)})


def new_group(name: str, text: str, of_research: Sequence[str]) -> typer.Typer:
    """A group of the command line that says which package brings what is not installed.

    Args:
        name: Of the group.
        text: Its help.
        of_research: Names of the commands that `fgrecon-research` adds.
    """

    class Group(_Group):
        later: ClassVar[dict[str, str]] = {}

        def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
            there = self.list_commands(ctx)
            if not there:
                raise MissingPackageError(RESEARCH, f"fgrecon {name}", "research")
            if args and args[0] in of_research and args[0] not in there:
                raise MissingPackageError(RESEARCH, f"fgrecon {name} {args[0]}", "research")
            return super().parse_args(ctx, args)

    group = typer.Typer(cls=Group, help=text, no_args_is_help=True)
    group.callback()(lambda: None)
    return group


class _Group(TyperGroup):
    """Commands, some of which are imported when they are looked up."""

    later: ClassVar[dict[str, str]]  # where those are, `module:function` by name

    def list_commands(self, ctx: Any) -> list[str]:
        return [*super().list_commands(ctx), *(name for name in self.later if name not in self.commands)]

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Show the commands without importing what is imported later: by their docstrings."""
        there, later = self.commands, {name: place for name, place in self.later.items() if name not in self.commands}
        self.commands = {**there, **{name: TyperCommand(name, help=_docstring(at)) for name, at in later.items()}}
        try:
            super().format_help(ctx, formatter)
        finally:
            self.commands = there

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name in self.later and cmd_name not in self.commands:
            module, _, function = self.later[cmd_name].partition(":")
            alone = typer.Typer(add_completion=False)
            add_command(alone, cmd_name, getattr(import_module(module), function))
            self.commands[cmd_name] = get_command(alone)
        return super().get_command(ctx, cmd_name)


def _docstring(place: str) -> str:
    """The docstring of a command that is not imported."""
    module, _, function = place.partition(":")
    spec = find_spec(module)
    assert spec is not None
    assert spec.origin is not None
    body = ast.parse(Path(spec.origin).read_bytes()).body
    (command,) = (node for node in body if isinstance(node, ast.FunctionDef) and node.name == function)
    return _flowing(ast.get_docstring(command) or "")


def add_later(group: typer.Typer, name: str, place: str) -> None:
    """Add a command that is imported when it runs or its help is shown.

    Args:
        group: What `new_group` made.
        name: What the user types.
        place: Of the function that `add_command` takes, `module:function`.
    """
    cast("type[_Group]", group.info.cls).later[name] = place


def add_command(
    app: typer.Typer,
    name: str,
    command: Command,
    *,
    in_folder: Sequence[str] = (),
) -> None:
    """Add a command to a group of the command line.

    Args:
        app: The group.
        name: What the user types.
        command: The function; parameters whose types are dataclasses stand for their fields.
        in_folder: Names of the files that it writes into the folder `--out`, for `check_apart`.
    """

    class Briefer(TyperCommand):
        def collect_usage_pieces(self, ctx: Any) -> list[str]:
            shown = [parameter for parameter in self.get_params(ctx) if not getattr(parameter, "hidden", False)]
            pieces = [piece for parameter in shown for piece in parameter.get_usage_pieces(ctx)]
            return [self.options_metavar, *pieces] if self.options_metavar else pieces

    app.command(name, cls=Briefer, help=_flowing(inspect.getdoc(command) or ""))(grouped(command, in_folder))


def _flowing(text: str) -> str:
    """Paragraphs without line breaks of their own, so that they fit any terminal."""
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in text.split("\n\n"))


def grouped(command: Command, in_folder: Sequence[str] = ()) -> Command:
    """The command with an option instead of every field of its parameters that are dataclasses.

    It refuses to write over what it reads; see `fgrecon.cli.outputs`.
    """
    hints = get_type_hints(command, include_extras=True)
    groups = {name: kind for name, kind in hints.items() if _is_group(kind)}
    options: list[inspect.Parameter] = []
    for parameter in inspect.signature(command).parameters.values():
        kind = hints[parameter.name]
        options += _options(kind) if _is_group(kind) else [parameter.replace(annotation=kind)]

    @wraps(command)
    def run(**values: Any) -> None:
        check_apart(values, in_folder)
        made = {name: _made(kind, values) for name, kind in groups.items()}
        command(**values, **made)

    keyword = [option.replace(kind=inspect.Parameter.KEYWORD_ONLY) for option in options]
    run.__signature__ = inspect.Signature(keyword)  # type: ignore[attr-defined]  # what typer reads
    run.__annotations__ = {option.name: option.annotation for option in keyword}
    return run


def _is_group(kind: Any) -> bool:
    return isinstance(kind, type) and is_dataclass(kind)


def _made(group: type[Any], values: dict[str, Any]) -> Any:
    """The group with the values of its options, which are taken out of all values."""
    hints = get_type_hints(group)
    return group(
        **{
            entry.name: _made(hints[entry.name], values) if _is_group(hints[entry.name]) else values.pop(entry.name)
            for entry in fields(group)
        }
    )


def _options(group: type[Any]) -> list[inspect.Parameter]:
    """The options of a group, in the order of its fields; under the heading `panel` where it has one."""
    hints, panel = get_type_hints(group, include_extras=True), getattr(group, "panel", None)
    options: list[inspect.Parameter] = []
    for entry in fields(group):
        kind = hints[entry.name]
        if (shown := entry.metadata.get(_OPTION)) is not None:
            shown.rich_help_panel = panel
            kind = Annotated[kind, shown]
        default = inspect.Parameter.empty if entry.default is MISSING else entry.default
        own = inspect.Parameter(entry.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=kind)
        options += _options(kind) if _is_group(kind) else [own]
    return options
