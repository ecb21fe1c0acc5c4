"""Fields that are made when they are first read."""

import pickle
from dataclasses import dataclass, field, replace
from functools import partial

import pytest

from fgrecon.core.history import LazyFields

made = []


def make(what):
    made.append(what)
    return what


@dataclass(frozen=True)
class Thing(LazyFields):
    known: int
    later: str
    other: str | None = field(default_factory=lambda: None)


def test_a_field_is_made_once_and_only_where_it_is_read():
    made.clear()
    thing = Thing.with_later({"later": partial(make, "a"), "other": partial(make, "b")}, known=1)
    assert (thing.known, made) == (1, [])
    assert thing.not_made.keys() == {"later", "other"}
    assert (thing.later, thing.later, made) == ("a", "a", ["a"])
    assert thing.not_made.keys() == {"other"}
    assert thing == Thing(1, "a", "b")
    assert made == ["a", "b"]


def test_copies_and_pickles_have_all_fields():
    made.clear()
    thing = Thing.with_later({"later": partial(make, "a")}, known=1)
    assert replace(thing, known=2) == Thing(2, "a")
    again = pickle.loads(pickle.dumps(Thing.with_later({"later": partial(make, "c")}, known=1)))
    assert again == Thing(1, "c")
    assert not again.not_made
    assert made == ["a", "c"]


def test_a_field_can_be_made_later_in_the_place_of_its_own():
    made.clear()
    thing = Thing.with_later({"later": partial(make, "a")}, known=1)
    again = thing.but_later(later=partial(lambda own: own() + "d", thing.maker("later")))
    assert made == []
    assert (again.later, thing.later, made) == ("ad", "a", ["a", "a"])
    assert (thing.maker("later")(), again.maker("known")(), made) == ("a", 1, ["a", "a"])
    assert Thing(2, "b").but_later(later=partial(make, "c")) == Thing(2, "c")


def test_other_names_are_errors():
    with pytest.raises(AttributeError, match="'Thing' object has no attribute 'lter'"):
        Thing(1, "a").lter  # noqa: B018  # its error is wanted
