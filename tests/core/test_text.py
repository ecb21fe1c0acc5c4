"""Texts of tables."""

from fgrecon.core.text import markdown_row, most_frequent


def test_a_cell_stays_a_cell():
    assert markdown_row(["a", "-1.50"]) == "| a | -1.50 |\n"
    assert markdown_row(["left|right", "two\nlines"]) == "| left\\|right | two lines |\n"


def test_what_differs_by_numbers_alone_is_counted_together():
    texts = ["a 1.5 of 14", "b", "a 2 of 14", "c", "a 10.25 of 9", "c"]
    assert most_frequent(texts) == [("a 1.5 of 14", 3), ("c", 2), ("b", 1)]
    assert most_frequent([]) == []
