"""The notebook runs from top to bottom, and what its cells end with shows itself.

Its cells are run here as a kernel would, without one: packages for kernels are many and start slowly.
"""

from __future__ import annotations

import ast
import json
from typing import Any

import pytest

from tests.conftest import REPOSITORY

NOTEBOOK = REPOSITORY / "examples/tutorial.ipynb"
CONTENT = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
CODE = ["".join(cell["source"]) for cell in CONTENT["cells"] if cell["cell_type"] == "code"]


def run_cell(source: str, names: dict[str, Any]) -> Any:
    """Run a cell; the value that it ends with, or None."""
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "cell", "exec"), names)
    return None if last is None else eval(compile(ast.Expression(last.value), "cell", "eval"), names)


def test_it_is_a_notebook_without_outputs():
    assert (CONTENT["nbformat"], CONTENT["nbformat_minor"]) == (4, 5)
    identities = [cell["id"] for cell in CONTENT["cells"]]
    assert len(set(identities)) == len(identities)
    for cell in CONTENT["cells"]:
        assert cell["cell_type"] == "markdown" or (cell["outputs"] == [] and cell["execution_count"] is None)


def test_it_runs_and_shows_pictures(capsys):
    pytest.importorskip("torch")
    names: dict[str, Any] = {}
    ends = [end for end in (run_cell(source, names) for source in CODE) if end is not None]
    shown = [end for end in ends if hasattr(end, "_repr_png_") or hasattr(end, "_repr_html_")]
    assert len(shown) == 6
    for end in shown:
        if hasattr(end, "_repr_png_"):
            assert end._repr_png_().startswith(b"\x89PNG")
        else:
            assert "data:image/png;base64," in end._repr_html_()
    printed = capsys.readouterr().out
    assert printed.count("coefficient ") == 5
    assert names["result"].status == "converged"
    assert names["lorry"].box_size == pytest.approx(names["box"].box_size([1.0, -0.5]), abs=0.5)
