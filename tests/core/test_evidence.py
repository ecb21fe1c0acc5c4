"""What other sensors say, as it is given."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgrecon import DepthMap, Mask, Observation, Points, Range, VehicleClass, reconstruct
from fgrecon.core.evidence import as_evidence
from fgrecon.errors import InvalidInputError


def test_points_are_kept_as_they_are_given() -> None:
    given = np.array([[0.0, 1.0, 5.0], [np.nan, 0.0, 1.0], [1.0, 1.0, 6.0]])
    points = Points(given, [0.1, 0.2, 0.3])
    assert points.points.tolist() == [[0.0, 1.0, 5.0], [1.0, 1.0, 6.0]]
    assert np.asarray(points.sigma).tolist() == [0.1, 0.3]
    assert points.thinned(2).points.tolist() == [[0.0, 1.0, 5.0]]


@pytest.mark.parametrize(
    ("points", "sigma", "named"),
    [
        (np.zeros((3, 2)), 0.1, "points"),
        (np.zeros((3, 3)), 0.0, "points.sigma"),
        (np.zeros((3, 3)), [0.1, 0.1], "points.sigma"),
        (np.full((3, 3), 1e6), 0.1, "points"),
    ],
)
def test_bad_points_are_refused(points: np.ndarray, sigma: object, named: str) -> None:
    with pytest.raises(InvalidInputError, match=f"^{named}"):
        Points(points, sigma)  # type: ignore[arg-type]


def test_evidence_is_a_sequence_of_evidence() -> None:
    with pytest.raises(InvalidInputError, match=r"^evidence\[0\]"):
        as_evidence([np.zeros((3, 3))])
    with pytest.raises(InvalidInputError, match=r"^evidence"):
        reconstruct(np.zeros((14, 2)), np.eye(3), evidence=np.zeros((5, 3)))  # type: ignore[arg-type]
    with pytest.raises(InvalidInputError, match=r"^evidence"):
        Observation.of(np.zeros((14, 2))).with_evidence([np.zeros((3, 3))])  # type: ignore[list-item]


def test_the_same_evidence_does_not_count_twice() -> None:
    points = Points(np.array([[0.0, 1.0, 5.0]]))
    with pytest.raises(InvalidInputError, match=r"^evidence\[1\]: got what is given before"):
        as_evidence([points, points])
    with pytest.raises(InvalidInputError, match=r"^evidence\[1\]"):
        Observation.of(np.zeros((14, 2))).with_evidence([points]).with_evidence([points])


def test_equal_measurements_do_not_count_twice() -> None:
    """A copy is refused as the same is; other measurements, none at all and other places are not."""
    scan, depth = np.random.default_rng(0).normal(size=(50, 3)), np.full((4, 6), 10.0)
    depth[0] = np.nan
    filled = np.zeros((30, 40))
    filled[5:9, 10:20] = 1
    for one, other in [
        (Points(scan), Points(scan.copy(), 0.5)),
        (DepthMap(depth), DepthMap(depth.copy())),
        (Mask(filled), Mask(filled > 0, hides=True)),
    ]:
        with pytest.raises(InvalidInputError, match=r"^evidence\[2\]: got what is given before"):
            as_evidence([one, VehicleClass("car"), other])
        with pytest.raises(InvalidInputError, match=r"^evidence\[1\]"):
            Observation.of(np.zeros((14, 2))).with_evidence([one]).with_evidence([other])
    moved = scan.copy()
    moved[17, 1] += 1e-9
    nothing = Points(np.zeros((0, 3)))
    mask = Mask(np.roll(filled, 7, axis=1))
    assert len(as_evidence([Points(scan), Points(moved), nothing, replace(nothing), Mask(filled), mask])) == 6
    assert len(as_evidence([Range(9.0, 0.1), Range(9.0, 0.1)])) == 2  # two radars may say the same


def test_tensors_may_have_gradients_and_be_elsewhere() -> None:
    class Tensor:
        """What numpy refuses until it is detached and brought to the host, as torch's."""

        def __init__(self, *done: str) -> None:
            self.done = done

        def detach(self) -> Tensor:
            return Tensor(*self.done, "detach")

        def cpu(self) -> Tensor:
            return Tensor(*self.done, "cpu")

        def __array__(self, *_: object, **__: object) -> np.ndarray:
            if self.done != ("detach", "cpu"):
                raise RuntimeError
            return np.array([[0.0, 1.0, 5.0]])

    assert Points(Tensor()).points.tolist() == [[0.0, 1.0, 5.0]]  # type: ignore[arg-type]
