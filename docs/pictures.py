"""Make the pictures of README.md again, docs/images/demo.jpg and demo.gif, from what `fgrecon demo` draws (10 s).

python docs/pictures.py
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

IMAGES = Path(__file__).parent / "images"


def main() -> None:
    """Make them."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "fgrecon", "demo", "--out", folder, "--animation", str(IMAGES / "demo.gif")]
        subprocess.run(command, check=True)
        shutil.copyfile(Path(folder) / "scene.jpg", IMAGES / "demo.jpg")


if __name__ == "__main__":
    main()
