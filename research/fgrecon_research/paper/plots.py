"""The plots of the evaluation page, as SVG text."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np

from fgrecon.core.category import Category
from fgrecon_research.evaluation.bootstrap import Interval
from fgrecon_research.paper.keypoint_noise_fit import Residuals
from fgrecon_research.paper.known_shape import KNOWN_SHAPE_ROWS, KnownShapeScores
from fgrecon_research.paper.simulated_scores import STAGE_ROWS, Scores
from fgrecon_research.paper.tables import APK_ALPHA, Table, row_label

_INK, _MUTED, _GRID = "#1b2733", "#6b7785", "#e3e8ee"
_COLOURS = ("#8d99a6", "#4c78a8", "#e45756", "#54a24b", "#b279a2")
_DASHES: tuple[Any, ...] = (
    "-",
    (0, (4.0, 1.2)),
    (0, (1.2, 1.0)),
    (0, (5.0, 1.2, 1.2, 1.2)),
    (0, (8.0, 1.5)),
    (0, (3.0, 1.0, 1.0, 1.0, 1.0, 1.0)),
)
"""Lines of the methods: in grey print and to some eyes their colours are alike."""
_OURS, _PRINTED = "#e45756", "#c9d1d9"


def error_curves(scores: Scores, rows: Sequence[str], shown: Sequence[str]) -> str:
    """Share of the Hard cars within an orientation error, by method."""
    figure, axes = _figure(7.2, 4.2)
    used = scores.regimes[:, -1]
    limits = np.linspace(0.0, 45.0, 181)
    for position, row in enumerate(shown):
        errors = np.sort(scores.orientation[used, rows.index(row)])
        share = 100.0 * np.searchsorted(errors, limits, side="right") / len(errors)
        ours = row in ("pose", "joint", "fgrecon+size")
        style: Mapping[str, Any] = (
            {"color": _OURS, "lw": 2.4, "ls": "--" if row == "fgrecon+size" else "-"}
            if ours
            else {"color": _shade(position), "lw": 1.5, "ls": _DASHES[position % len(_DASHES)]}
        )
        axes.plot(limits, share, label=row_label(row), **style)
    detected = 100.0 * (scores.detection[used] >= 0).mean()
    axes.axhline(detected, color=_MUTED, lw=0.8, ls=":")
    axes.annotate(f"detected: {detected:.0f} %", (44.5, detected), ha="right", va="bottom", fontsize=8, color=_MUTED)
    axes.set(xlim=(0, 45), ylim=(0, 102), xlabel="orientation error at most, degrees", ylabel="% of the Hard cars")
    axes.legend(frameon=False, fontsize=8, loc="lower right", ncols=2)
    return svg_text(figure)


def aop_plot(table: Table) -> str:
    """AOP of Table I on the Hard regime at 5 degrees, the paper's printed figures in grey."""
    lines = [(label, cells[6]) for label, cells in table.rows]
    figure, axes = _figure(7.2, 0.34 * len(lines) + 0.8)
    for y, (label, cell) in enumerate(reversed(lines)):
        value = cell.value if isinstance(cell, Interval) else cell or 0.0
        printed = label in table.printed
        colour = _PRINTED if printed else _OURS if label.startswith("fgrecon") else _COLOURS[1]
        axes.barh(y, value, color=colour, height=0.7)
        if isinstance(cell, Interval):
            axes.plot([cell.low, cell.high], [y, y], color=_INK, lw=1.2)
        end = cell.high if isinstance(cell, Interval) else value
        axes.annotate(f"{value:.1f}", (end, y), xytext=(6, 0), textcoords="offset points", va="center", fontsize=8)
    axes.set_yticks(range(len(lines)), [label for label, _ in reversed(lines)], fontsize=8)
    axes.set(xlim=(0, 100), xlabel="% of the Hard cars within 5 degrees")
    axes.grid(visible=False, axis="y")
    return svg_text(figure)


def simulated_parts(scores: Scores, rows: Sequence[str]) -> Mapping[str, np.ndarray]:
    """APK of each keypoint over the detected Hard cars, percent (K,), as measured and by stage."""
    used = scores.regimes[:, -1] & (scores.detection >= 0)
    away = {"as measured": scores.measured} | {row: scores.reprojection[:, rows.index(row)] for row in STAGE_ROWS}
    return {row_label(row): 100.0 * (values[used] <= APK_ALPHA).mean(axis=0) for row, values in away.items()}


def per_part_table(key: str, title: str, note: str, shares: Mapping[str, np.ndarray], category: Category) -> Table:
    """The paper's per-part figure as numbers: percent of each keypoint that is right (K,), by stage."""
    lines = tuple(
        (f"{k + 1} {name}", tuple(float(share[k]) for share in shares.values()))
        for k, name in enumerate(category.keypoints)
    )
    return Table(key, title, note, tuple(shares), lines)


def per_part_plot(shares: Mapping[str, np.ndarray], category: Category) -> str:
    """The paper's per-part figure: percent of each keypoint that is right (K,), by stage."""
    figure, axes = _figure(8.6, 3.8)
    width = 0.8 / len(shares)
    for s, (label, share) in enumerate(shares.items()):
        places = np.arange(category.size) + (s - (len(shares) - 1) / 2) * width
        axes.bar(places, np.nan_to_num(share), width, color=_COLOURS[s], label=label)
    names = [f"{k + 1}\n{name.replace('_', ' ').replace(' ', chr(10), 2)}" for k, name in enumerate(category.keypoints)]
    axes.set_xticks(range(category.size), names, fontsize=6.5)
    axes.set(xlim=(-0.6, category.size - 0.4), ylim=(0, 104), ylabel="APK, %")
    axes.legend(frameon=False, fontsize=8, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    axes.grid(visible=False, axis="x")
    return svg_text(figure)


def known_shape_plot(scores: KnownShapeScores) -> str:
    """Distribution of the errors on cars of known shape: SQPnP, fgrecon, and fgrecon given the size."""
    figure, panels = plt.subplots(1, 3, figsize=(9.6, 3.2), layout="constrained")
    shown = ("sqpnp", "joint", "joint+others", "sqpnp+size", "joint+size", "joint+size+others")
    names = ("SQPnP", "fgrecon", "fgrecon,\nothers", "SQPnP,\nsize", "fgrecon,\nsize", "fgrecon,\nboth")
    measures = (
        ("rotation, degrees", scores.rotation, 12.0),
        ("position, % of distance", 100.0 * scores.translation, 20.0),
        ("3D keypoint, cm", 100.0 * scores.keypoint, 50.0),
    )
    for axes, (label, values, limit) in zip(panels, measures, strict=True):
        _plain(axes)
        columns = [np.minimum(values[:, KNOWN_SHAPE_ROWS.index(row)], 1e3) for row in shown]
        boxes = axes.boxplot(columns, showfliers=False, widths=0.6, patch_artist=True, medianprops={"color": _INK})
        for patch, row in zip(boxes["boxes"], shown, strict=True):
            patch.set(facecolor=_OURS if row.startswith("joint") else _COLOURS[0], alpha=0.75, edgecolor=_INK, lw=0.6)
        axes.set_xticks(range(1, len(names) + 1), names, fontsize=6)
        axes.set(ylim=(0, limit), title=label)
        axes.title.set(fontsize=9, color=_INK)
        axes.grid(visible=False, axis="x")
    return svg_text(figure)


def noise_plot(network: Sequence[Residuals], scores: Scores) -> str:
    """Distance of measured keypoints from the truth: the network that the noise is fitted to, and the simulated set."""
    figure, axes = _figure(7.2, 3.6)
    real = np.concatenate([np.linalg.norm(r.errors, axis=2).ravel() for r in network])
    real_visible = np.concatenate([r.visible.ravel() for r in network])
    detected = scores.detection >= 0
    drawn, drawn_visible = scores.measured[detected].ravel(), scores.visible[detected].ravel()
    limits = np.linspace(0.0, 0.5, 201)
    for colour, name, seen in ((_OURS, "visible", True), (_COLOURS[1], "hidden", False)):
        for values, mask, line in ((real, real_visible, "-"), (drawn, drawn_visible, "--")):
            errors = np.sort(values[(mask == seen) & np.isfinite(values)])
            share = 100.0 * np.searchsorted(errors, limits, side="right") / max(len(errors), 1)
            label = f"{name}, {'network' if line == '-' else 'simulated'} ({len(errors)})"
            axes.plot(limits, share, color=colour, ls=line, label=label)
    axes.set(
        xlim=(0, 0.5), ylim=(0, 102), xlabel="distance from the truth / longer side of the box", ylabel="% of keypoints"
    )
    axes.legend(frameon=False, fontsize=8, loc="lower right")
    return svg_text(figure)


def _figure(width: float, height: float) -> tuple[Any, Any]:
    figure, axes = plt.subplots(figsize=(width, height), layout="constrained")
    _plain(axes)
    return figure, axes


def _plain(axes: Any) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(_GRID)
    axes.tick_params(colors=_MUTED, labelcolor=_INK, labelsize=8)
    axes.grid(color=_GRID, lw=0.8)
    axes.set_axisbelow(True)


def _shade(position: int) -> str:
    return ("#8d99a6", "#4c78a8", "#72b7b2", "#b279a2", "#9d755d", "#eeca3b", "#54a24b", "#f58518")[position % 8]


def svg_text(figure: Any) -> str:
    """The figure as an SVG element; the same figure gives the same text."""
    buffer = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": "fgrecon", "svg.fonttype": "none", "font.family": "sans-serif"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    plt.close(figure)
    text = buffer.getvalue()
    return text[text.index("<svg") :]
