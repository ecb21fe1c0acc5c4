"""A sensor's file that belongs to an image: a file alone, a folder of files named as the images, or a pattern."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from glob import glob
from pathlib import Path

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.frame_names import of_one_image


@dataclass(frozen=True)
class SensorFiles:
    """The files of a sensor."""

    field: str  # what an error calls them
    given: str  # a file, a folder, or a pattern such as `lidar/*.npz`
    endings: tuple[str, ...]  # of the files that count, in small letters

    @cached_property
    def _files(self) -> dict[str, Path]:
        """The files of a folder or of a pattern by their names without ending."""
        folder = Path(self.given)
        of_pattern = [] if folder.is_dir() else glob(self.given)  # noqa: PTH207 - the pattern may be absolute
        paths = folder.iterdir() if folder.is_dir() else map(Path, of_pattern)
        longest_first = sorted(self.endings, key=len, reverse=True)
        found: dict[str, Path] = {}
        for path in sorted(paths):
            ending = next((one for one in longest_first if path.name.lower().endswith(one)), None)
            if ending is None or not path.is_file():
                continue
            stem = path.name[: -len(ending)]
            if stem in found:
                fix = "Give one file for each image: a pattern chooses among endings."
                raise InvalidInputError(self.field, f"{found[stem].name} and {path.name}", fix)
            found[stem] = path
        if not found and not (folder.is_dir() or of_pattern):
            fix = "Give a file or a folder that exists, or a pattern of such files."
            raise InvalidInputError(self.field, self.given, fix)
        if not found:
            raise InvalidInputError(self.field, self.given, f"Give files that end in {', '.join(self.endings)}.")
        return found

    @property
    def alone(self) -> bool:
        """Whether it is one file, which is of whatever image there is."""
        return Path(self.given).is_file()

    def all(self) -> list[Path]:
        """All of them.

        Raises:
            InvalidInputError: There is none.
        """
        return [Path(self.given)] if self.alone else list(self._files.values())

    def of(self, image: str) -> Path | None:
        """The file of an image; None where there is none.

        Args:
            image: The image's name, with its ending or without; numbers may differ by zeros before them.

        Raises:
            InvalidInputError: There are no files at all, or several are of this image.
        """
        if self.alone:
            return Path(self.given)
        names = of_one_image(self._files, image)
        if len(names) > 1:
            raise InvalidInputError(self.field, f"{', '.join(sorted(names))} for {image}", "Give one for each image.")
        return self._files[names.pop()] if names else None
