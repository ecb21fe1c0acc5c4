"""What boxes come to: groups, shares, intervals over tracks, calibration of the direction, the worst."""

import json

import numpy as np
import pytest

from fgrecon.calibration.labelled_boxes import SYSTEM, BoxOutcome, VideoBox
from fgrecon_research.evaluation.video_summary import (
    document,
    facing_reliability,
    group_boxes,
    summarise_boxes,
    summarise_groups,
    worst_boxes,
)


def outcome(degrees, metres=1.0, status="converged", size=(0.1, 0.0, -0.2)):
    if not np.isfinite(metres):
        return BoxOutcome(180.0, np.inf, None, None, "no")
    return BoxOutcome(degrees, metres, size, status, None)


def box(degrees=0.0, metres=1.0, status="converged", **changes):
    given = {
        "drive": "d",
        "frame": 0,
        "index": 0,
        "track": 0,
        "kind": "Car",
        "truncation": 0.0,
        "occlusion": 0,
        "height": 50.0,
        "distance": 15.0,
        "azimuth": 0.0,
        "facing": 1.0,
        "outcomes": {SYSTEM: outcome(degrees, metres, status)},
    }
    return VideoBox(**given | changes)


def test_the_numbers_of_a_group():
    boxes = [
        box(5.0, 1.0),
        box(15.0, 2.0, track=1),
        box(90.0, 6.0, track=1),
        box(91.0, 3.0, track=1, facing=0.5),
        box(170.0, 4.0, status="ambiguous", track=2, facing=0.2),
        box(metres=np.inf, track=2, drive="e"),
        box(30.1, 2.0, track=2, drive="e"),
        box(0.0, 2.0, track=3, drive="e"),
    ]
    found = summarise_boxes(boxes, SYSTEM)
    assert (found.boxes, found.tracks, found.refused) == (8, 5, 1)
    assert found.mean_degrees.value == pytest.approx((5 + 15 + 90 + 91 + 170 + 180 + 30.1) / 8)
    assert {t: share.value for t, share in found.aop.items()} == {5: 25.0, 15: 37.5, 30: 37.5}
    assert (found.heading_flips.value, found.without_estimate.value) == (25.0, 12.5)
    assert found.silent.value == 12.5  # ambiguous and refused ones do not hide it
    assert found.network_heading_flips.value == 25.0
    assert found.intervals["median_metres"].value == 2.0
    assert found.intervals["mean_metres"].value == pytest.approx(20.0 / 7)
    assert found.mean_size_error == pytest.approx((0.1, 0.0, -0.2))


def test_intervals_draw_whole_tracks():
    one_track = [box(180.0 * (number % 2)) for number in range(40)]
    many = [box(180.0 * (number % 2), track=number) for number in range(40)]
    together = [box(180.0 * (number % 2), track=number % 2) for number in range(40)]
    shares = [summarise_boxes(boxes, SYSTEM).heading_flips for boxes in (one_track, many, together)]
    assert [share.value for share in shares] == [50.0] * 3
    assert (shares[0].low, shares[0].high) == (50.0, 50.0)
    assert 30.0 < shares[1].low < 40.0
    assert 60.0 < shares[1].high < 70.0
    assert (shares[2].low, shares[2].high) == (0.0, 100.0)
    places = [
        summarise_boxes([box(metres=1.0 + n % 2, track=t(n)) for n in range(40)], SYSTEM)
        for t in (int, lambda n: n % 2)
    ]
    for found, low, high in zip(places, (1.3, 1.0), (1.7, 2.0), strict=True):
        one = found.intervals["mean_metres"]
        assert (one.low, one.value, one.high) == pytest.approx((low, 1.5, high), abs=0.1)
        assert found.intervals["median_metres"].value == 1.5


def test_a_rival_has_no_status_and_a_group_may_lack_every_pose():
    boxes = [box(outcomes={SYSTEM: outcome(0.0, np.inf), "pnp": outcome(120.0, status=None, size=None)}, facing=None)]
    whole, rival = (summarise_boxes(boxes, method) for method in (SYSTEM, "pnp"))
    assert (whole.silent.value, whole.refused, whole.mean_size_error) == (0.0, 1, None)
    assert {"median_metres", "mean_metres"}.isdisjoint(whole.intervals)
    assert (rival.silent, rival.mean_size_error, rival.network_heading_flips) == (None, None, None)
    assert rival.heading_flips.value == 100.0


def test_groups():
    boxes = [
        box(height=40.0),
        box(height=39.9, drive="e", azimuth=np.pi),
        box(occlusion=1, height=200.0, distance=50.0, azimuth=1.5),
        box(occlusion=2, height=60.0, distance=9.9),
        box(occlusion=-1, height=120.0, kind="Van", distance=10.0),
    ]
    groups = group_boxes(boxes)
    numbers = {
        by: {name: [boxes.index(one) for one in some] for name, some in named.items()} for by, named in groups.items()
    }
    assert numbers == {
        "drive": {"d": [0, 2, 3, 4], "e": [1]},
        "regime": {
            "cars_easy": [0],
            "cars_moderate": [0, 1, 2],
            "cars": [0, 1, 2, 3],
            "vans": [4],
            "all": [0, 1, 2, 3, 4],
        },
        "view": {"front": [0, 3, 4], "rear": [1], "side": [2]},
        "height": {"25-40 px": [1], "40-60 px": [0], "60-120 px": [3], "from 120 px on": [2, 4]},
        "occlusion": {"fully visible": [0, 1], "partly occluded": [2], "largely occluded": [3], "unknown": [4]},
        "distance": {"0-10 m": [3], "10-20 m": [0, 1, 4], "from 50 m on": [2]},
    }


def test_a_network_that_says_how_sure_it_is_has_no_calibration_error():
    honest = [box(facing=0.75)] * 30 + [box(facing=0.25)] * 10
    np.random.default_rng(0).shuffle(honest)
    found = facing_reliability([*honest, box(facing=None)])
    assert found.count.sum() == 40
    assert found.confidence == pytest.approx(0.75)
    assert (found.right @ found.count) / 40 == pytest.approx(0.75)
    sure = facing_reliability([box(facing=1.0)] * 3 + [box(facing=0.0)])
    assert sure.error == pytest.approx(0.25)
    assert facing_reliability([box(facing=None)]).error == 0.0


def test_the_worst_box_of_each_of_the_worst_tracks():
    boxes = [
        box(20.0, track=1),
        box(170.0, 1.0, track=2),
        box(170.0, 2.0, track=2, frame=1),
        box(metres=np.inf, track=3),
        box(5.0, track=2, drive="e"),
    ]
    assert [boxes.index(one) for one in worst_boxes(boxes, 2)] == [2, 0]
    assert len(worst_boxes(boxes, 9)) == 3


def test_the_document_is_plain_and_whole():
    boxes = [box(0.0), box(100.0, track=1), box(metres=np.inf, track=1, facing=0.3, azimuth=3.0)]
    networks = [{"file": "a", "drives": ["d"], "provenance": {"data": "x"}}]
    made = document(boxes, summarise_groups(boxes), {"box_model": "cuboid"}, networks)
    made = json.loads(json.dumps(made, allow_nan=False))
    assert made["format"] == "fgrecon.video-images/1"
    assert (made["given"], made["networks"]) == ({"box_model": "cuboid"}, networks)
    groups = made["methods"][SYSTEM]
    assert list(groups) == ["drive", "regime", "view", "height", "occlusion", "distance"]
    assert groups["regime"]["all"] == groups["drive"]["d"]
    assert groups["regime"]["all"]["heading_flips"]["value"] == pytest.approx(100.0 / 3)
    rear = groups["view"]["rear"]  # one track, refused
    assert rear["heading_flips"] == {"value": 0.0, "low": None, "high": None}
    assert rear["without_estimate"]["value"] == 100.0
    assert (rear["median_metres"], rear["mean_metres"], rear["mean_size_error"]) == (None, None, None)
    assert sum(entry["boxes"] for entry in made["facing"]["bins"]) == 3
    assert made["facing"]["expected_calibration_error"] == pytest.approx(0.7 / 3)
    assert [row["metres"] for row in made["boxes"]] == [1.0, 1.0, None]
    named = {name for summary in groups["regime"].values() for name in summary} - {"boxes", "tracks", "refused"}
    assert named == set(made["units"]) - {"interval", "facing"}
