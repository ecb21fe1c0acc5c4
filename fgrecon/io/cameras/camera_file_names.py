"""Selection of one of several cameras of a file by name."""

from __future__ import annotations

from collections.abc import Collection

from fgrecon.core.errors import InvalidInputError


def named_camera(cameras: Collection[str], name: str | None, where: str) -> str:
    """The camera of a name; the only one where none is given.

    Raises:
        InvalidInputError: There is none of the name, or there are several and none is named; lists them.
    """
    if name in cameras:
        return str(name)
    if name is None and len(cameras) == 1:
        return next(iter(cameras))
    fix = f"Name one after the file, FILE#NAME: {', '.join(cameras) or 'there is none'}."
    raise InvalidInputError(f"{where}camera", name or f"{len(cameras)} cameras", fix)
