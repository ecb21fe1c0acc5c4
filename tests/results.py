"""Results with other values than they were solved with."""

from dataclasses import replace

from fgrecon.core.reconstruction import Reconstruction
from fgrecon.core.result_fields import FIELDS


def changed(result: Reconstruction, **values) -> Reconstruction:
    """The result with other values of fields by name, whichever group has them."""
    for name, value in values.items():
        group = FIELDS[name].group
        part = replace(getattr(result, group), **{name: value}) if group else value
        result = replace(result, **{group or name: part})
    return result


def value_of(result: Reconstruction, name: str):
    """A field by name, whichever group has it."""
    group = FIELDS[name].group
    return getattr(getattr(result, group) if group else result, name)
