"""The pages of batches: the table of columns is the schema, and the pieces for other engines are Python."""

import ast
import re

import pytest

from fgrecon.batch import result_schema
from tests.conftest import REPOSITORY
from tests.docs.pages import blocks, rows

COLUMNS = (REPOSITORY / "docs/reference/batch-table.md").read_text(encoding="utf-8")
PIECES = [
    block
    for name in ("batches", "engines")
    for block in blocks((REPOSITORY / f"docs/how-to/{name}.md").read_text(encoding="utf-8"), "py")
]


def test_the_table_has_every_column_of_the_schema_in_order():
    named = [name for row in rows(COLUMNS)[2:] for name in re.findall(r"`(\w+)`", row[0])]
    assert named == result_schema().names


@pytest.mark.parametrize("block", PIECES, ids=["run", "ray", "dask", "spark", "beam"])
def test_pieces_for_other_engines_are_python(block):
    ast.parse(block)
    assert "Reconstructor" in block
