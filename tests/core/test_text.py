"""Texts of tables."""

from fgrecon.core.text import markdown_row, number_or_dash


def test_a_cell_stays_a_cell():
    assert markdown_row(["a", "-1.50"]) == "| a | -1.50 |\n"
    assert markdown_row(["left|right", "two\nlines"]) == "| left\\|right | two lines |\n"


def test_a_number_that_nobody_knows_is_a_dash():
    assert number_or_dash(None, ".2f", 100.0) == "-"
    assert number_or_dash(0.0123, ".1f", 100.0) == "1.2"
