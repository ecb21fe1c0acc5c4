"""The faults of `benchmarks.mutations` still fit the code: none can rot unseen. Running them is that script's work."""

import ast

import pytest

from benchmarks.mutations import OutdatedError, mutated
from benchmarks.mutations_list import MUTATIONS

from .conftest import REPOSITORY


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.name)
def test_a_mutation_fits_its_file(mutation):
    text = (REPOSITORY / mutation.file).read_text(encoding="utf-8")
    changed = mutated(text, mutation)  # every text is there exactly once
    assert changed != text
    ast.parse(changed)
    assert mutation.tests
    for test in mutation.tests:
        path, _, name = test.partition("::")
        assert f"def {name}" in (REPOSITORY / path).read_text(encoding="utf-8")


def test_names_are_given_once():
    assert len({mutation.name for mutation in MUTATIONS}) == len(MUTATIONS) >= 18


def test_a_text_that_is_gone_or_there_twice_is_refused():
    (mutation,) = (m for m in MUTATIONS if m.name == "missed-default")
    text = (REPOSITORY / mutation.file).read_text(encoding="utf-8")
    for wrong, times in (("", 0), (text + text, 2)):
        with pytest.raises(OutdatedError, match=f"missed-default: {mutation.file} has {times} times"):
            mutated(wrong, mutation)
