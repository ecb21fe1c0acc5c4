"""The examples of the API pages run and print what stands there."""

import doctest

import pytest

from tests.conftest import REPOSITORY

PAGES = sorted((REPOSITORY / "docs/reference/api").glob("*.md"))
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE | doctest.IGNORE_EXCEPTION_DETAIL


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_what_an_example_prints(page):
    text = page.read_text(encoding="utf-8").replace("\n```\n", "\n\n")  # a fence's end is no output
    example = doctest.DocTestParser().get_doctest(text, {}, page.stem, str(page), 0)
    assert example.examples
    results = doctest.DocTestRunner(optionflags=FLAGS).run(example)
    assert results.failed == 0
