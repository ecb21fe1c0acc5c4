"""Make what docs/reference has from classes again: settings.md, fields/options.md and fields/result.md.

    python docs/settings.py

A module-level instance of a class whose name ends with `Settings` is what a stage reads. The class's docstring says
what its numbers were chosen on; what a number is stands in its attribute docstring, in the comment behind it, or under
`Attributes:`.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import math
import re
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any, get_type_hints

import fgrecon
from fgrecon import BoxOptions, KeypointOptions, Options, Reconstruction, SearchOptions, ShapeOptions
from fgrecon.core.text import markdown_row

REFERENCE = Path(__file__).parent / "reference"
MADE = "<!-- Made by `python docs/settings.py`. -->\n"
GROUPS = {"": Options, "keypoints": KeypointOptions, "box": BoxOptions, "search": SearchOptions, "shape": ShapeOptions}
"""Classes of options, by their attribute of `Options`."""
HEAD = f"""{MADE}# Tuned numbers

What every stage reads beside [options](options.md): numbers that were chosen once and hold for all callers. Each table
is one frozen settings class; its default instance is in the same module. What a number was chosen on stands with it, or
above the table for all that say nothing else.
"""
UNITS = {
    "nats_per_point": "nats per point",
    "growth_m_per_s": "m/s",
    "m_per_s": "m/s",
    "rad_per_s": "rad/s",
    "probability_per_s": "1/s",
    "odds_per_nat": "1/nat",
    "per_m2": "1/m²",
    "depth_per_m": "1/m",
    "sigma_per_m": "",
    "m2": "m²",
    "m": "m",
    "metres": "m",
    "px": "px",
    "pixels": "px",
    "s": "s",
    "seconds": "s",
    "rad": "rad",
    "radians": "rad",
    "deg": "degrees",
    "degrees": "degrees",
    "nats": "nats",
    "sigmas": "standard deviations",
    "log": "of the logarithm",
}
"""Ends of names, the longest first, and the unit that they stand for."""


def default_settings() -> Iterator[tuple[str, str, Any]]:
    """Module, its name for it, and every default instance of the package; groups come after what they are in."""
    root = Path(fgrecon.__file__).parent
    for path in sorted(root.rglob("*.py")):
        if not re.search(r"^class \w+Settings\b", path.read_text(encoding="utf-8"), re.MULTILINE):
            continue
        module = importlib.import_module(".".join(path.relative_to(root.parent).with_suffix("").parts))
        for name, value in vars(module).items():
            if is_settings(value) and type(value).__module__ == module.__name__:
                yield from _with_groups(module.__name__, name, value)


def _with_groups(module: str, name: str, value: Any) -> Iterator[tuple[str, str, Any]]:
    yield module, name, value
    for entry in fields(value):
        if is_settings(getattr(value, entry.name)):
            yield from _with_groups(module, f"{name}.{entry.name}", getattr(value, entry.name))


def is_settings(value: Any) -> bool:
    """Whether it is an instance of a settings class."""
    return type(value).__name__.endswith("Settings")


def descriptions(kind: type) -> dict[str, str]:
    """What each field of a settings class is, in its source's words; empty where the source says nothing."""
    source = inspect.getsource(kind)
    body, lines = ast.parse(source).body[0], source.splitlines()
    assert isinstance(body, ast.ClassDef)
    listed = _listed(kind)
    found = {}
    for statement, after in zip(body.body, [*body.body[1:], None], strict=True):
        if not isinstance(statement, ast.AnnAssign) or not isinstance(statement.target, ast.Name):
            continue
        name, comment = statement.target.id, lines[(statement.end_lineno or 1) - 1][statement.end_col_offset :]
        if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            found[name] = inspect.cleandoc(str(after.value.value))
        else:
            found[name] = comment.partition("#")[2] or listed.get(name, "")
    return {name: " ".join(text.split()) for name, text in found.items()}


def _listed(kind: type) -> dict[str, str]:
    """The `Attributes:` of a class's docstring."""
    section = inspect.cleandoc(kind.__doc__ or "").partition("Attributes:\n")[2]
    return dict(re.findall(r"^    (\w+): (.*(?:\n {8}.*)*)", section, re.MULTILINE))


def unit(name: str) -> str:
    """The unit that a field's name ends with, or nothing."""
    ends = (end for end in sorted(UNITS, key=len, reverse=True) if name.endswith(f"_{end}"))
    return UNITS.get(next(ends, ""), "")


def shown(value: Any) -> str:
    """A value as it is read: few digits, and whole degrees beside radians that are some."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, tuple):
        return f"({', '.join(map(shown, value))})"
    return str(value)


def _value(name: str, value: Any) -> str:
    degrees = math.degrees(value) if unit(name) == "rad" and isinstance(value, float) else 0.5
    whole = math.isclose(degrees, round(degrees), rel_tol=1e-9)
    return f"{shown(value)} ({degrees:.0f}°)" if whole else shown(value)


def page() -> str:
    """The page: a section and a table for every settings class."""
    parts = [HEAD]
    for module, instance, settings in default_settings():
        kind = type(settings)
        about = " ".join(inspect.cleandoc(kind.__doc__ or "").partition("Attributes:")[0].split())
        rows = [markdown_row(["Name", "Value", "Unit", "What it is, and was chosen on"]), "|---|---|---|---|\n"]
        for name, text in descriptions(kind).items():
            value = getattr(settings, name)
            if not is_settings(value):
                rows.append(markdown_row([f"`{name}`", _value(name, value), unit(name), capital(text)]))
        parts.append(f"## {kind.__name__}\n\n`{module}.{instance}`: {about}\n\n{''.join(rows)}")
    return "\n".join(parts)


def capital(text: str) -> str:
    """A text with a capital letter."""
    return text[:1].upper() + text[1:]


def options() -> str:
    """Every option, its default, and what it is."""
    rows = [markdown_row(["option", "default", "meaning"]), "|---|---|---|\n"]
    for group, kind in GROUPS.items():
        defaults = kind()
        for name, text in descriptions(kind).items():
            if text and name not in GROUPS:
                rows.append(
                    markdown_row([f"`{group}.{name}`".replace("`.", "`"), default(getattr(defaults, name)), text])
                )
    return f"{MADE}\n{''.join(rows)}"


def default(value: Any) -> str:
    """A default as it is written in Python."""
    if isinstance(value, frozenset):
        return ", ".join(f"`{name}`" for name in sorted(value))
    return f"`{shown(getattr(value, 'name', value) if not isinstance(value, str) else str(value))}`"


def result() -> str:
    """Every field of a result, by its groups, properties after the fields."""
    kinds = get_type_hints(Reconstruction)
    rows = [markdown_row(["field", "content"]), "|---|---|\n"]
    for group in ("", "pose", "shape", "uncertainty", "diagnostics"):
        kind = kinds[group] if group else Reconstruction
        found = {name: text for name, text in descriptions(kind).items() if name not in kinds or not group}
        for name, value in vars(kind).items():
            if isinstance(value, property):
                found[name] = " ".join(inspect.cleandoc(value.__doc__ or "").split())
        rows += [markdown_row([f"`{group}.{name}`".replace("`.", "`"), text]) for name, text in found.items()]
    return f"{MADE}\n{''.join(rows)}"


PAGES = {"settings.md": page, "fields/options.md": options, "fields/result.md": result}
"""What makes each page of docs/reference."""

if __name__ == "__main__":
    for name, make in PAGES.items():
        (REFERENCE / name).write_text(make(), encoding="utf-8")
