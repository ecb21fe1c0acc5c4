"""What importing costs: nothing that draws, learns or parses command lines is loaded before it is used."""

import subprocess
import sys

import pytest

HEAVY = ("torch", "rerun", "cv2", "matplotlib", "poselib")


@pytest.mark.parametrize(
    ("module", "unwanted"),
    [
        ("fgrecon", (*HEAVY, "typer", "rich", "gtsam", "scipy", "numpy")),
        ("fgrecon.cli.main", (*HEAVY, "rich.table", "gtsam", "scipy", "numpy")),
        ("fgrecon.core.reconstruction", (*HEAVY, "typer", "rich", "gtsam", "scipy")),
        ("fgrecon.solve.pipeline", (*HEAVY, "typer", "rich", "scipy")),
        ("factors", ("fgrecon", "gtsam")),
    ],
)
def test_importing_loads_nothing_heavy(module, unwanted):
    code = f"import sys, {module}; print([name for name in {unwanted} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
    assert done.stderr == ""
