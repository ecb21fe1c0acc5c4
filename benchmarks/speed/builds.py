"""Two builds of fgrecon side by side: this tree, and an earlier commit in an environment of its own."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import tarfile
import venv
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

REPOSITORY = Path(__file__).parents[2]
"""This tree."""

BASE = "fe2c524bfc538d782964b5e94a451d922afa1d39"
"""The commit that this tree is measured beside."""

_FINISHED = "finished"  # file in the folder of a build that is whole


@dataclass(frozen=True)
class Build:
    """A build that can be run.

    Attributes:
        name: What tables call it.
        python: Its interpreter.
        path: Folders that come before its installed packages.
    """

    name: str
    python: Path = Path(sys.executable)
    path: tuple[Path, ...] = ()

    @property
    def environment(self) -> dict[str, str]:
        """Variables of its processes: those of this one, and of them no `PYTHONPATH` unless it has folders."""
        left_out = ("PYTHONPATH", "PYTHONDONTWRITEBYTECODE")  # an installed build has its bytecode
        given = {name: value for name, value in os.environ.items() if name not in left_out}
        if not self.path:
            return given
        places = [*map(str, self.path), *filter(None, [os.environ.get("PYTHONPATH")])]
        return {**given, "PYTHONPATH": os.pathsep.join(places)}


THIS = Build("this tree", path=(REPOSITORY, REPOSITORY / "research"))
"""The tree that this file is of, with the packages of this process."""


def unpacked(commit: str, folder: Path, *parts: str) -> Path | None:
    """A commit's source, or parts of it, unpacked into a folder; None where this is no checkout with its history."""
    command = ["git", "-C", str(REPOSITORY), "archive", commit, *parts]
    try:
        archive = subprocess.run(command, capture_output=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return None
    with tarfile.open(fileobj=BytesIO(archive)) as tar:
        tar.extractall(folder, filter="data")
    return folder


def base_build(folder: Path, commit: str = BASE) -> Build:
    """The build of a commit in an environment of its own; one that is whole in the folder already is taken as it is.

    It has the packages of this process, so that both builds run on the same ones; fgrecon alone is its own, with
    kernels compiled from its source.

    Args:
        folder: For its source and its environment; made where it does not exist.
        commit: Which one.

    Raises:
        RuntimeError: This is no checkout with its history, or the source cannot be installed.
    """
    environment, mark = folder / "environment", folder / _FINISHED
    build = Build(f"base ({commit[:7]})", environment / "bin" / "python")
    if mark.is_file() and mark.read_text(encoding="ascii") == commit:
        return build
    tree = unpacked(commit, folder / "tree")
    if tree is None:
        raise RuntimeError(f"{REPOSITORY} is no checkout that has the commit {commit}")
    venv.create(environment, clear=True, with_pip=False)
    packages = next(environment.glob("lib/python*/site-packages"))
    own = sysconfig.get_paths()["purelib"]
    (packages / "present.pth").write_text(f"{own}\n", encoding="utf-8")
    _hide(packages, "fgrecon_research")  # this tree's commands do not fit the base's
    command = [str(build.python), "-m", "pip", "install", "--quiet", "--no-deps", "--ignore-installed", str(tree)]
    done = subprocess.run(command, env=build.environment, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr.strip()}")
    mark.write_text(commit, encoding="ascii")
    return build


def _hide(packages: Path, name: str) -> None:
    """Let a package that is installed further back on the path have no entry points."""
    info = packages / f"{name}-0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 0\n", encoding="utf-8")
