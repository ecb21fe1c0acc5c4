"""Stages side by side: order, errors, and that nothing is left of them."""

import gc
import sys
import threading
import time
from contextlib import closing
from contextvars import ContextVar

import pytest

from fgrecon.video.stages import made_ahead, rare_collections, short_turns


def numbers(count, made):
    try:
        for number in range(count):
            made.append(number)
            yield number
    finally:
        made.append("closed")


@pytest.mark.parametrize("most", [0, 1, 3])
def test_items_come_in_order_and_no_more_are_made_than_may(most):
    made = []
    items = made_ahead(numbers(20, made), most, "numbers")
    for place in range(5):
        assert next(items) == place
        time.sleep(0.02)
        assert len(made) <= place + 1 + most + bool(most)  # those that wait, and one that waits for room
    items.close()
    assert made[-1] == "closed"
    assert [*made_ahead(numbers(20, []), most, "numbers")] == [*range(20)]


def test_stages_end_with_the_last_one():
    made = []
    first = made_ahead(numbers(100, made), 2, "first")

    def doubled():
        with closing(first):
            for item in first:
                yield 2 * item

    second = made_ahead(doubled(), 2, "second")
    assert [next(second) for _ in range(3)] == [0, 2, 4]
    assert len([thread for thread in threading.enumerate() if thread.name in ("fgrecon first", "fgrecon second")]) == 2
    second.close()
    assert made[-1] == "closed"
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("fgrecon")]


def test_an_error_comes_in_its_place():
    items = made_ahead((1 // (2 - item) for item in range(9)), 3, "quotients")
    assert [next(items), next(items)] == [0, 1]
    with pytest.raises(ZeroDivisionError):
        next(items)


def test_a_thread_has_the_context_of_who_takes_its_items():
    word = ContextVar("word", default="none")
    word.set("ours")
    assert [*made_ahead((word.get() for _ in range(1)), 1, "words")] == ["ours"]


def test_turns_are_short_within_and_as_before_afterwards():
    before = sys.getswitchinterval()
    with short_turns(2):
        assert sys.getswitchinterval() < before
    with short_turns(0):
        assert sys.getswitchinterval() == before
    assert sys.getswitchinterval() == before


@pytest.mark.parametrize("frozen", [False, True])
def test_collections_are_rare_inside_and_as_before_afterwards(frozen):
    before = gc.get_threshold()
    if frozen:
        gc.freeze()
    try:
        with rare_collections():
            assert gc.get_threshold()[0] > before[0]
            assert gc.get_freeze_count() > 0
        # what was frozen may be freed meanwhile: a count would not hold
        assert (gc.get_threshold(), gc.get_freeze_count() > 0) == (before, frozen)
    finally:
        gc.unfreeze()
