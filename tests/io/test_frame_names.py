"""What names of images tell: times, numbers, or nothing."""

from pathlib import Path

import pytest

from fgrecon.io.source_frames import distinct_names, frames_by_name, number_of, seconds_of


@pytest.mark.parametrize(
    ("stem", "seconds"),
    [
        ("0.125", 0.125),
        ("1311868164.363181", 1311868164.363181),
        ("cam0_1311868164.363181", 1311868164.363181),
        ("1532402927", 1532402927.0),
        ("1532402927612", 1532402927.612),
        ("1532402927612460", 1532402927.61246),
        ("1532402927612460000", 1532402927.61246),
        ("n015-2018-07-24-11-22-45+0800__CAM_FRONT__1532402927612460", 1532402927.61246),
        ("315966070522215968", 315966070.522215968),  # Argoverse's, since 1980
        ("image 1532402927612 left", 1532402927.612),
    ],
)
def test_times(stem, seconds):
    assert seconds_of(stem) == pytest.approx(seconds, abs=1e-6)
    assert number_of(stem) is None


@pytest.mark.parametrize(
    ("stem", "number"),
    [
        ("000012", 12),
        ("left_12", 12),
        ("0" * 40 + "7", 7),
        ("000000000000", 0),
        ("0001532402927612", None),
        ("1532402927612_3", 3),
        ("123456789", 123456789),
        ("20230101120057", None),
        ("202301011200", None),
        ("9" * 5000, None),
        ("street", None),
        ("", None),
    ],
)
def test_numbers_and_what_is_neither(stem, number):
    assert seconds_of(stem) is None
    assert number_of(stem) == number


def test_all_names_must_be_of_one_kind():
    known = frames_by_name(map(Path, ("b_2.png", "a_10.png")))
    assert (known.numbers, known.times, known.numbered) == ((2, 10), None, True)
    mixed = frames_by_name(map(Path, ("1532402927612460.png", "a_10.png")))
    assert (mixed.numbers, mixed.times, mixed.numbered) == ((0, 1), None, False)
    again = frames_by_name(map(Path, ("b/1.png", "a/1.png")))
    assert (again.paths, again.numbers) == ((Path("a/1.png"), Path("b/1.png")), (0, 1))


def test_names_have_folders_where_they_need_them():
    assert distinct_names([Path("x/a/1.png"), Path("x/b/2.png")]) == ("1.png", "2.png")
    assert distinct_names([Path("x/a/1.png"), Path("x/b/1.png")]) == ("a/1.png", "b/1.png")
    assert distinct_names([Path("1.png"), Path("b/1.png")]) == ("1.png", "b/1.png")
    assert distinct_names([Path("../x/1.png"), Path("../y/1.png")]) == ("x/1.png", "y/1.png")
    assert distinct_names([Path("/x/1.png"), Path("/y/1.png")]) == ("x/1.png", "y/1.png")
