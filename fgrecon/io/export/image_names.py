"""Names of images in a file beside them: paths relative to its folder, which move with the two.

A path as it was given may go through links: a data folder that is one. As long as the file is on the same side of the
link its name is short, and stays right when the link leads elsewhere; where `..` would be that of another folder than
it looks, since the file's own folder is behind a link, links are followed.
"""

from __future__ import annotations

import os
from pathlib import Path

from fgrecon.io.files import behind_links

__all__ = ["as_given", "folder_of", "name_from", "place_of"]


def place_of(path: Path) -> Path:
    """Where a file lies: its folder's links followed, since `..` is of where they lead, and its own not.

    Several images may be links to one file of a store.
    """
    return path.parent.resolve() / path.name


def as_given(path: Path) -> Path:
    """An absolute path without `..`, its links not followed; as `place_of` where only that leads to the same folder."""
    plain = Path(os.path.normpath(path.absolute()))
    return plain if plain.parent.resolve() == path.parent.resolve() else place_of(path)


def folder_of(file: Path) -> Path:
    """The folder of a file, that of what it is a link to.

    Raises:
        InvalidInputError: Its links lead to themselves.
    """
    return as_given(behind_links(file) if file.is_symlink() else file).parent


def name_from(folder: Path, image: Path) -> str:
    """An image's path from a folder (`folder_of`), with `/` between its parts."""
    given = Path(os.path.relpath(as_given(image), folder))
    if (folder / given).parent.resolve() != image.parent.resolve():
        given = Path(os.path.relpath(place_of(image), folder.resolve()))
    return given.as_posix()
