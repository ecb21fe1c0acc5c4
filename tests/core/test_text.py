"""Texts of tables."""

from fgrecon.core.text import markdown_row


def test_a_cell_stays_a_cell():
    assert markdown_row(["a", "-1.50"]) == "| a | -1.50 |\n"
    assert markdown_row(["left|right", "two\nlines"]) == "| left\\|right | two lines |\n"
