"""How long functions are, and how many parameters they take."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = "fgrecon", "factors", "research", "benchmarks", "docs", "examples", "tests"
MOST_LINES, MOST_PARAMETERS = 60, 8

KEYWORD_CALLS = {  # whose names users type: the parameter's name is what the documentation explains
    "Options.__init__",
    "Reconstructor.__init__",
    "reconstruct",
    "reconstruct_detections",
    "reconstruct_image",
    "reconstruct_scene",
    "reconstruct_track",
    "refine_boxes",
    "reconstruct_garbage",  # whose parameters hypothesis draws, one for each of the above
}


def functions(path):
    """Functions of a file by their names, with those of their classes."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    owners = {method: node.name for node in ast.walk(tree) if isinstance(node, ast.ClassDef) for method in node.body}
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield f"{owners[node]}.{node.name}" if node in owners else node.name, node


def lines(node):
    """Lines of a function without its docstring."""
    first = node.body[0]
    docstring = first if ast.get_docstring(node, clean=False) is not None else None
    whole = node.end_lineno - node.lineno + 1
    return whole - (0 if docstring is None else docstring.end_lineno - docstring.lineno + 1)


def parameters(node):
    """Number of parameters of a function, without `self`."""
    named = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    own = bool(named) and named[0].arg in ("self", "cls")
    return len(named) - own + bool(node.args.vararg) + bool(node.args.kwarg)


@pytest.mark.parametrize("room", ROOMS)
def test_functions_fit_a_screen_and_take_few_parameters(room):
    long, wide = {}, {}
    for path in sorted((ROOT / room).rglob("*.py")):
        for name, node in functions(path):
            place = f"{path.relative_to(ROOT)}: {name}"
            if (count := lines(node)) > MOST_LINES:
                long[place] = count
            if (count := parameters(node)) > MOST_PARAMETERS and name not in KEYWORD_CALLS:
                wide[place] = count
    assert (long, wide) == ({}, {})
