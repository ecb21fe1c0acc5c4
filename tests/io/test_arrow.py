"""pyarrow does without pandas where it is let to, and has it as soon as somebody asks."""

import subprocess
import sys
from importlib.util import find_spec

import pytest

PROGRAM = """
import sys
from fgrecon.io.arrow import without_pandas

without_pandas()
import pyarrow as pa

table = pa.Table.from_pylist([{"numbers": [1.0, 2.0], "name": "a"}])
print("pandas" in sys.modules)
if sys.argv[1] == "frame":
    print(table.to_pandas().shape, pa.Table.from_pandas(table.to_pandas()).num_rows)
without_pandas()  # it stays as it is
print("pandas" in sys.modules)
"""


@pytest.mark.parametrize("how", ["alone", "frame"])
def test_pandas_is_imported_for_a_frame_alone(how):
    if how == "frame" and find_spec("pandas") is None:
        pytest.skip("without pandas")
    done = subprocess.run([sys.executable, "-c", PROGRAM, how], capture_output=True, check=True, text=True)
    expected = ["False", "False"] if how == "alone" else ["False", "(1, 2) 1", "True"]
    assert done.stdout.split("\n")[:-1] == expected
