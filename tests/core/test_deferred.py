"""Records that are made when somebody looks: once, and like a tuple in everything."""

import copy
import pickle

from fgrecon.core.history import Deferred
from fgrecon.core.serialise import plain


def test_items_are_made_once_and_only_when_looked_at():
    made = []

    def make():
        made.append(1)
        return [3, 1, 2]

    steps = Deferred(make)
    assert not made
    assert list(steps) == [3, 1, 2]
    assert (len(steps), steps[0], steps[-1], steps[1:]) == (3, 3, 2, (1, 2))
    assert bool(steps)
    assert not Deferred(tuple)
    assert 1 in steps
    assert made == [1]


def test_it_compares_copies_and_shows_as_the_tuple():
    steps = Deferred(lambda: (1, "a"))
    assert steps == (1, "a")
    assert steps == Deferred(lambda: [1, "a"])
    assert steps != (1,)
    assert hash(steps) == hash((1, "a"))
    assert repr(steps) == "(1, 'a')"
    assert pickle.loads(pickle.dumps(steps)) == (1, "a")  # our own
    assert copy.deepcopy(steps) == (1, "a")
    assert plain(steps) == [1, "a"]


def test_what_items_were_made_from_is_let_go():
    class Heavy:
        def __iter__(self):
            return iter((1,))

    import gc
    import weakref

    heavy = Heavy()
    gone = weakref.ref(heavy)
    steps = Deferred(lambda held=heavy: held)
    del heavy
    gc.collect()
    assert gone() is not None
    assert steps[0] == 1
    gc.collect()
    assert gone() is None
