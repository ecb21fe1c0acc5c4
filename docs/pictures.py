"""Make pictures of docs/images again: what `fgrecon demo` draws, and the figures of docs/figures.py.

python docs/pictures.py [demo | NAME...]    (20 s; without a name all)
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib as mpl
from figures import FIGURES

IMAGES = Path(__file__).parent / "images"


def demo() -> None:
    """Make demo.jpg and demo.gif."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "fgrecon", "demo", "--out", folder, "--animation", str(IMAGES / "demo.gif")]
        subprocess.run(command, check=True)
        shutil.copyfile(Path(folder) / "scene.jpg", IMAGES / "demo.jpg")


def main() -> None:
    """Make those that are named."""
    mpl.rcParams |= {"svg.hashsalt": "fgrecon", "svg.fonttype": "none", "font.family": "sans-serif"}  # the same bytes
    for name in sys.argv[1:] or ["demo", *FIGURES]:
        if name == "demo":
            demo()
        else:
            FIGURES[name]().savefig(IMAGES / f"{name}.svg", metadata={"Date": None})
        print(name, flush=True)


if __name__ == "__main__":
    main()
