"""The explanatory figures of the documentation, from what the library itself computes; `docs/pictures.py` saves them.

Everything in them is simulated. Views from above have the camera at the origin: right is right, up is ahead.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import gtsam
import numpy as np
from matplotlib.figure import Figure

import fgrecon
from factors import X, guarded_factor
from fgrecon.core.arrays import Array
from fgrecon.core.reconstruction import Reconstruction
from fgrecon.simulation import KITTI_CAMERA, Vehicle, simulate, simulate_track, yaw_pose
from fgrecon.simulation.sample import sample_scan, sample_street

INK, GREY, TRUTH, BLUE, VERMILION = "#222222", "#8a8a8a", "#28b96e", "#0072b2", "#d55e00"
CHI2_95 = 5.991
"""Squared radius of the 95 % region of a plane."""
VARIABLES = {
    "X": "pose X",
    "L": "shape\ncoefficients L",
    "O": "free\noffsets O",
    "M": "mirror\nplane M",
    "G": "ground G",
    "V": "velocity V",
}


def outline(pose: Array, size: Array) -> Array:
    """(4, 2) footprint from above of a vehicle with size (3,) at pose (4, 4)."""
    length, width = size[0] / 2, size[1] / 2
    corners = np.array([(length, 0, width), (length, 0, -width), (-length, 0, -width), (-length, 0, width)])
    return (corners @ pose[:3, :3].T + pose[:3, 3])[:, [0, 2]]


def region(result: Reconstruction) -> Array:
    """(64, 2) edge of the 95 % region of the position, from above."""
    covariance = result.uncertainty.pose_covariance
    assert covariance is not None
    rotation = result.camera_T_object[:3, :3]
    flat = (rotation @ covariance[3:, 3:] @ rotation.T)[np.ix_([0, 2], [0, 2])]
    turn = np.linspace(0, 2 * np.pi, 64)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return result.location[[0, 2]] + np.sqrt(CHI2_95) * circle @ np.linalg.cholesky(flat).T


def draw_car(axes: Any, pose: Array, size: Array, colour: str, style: str = "-", label: str | None = None) -> None:
    """A footprint from above, with an arrow along the heading."""
    axes.plot(*np.append(outline(pose, size), outline(pose, size)[:1], axis=0).T, style, color=colour, label=label)
    front = pose[:3, 3] + pose[:3, 0] * (size[0] / 2 + 0.8)
    look = {"arrowstyle": "-|>", "color": colour, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", front[[0, 2]], pose[[0, 2], 3], arrowprops=look)


def above(axes: Any, title: str) -> None:
    """What all views from above have."""
    axes.set_aspect("equal")
    axes.set_title(title, fontsize=9)
    axes.tick_params(labelsize=7)
    axes.grid(color="#e6e6e6", linewidth=0.5)
    axes.set_axisbelow(True)


def camera_view(axes: Any, observation: fgrecon.Observation, poses: Mapping[str, tuple[Array, Array]]) -> None:
    """Keypoints by weight, and wireframes (edges (E, 2), pixels (K, 2)) by colour."""
    for colour, (edges, pixels) in poses.items():
        for first, second in edges:
            axes.plot(*pixels[[first, second]].T, color=colour, linewidth=1.2)
    measured = observation.keypoints[observation.measured]
    axes.scatter(*measured.T, s=10, color=INK, zorder=3)
    drawn = np.concatenate([measured, *(pixels[np.isfinite(pixels).all(axis=1)] for _, pixels in poses.values())])
    low, high = drawn.min(axis=0), drawn.max(axis=0)
    margin = 0.1 * max(high - low)
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(high[1] + margin, low[1] - margin)
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])


def size_of(truth: Any) -> Array:
    """(3,) length, width, height of a simulated car."""
    extent: Array = np.ptp(truth.vehicle.vertices, axis=0)
    return extent[[0, 2, 1]]


def a_car(seed: int, yaw: float, place: Sequence[float]) -> tuple[fgrecon.Observation, Any]:
    """The observation of a simulated car of KITTI's fleet, and its truth."""
    rng = np.random.default_rng(seed)
    prior = fgrecon.load_prior("car14").for_fleet(fgrecon.SIZE_PRIORS["kitti"])
    return simulate(Vehicle.sample(prior, rng), KITTI_CAMERA, yaw_pose(yaw, np.array(place)), rng)


def bipartite(links: Mapping[str, Sequence[str]], order: Sequence[str], size: tuple[float, float]) -> Figure:
    """Variables in a row above, in this order, factors in a row below, by the names of their variables."""
    figure = Figure(figsize=size)
    axes = figure.add_axes((0, 0, 1, 1))
    tops = {name: np.array([(i + 0.5) / len(order), 1.0]) for i, name in enumerate(order)}
    by_place = sorted(links, key=lambda term: float(np.mean([tops[name][0] for name in links[term]])))
    for i, term in enumerate(by_place):
        spot = np.array([(i + 0.5) / len(by_place), 0.0])
        for name in links[term]:
            axes.plot(*np.stack([spot, tops[name]]).T, color=GREY, linewidth=0.8, zorder=1)
        axes.plot(*spot, "s", color=INK, markersize=7, zorder=3)
        axes.annotate(term, spot, xytext=(0, -9), textcoords="offset points", ha="center", va="top", fontsize=7)
    for name, spot in tops.items():
        axes.scatter(*spot, s=2600, facecolor="white", edgecolor=BLUE, linewidth=1.4, zorder=2)
        axes.annotate(name, spot, ha="center", va="center", fontsize=7, color=BLUE, zorder=4)
    axes.set_xlim(0, 1)
    axes.set_ylim(-0.45, 1.45)
    axes.axis("off")
    return figure


def graph() -> Figure:
    """The graph of one vehicle in one image: its terms, and the variables that each is about."""
    observation, _ = a_car(1, 1.9, (2.0, 1.65, 16.0))
    factors = fgrecon.reconstruct(observation, KITTI_CAMERA, ground=1.65).diagnostics.graph
    counts = Counter(factor.term for factor in factors)
    links = {}
    for factor in factors:
        words = factor.term if counts[factor.term] == 1 else f"{factor.term}\n({counts[factor.term]})"
        if factor.term != "cheirality":
            links[words] = [VARIABLES[name[0]] for name in factor.variables]
    return bipartite(links, [VARIABLES[letter] for letter in "XLOM"], (7.4, 2.6))


def graph_time() -> Figure:
    """The window that a tracker solves with its last frame: poses and velocities by time, and the shape of all."""
    rng = np.random.default_rng(25)
    fleet = fgrecon.SIZE_PRIORS["kitti"]
    car = Vehicle.sample(fgrecon.load_prior("car14").for_fleet(fleet), rng)
    tracker = fgrecon.Tracker(size_prior=fleet)
    for t, (seen, _) in enumerate(simulate_track(car, 12, rng)):
        tracker.update(0.1 * t, {0: seen}, camera=KITTI_CAMERA, ground=1.65)
    factors = tracker.window_graph(0)
    times = sorted({int(time_of(name)) for factor in factors for name in factor.variables if name[0] == "X"})
    figure = Figure(figsize=(7.4, 3.2))
    axes = figure.add_axes((0, 0, 1, 1))
    shape, last = np.array([(len(times) - 1) / 2, 2.1]), times[-1]
    for i, time in enumerate(times):
        pose, velocity = np.array([i, 0.6]), np.array([i + 0.5, -0.4])
        tie(axes, np.array([i + 0.35 * (shape[0] - i) / 2, 1.35]), [pose, shape], "keypoints, box, ground")
        if time != last:
            tie(axes, np.array([i + 0.5, 0.25]), [pose, velocity, pose + np.array([1.0, 0.0])], "motion")
            circle(axes, velocity, f"V {time}")
        circle(axes, pose, f"X {time}")
    circle(axes, shape, "shape\nL, O")
    axes.set_xlim(-0.6, len(times) - 0.4)
    axes.set_ylim(-0.9, 2.6)
    axes.axis("off")
    return figure


def tie(axes: Any, spot: Array, ends: Sequence[Array], name: str) -> None:
    """A factor between variables."""
    for end in ends:
        axes.plot(*np.stack([spot, end]).T, color=GREY, linewidth=0.8, zorder=1)
    axes.plot(*spot, "s", color=INK, markersize=6, zorder=3)
    axes.annotate(name, spot, xytext=(6, -3), textcoords="offset points", fontsize=6, zorder=4)


def circle(axes: Any, spot: Array, name: str) -> None:
    """A variable."""
    axes.scatter(*spot, s=1100, facecolor="white", edgecolor=BLUE, linewidth=1.4, zorder=2)
    axes.annotate(name, spot, ha="center", va="center", fontsize=7, color=BLUE, zorder=4)


def time_of(name: str) -> str:
    """The 3 of `X(v=0,t=3)`."""
    return name.partition("t=")[2].rstrip(")")


def frames() -> Figure:
    """The camera's and the vehicle's axes, yaw, and KITTI's label frame."""
    figure = Figure(figsize=(7.4, 3.4))
    space = figure.add_axes((0.0, 0.0, 0.5, 1.0), projection="3d")
    observation, truth = a_car(4, 0.7, (2.5, 1.65, 9.0))
    del observation
    pose, size = truth.camera_T_object, size_of(truth)
    shape = truth.vehicle.keypoints @ pose[:3, :3].T + pose[:3, 3]
    for first, second in fgrecon.load_category("car14").edges:
        space.plot(*to_plot(shape[[first, second]]).T, color=GREY, linewidth=1.0)
    for origin, rotation, name in ((np.zeros(3), np.eye(3), "camera"), (pose[:3, 3], pose[:3, :3], "vehicle")):
        for axis, letter, colour in zip(rotation.T, "xyz", (VERMILION, TRUTH, BLUE), strict=True):
            ends = to_plot(np.stack([origin, origin + 2.2 * axis]))
            space.plot(*ends.T, color=colour, linewidth=2.0)
            space.text(*ends[1], letter, color=colour, fontsize=9)
        space.text(*to_plot(origin[None] + np.array([[0.0, 0.7, 0.0]]))[0], name, fontsize=8)
    space.set_box_aspect((1.0, 1.5, 0.45), zoom=1.25)
    space.view_init(elev=24, azim=-62)
    space.set_axis_off()
    flat = figure.add_axes((0.6, 0.08, 0.38, 0.84))
    draw_car(flat, pose, size, BLUE)
    place = pose[[0, 2], 3]
    flat.plot(*np.stack([place, place + np.array([3.2, 0.0])]).T, ":", color=INK)
    sweep = np.linspace(0.0, 0.7, 20)
    flat.plot(*(place[:, None] + 2.6 * np.stack([np.cos(sweep), -np.sin(sweep)])), color=VERMILION)
    flat.annotate("rotation_y", place + np.array([1.0, 0.3]), fontsize=8, color=VERMILION)
    flat.plot(0, 0, "^", color=INK)
    flat.annotate("camera: x right, z ahead", (0.3, -0.3), fontsize=7)
    flat.plot(-1.2, 0, "v", color=GREY)
    flat.annotate("KITTI's label frame,\nlabel_offset away", (-1.2, 0.4), fontsize=7, color=GREY)
    flat.set_xlim(-2.5, 7.0)
    flat.set_ylim(-1.2, 12.0)
    above(flat, "from above")
    return figure


def to_plot(points: Array) -> Array:
    """Camera coordinates (N, 3) as matplotlib's, whose z is up."""
    return points[:, [0, 2, 1]] * (1.0, 1.0, -1.0)


def evidence() -> Figure:
    """One car, from more and more evidence: the 95 % region of its position."""
    street = sample_street(fgrecon.load_prior("car14"))
    car = street.cars[0]
    scan = [fgrecon.Points(sample_scan(street), sigma=0.02)]
    asked: dict[str, dict[str, Any]] = {
        "keypoints and box": {},
        "+ fleet's size": {"size_prior": "kitti"},
        "+ ground": {"size_prior": "kitti", "ground": 1.65},
        "+ LiDAR": {"size_prior": "kitti", "ground": 1.65, "evidence": scan},
    }
    figure = Figure(figsize=(7.4, 3.0))
    panels = figure.subplots(1, len(asked), sharex=True, sharey=True)
    for axes, (name, options) in zip(panels, asked.items(), strict=True):
        result = fgrecon.reconstruct(car.observation, street.camera, **options)
        axes.fill(*region(result).T, color=VERMILION, alpha=0.25, linewidth=0)
        draw_car(axes, result.camera_T_object, result.box_size, BLUE)
        truth = car.truth
        draw_car(axes, truth.camera_T_object, size_of(truth), TRUTH, "--")
        off = float(np.linalg.norm(result.location - truth.camera_T_object[:3, 3]))
        sigmas = result.position_sigmas
        assert sigmas is not None
        above(axes, f"{name}\n{off:.2f} m off, sigma {sigmas[2]:.2f} m")
    middle = car.truth.camera_T_object[[0, 2], 3]
    panels[0].set_xlim(middle[0] - 3.4, middle[0] + 3.4)
    panels[0].set_ylim(middle[1] - 5.5, middle[1] + 5.5)
    figure.tight_layout()
    return figure


def flip() -> Figure:
    """A car of which front and rear look alike: the result and its alternative of the other facing."""
    observation, truth, result = flipped_car()
    edges = np.array(result.shape.edges)
    other = result.uncertainty.alternatives[0]
    points = result.shape.wireframe @ other.camera_T_object[:3, :3].T + other.camera_T_object[:3, 3]
    figure = Figure(figsize=(7.4, 3.0))
    image, flat = figure.subplots(1, 2, width_ratios=(1.4, 1))
    wires = {BLUE: (edges, result.pose.wireframe_uv), VERMILION: (edges, KITTI_CAMERA.project(points))}
    camera_view(image, observation, wires)
    image.set_title("both explain the keypoints", fontsize=9)
    own = result.uncertainty.pose_probability
    draw_car(flat, truth.camera_T_object, size_of(truth), TRUTH, "--", "truth")
    draw_car(flat, result.camera_T_object, result.box_size, BLUE, "-", f"result, {own:.2f}")
    draw_car(flat, other.camera_T_object, result.box_size, VERMILION, "-", f"alternative, {other.probability:.2f}")
    above(flat, f"status: {result.status}")
    flat.margins(0.3)
    flat.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.tight_layout()
    return figure


def flipped_car() -> tuple[fgrecon.Observation, Any, Reconstruction]:
    """The simulated car of four keypoints with the most probable alternative of the opposite facing."""
    best, most = None, 0.0
    for seed in range(40):
        found = few_keypoints(seed, 1.57, (-2.0, 1.65, 17.0), 4)
        if found is None or found[2].status != "ambiguous" or not found[2].uncertainty.alternatives:
            continue
        other = found[2].uncertainty.alternatives[0]
        if other.camera_T_object[:3, 0] @ found[2].camera_T_object[:3, 0] < -0.5 and other.probability > most:
            best, most = found, other.probability
    assert best is not None
    return best


def few_keypoints(
    seed: int, yaw: float, place: Sequence[float], count: int, factors: Sequence[gtsam.NonlinearFactor] = ()
) -> tuple[fgrecon.Observation, Any, Reconstruction] | None:
    """A simulated car of which the first so many measured keypoints are given: observation, truth, result, if any."""
    whole, truth = a_car(seed, yaw, place)
    keypoints = whole.keypoints.copy()
    keypoints[np.flatnonzero(whole.measured)[count:]] = np.nan
    given = fgrecon.Observation(keypoints, whole.confidence, whole.box)
    try:
        return given, truth, fgrecon.reconstruct(given, KITTI_CAMERA, size_prior="kitti", extra_factors=factors)
    except fgrecon.errors.FgreconError:
        return None


def broken_factor() -> gtsam.NonlinearFactor:
    """A factor of a user's sensor whose numbers are so large that the graph's energy is infinite."""

    def callback(_values: gtsam.Values, _wanted: Any) -> tuple[Array, Array]:
        return np.full(1, 1e150), np.eye(1, 6, 5)

    return guarded_factor("broken", 1e-9, [X(0, 0)], [6], 1, callback)


def status() -> Figure:
    """One car for each status: its wireframe on the keypoints, and from above."""
    wanted = {"converged": 14, "weak": 8, "ambiguous": 6, "degenerate": 5, "failed": 14}
    figure = Figure(figsize=(9.0, 3.6))
    panels = figure.subplots(2, len(wanted), height_ratios=(1, 1.2))
    for column, (name, count) in enumerate(wanted.items()):
        own = [broken_factor()] if name == "failed" else []
        found = (few_keypoints(seed, 0.4 + 0.7 * (seed % 3), (-2.0, 1.65, 15.0), count, own) for seed in range(300))
        given, truth, result = next(one for one in found if one is not None and one[2].status == name)
        top, bottom = panels[:, column]
        camera_view(top, given, {BLUE: (np.array(result.shape.edges), result.pose.wireframe_uv)})
        top.set_title(name, fontsize=9)
        covariance = result.uncertainty.pose_covariance
        if covariance is not None and np.isfinite(covariance).all():
            bottom.fill(*region(result).T, color=VERMILION, alpha=0.25, linewidth=0)
        draw_car(bottom, truth.camera_T_object, size_of(truth), TRUTH, "--")
        draw_car(bottom, result.camera_T_object, result.box_size, BLUE)
        above(bottom, "")
        middle = truth.camera_T_object[[0, 2], 3]
        bottom.set_xlim(middle[0] - 5, middle[0] + 5)
        bottom.set_ylim(middle[1] - 6, middle[1] + 6)
    figure.tight_layout()
    return figure


FIGURES: Mapping[str, Callable[[], Figure]] = {
    "graph": graph,
    "graph-time": graph_time,
    "frames": frames,
    "evidence": evidence,
    "flip": flip,
    "status": status,
}
"""What draws each figure, by its name in docs/images."""
