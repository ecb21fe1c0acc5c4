"""What importing costs: nothing that draws, learns or parses command lines is loaded before it is used."""

import subprocess
import sys

import pytest
from typer.testing import CliRunner

HEAVY = ("torch", "rerun", "cv2", "matplotlib", "poselib")


@pytest.mark.parametrize(
    ("module", "unwanted"),
    [
        ("fgrecon", (*HEAVY, "typer", "rich", "gtsam", "scipy", "numpy")),
        ("fgrecon.cli.main", (*HEAVY, "rich.table", "gtsam", "scipy", "numpy")),
        ("fgrecon.core.reconstruction", (*HEAVY, "typer", "rich", "gtsam", "scipy")),
        ("fgrecon.solve.pipeline", (*HEAVY, "typer", "rich", "scipy")),
        ("fgrecon.io.cameras", (*HEAVY, "typer", "rich", "gtsam", "scipy", "yaml")),
        ("factors", ("fgrecon", "gtsam")),
    ],
)
def test_importing_loads_nothing_heavy(module, unwanted):
    code = f"import sys, {module}; print([name for name in {unwanted} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
    assert done.stderr == ""


CASCADE = """
import pickle, numpy as np
from fgrecon.perception.keypoints.detect import KeypointCascade
cascade = pickle.loads(pickle.dumps(KeypointCascade(runtime="onnx")))
cascade(np.zeros((60, 80, 3), np.uint8), [[10, 10, 70, 50]])
"""
COMMAND = """
from typer.testing import CliRunner
from fgrecon.cli.main import app
given = ["reconstruct", "street.png", "--calib", "calib.txt", "--detect", "--camera-height", "1.65"]
assert CliRunner().invoke(app, [*given, "--picture", "out.png"], catch_exceptions=False).exit_code == 0
"""


@pytest.fixture(scope="module")
def sample(tmp_path_factory):
    from fgrecon.cli import main

    folder = tmp_path_factory.mktemp("sample")
    assert CliRunner().invoke(main.app, ["sample", "--out", str(folder)]).exit_code == 0
    return folder


@pytest.mark.parametrize("code", [CASCADE, COMMAND])
def test_with_onnx_runtime_keypoints_are_found_without_torch(code, sample):
    for name in ("onnx", "onnxruntime"):
        pytest.importorskip(name, reason="it is not installed")
    code += "import sys; print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=sample)
    assert done.stdout.strip() == "False"
