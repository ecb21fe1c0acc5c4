"""The guide of batches: its table is the schema, and the pieces for other engines are Python."""

import ast
import re

import pytest

from fgrecon.batch import result_schema
from tests.conftest import REPOSITORY
from tests.docs.pages import blocks, rows

TEXT = (REPOSITORY / "docs/how-to/batches.md").read_text(encoding="utf-8")


def test_the_table_has_every_column_of_the_schema_in_order():
    table = TEXT.partition("## The table")[2].partition("```")[0]
    named = [name for row in rows(table)[2:] for name in re.findall(r"`(\w+)`", row[0])]
    assert named == result_schema().names


@pytest.mark.parametrize("block", blocks(TEXT, "py"), ids=["run", "ray", "dask", "spark", "beam"])
def test_pieces_for_other_engines_are_python(block):
    ast.parse(block)
    assert "Reconstructor" in block
