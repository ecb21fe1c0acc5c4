"""Drawing of the factor graph in a recording: variables in the middle, keypoints' factors above, all others below.

Of several frames it is a table: a row for each, what they share on its right, and what ties them between the rows.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import rerun as rr

from fgrecon.core.arrays import Array
from fgrecon.core.reconstruction import GraphFactor
from fgrecon.core.vehicle_mesh import Colour
from fgrecon.viz import entities, style
from fgrecon.viz.columns import Outbox, made_columns
from fgrecon.viz.playback import Rows

_MEANINGS = {"X": "pose", "V": "velocity", "L": "shape", "O": "offsets", "P": "plane", "M": "medial plane"}
_COLUMN, _ROW, _GAP = 130.0, 30.0, 75.0
_WIDTH = 4  # nodes in a row
_LARGE, _SMALL = 14.0, 6.0

Place = tuple[float, float]


@dataclass(frozen=True)
class Layout:
    """A graph as it is drawn: V variables, then F factors."""

    key: tuple[GraphFactor, ...]  # what is laid out
    nodes: tuple[str, ...]  # V + F unique names
    labels: tuple[str, ...]  # V + F texts
    positions: Array  # (V + F, 2) places, x to the right, y down
    colours: tuple[Colour, ...]  # V + F colours
    variables: int  # V
    edges: tuple[tuple[str, str], ...]  # pairs (factor, variable) of names


def log_graph(rows: Rows) -> None:
    """The graph that a vehicle's result minimises; the factors of keypoints are coloured by weight at every step."""
    (play,) = rows.plays
    result = play.vehicle.reconstruction
    if not result.diagnostics.graph:
        return
    layout = lay_out(result.diagnostics.graph)
    log_layout(play.stream, layout)
    place = {name: index for index, name in enumerate(result.shape.keypoint_names)}
    drawn = [
        (row, place[f.label])
        for row, f in enumerate(result.diagnostics.graph, start=layout.variables)
        if _is_keypoint(f, place)
    ]
    colours = np.broadcast_to(np.array(layout.colours, dtype=np.uint8), (len(rows.steps), len(layout.nodes), 3)).copy()
    if drawn:
        at, keypoints = np.array(drawn).T
        colours[:, at] = style.readable(rows.colours[:, keypoints])
    nodes = rr.GraphNodes.columns(colors=colours.reshape(-1, 3)).partition([len(layout.nodes)] * len(rows.steps))
    rows.send(entities.GRAPH, nodes)


def _is_keypoint(factor: GraphFactor, names: Mapping[str, int]) -> bool:
    return factor.term == "reprojection" and factor.label in names


def log_layout(stream: Outbox, layout: Layout, *, colours: bool = False) -> None:
    """Log nodes and edges without a time; the colours too, where no step changes them."""
    nodes, edges = graph_archetypes(layout)
    parts = [*made_columns(nodes), *made_columns(edges)]
    kept = [part for part in parts if colours or part.component_descriptor().component != "GraphNodes:colors"]
    stream.send_columns(entities.GRAPH, [], kept)


def graph_archetypes(layout: Layout) -> tuple[Any, Any]:
    """The `rerun.GraphNodes` and `rerun.GraphEdges` of a graph that is another one at another time."""
    radii = np.repeat([_LARGE, _SMALL], [layout.variables, len(layout.nodes) - layout.variables])
    nodes = rr.GraphNodes(
        layout.nodes,
        positions=layout.positions,
        labels=layout.labels,
        radii=radii,
        colors=np.array(layout.colours, dtype=np.uint8),
        show_labels=True,
    )
    return nodes, rr.GraphEdges(layout.edges, graph_type="undirected")


@lru_cache(maxsize=16)
def lay_out(graph: tuple[GraphFactor, ...]) -> Layout:
    """Place variables and factors: in rows, or for several frames in a table with one row for each."""
    names = list(dict.fromkeys(variable for factor in graph for variable in factor.variables))
    several = sum(name.startswith("X") for name in names) > 1
    places = _table(names, graph) if several else _stack(names, graph)
    factors = [f"{factor.term} {index}" for index, factor in enumerate(graph)]
    return Layout(
        key=graph,
        nodes=(*names, *factors),
        labels=(*(_describe(name) for name in names), *(_label(factor) for factor in graph)),
        positions=np.array(places).reshape(-1, 2),
        colours=(*(style.VARIABLE for _ in names), *(_colour(f.term, i) for i, f in enumerate(graph))),
        variables=len(names),
        edges=tuple((node, v) for node, factor in zip(factors, graph, strict=True) for v in factor.variables),
    )


def _colour(term: str, index: int) -> Colour:
    red, green, blue = style.readable(style.energy_colour(term, index)).tolist()
    return (red, green, blue)


def _stack(names: Sequence[str], graph: Sequence[GraphFactor]) -> list[Place]:
    """Variables in the middle row, the factors of keypoints above and all others below."""
    keypoints = [factor.term == "reprojection" for factor in graph]
    tops = iter(_rows(sum(keypoints), -_GAP, -_ROW))
    bottoms = iter(_rows(len(graph) - sum(keypoints), _GAP, _ROW))
    return [*_row(len(names), 0.0), *(next(tops if top else bottoms) for top in keypoints)]


def _table(names: Sequence[str], graph: Sequence[GraphFactor]) -> list[Place]:
    """One row per frame: its velocity, its pose, and the factors that this is in; what frames share is on the right.

    Factors that tie two frames are between their rows: those of poses beside these, those of velocities below these.
    """
    rows = {name[1:]: row for row, name in enumerate(name for name in names if name.startswith("X"))}
    deep = 2 if any(name.startswith("V") for name in names) else 1  # lines of factors in a row
    height = deep * _ROW
    taken: Counter[Place] = Counter()
    factors: list[Place | None] = []  # None for those of no frame
    for factor in graph:
        frames = sorted({rows[name[1:]] for name in factor.variables if name[1:] in rows})
        if not frames:
            factors.append(None)
            continue
        y, posed = (frames[0] + frames[-1]) / 2 * height, any(name.startswith("X") for name in factor.variables)
        if len(frames) > 1:
            x, step, lines = (-1, -1, 1) if posed else (-2, -1, 1)
        else:
            x, step, lines = (1, 1, deep) if posed else (-3, -1, deep)
        column, line = divmod(taken[x, y], lines)
        taken[x, y] += 1
        factors.append(((x + step * column) * _COLUMN, y + (line - (lines - 1) / 2) * _ROW))
    middle = (len(rows) - 1) / 2 * height
    right = max((place[0] for place in factors if place is not None), default=0.0) + 1.5 * _COLUMN
    shared = iter(_column(sum(name[1:] not in rows for name in names), right, middle, 2 * _ROW))
    alone = iter(_column(factors.count(None), right + 1.5 * _COLUMN, middle, 1.5 * _ROW))
    variables = [
        ((-2 * _COLUMN if name.startswith("V") else 0.0), rows[name[1:]] * height) if name[1:] in rows else next(shared)
        for name in names
    ]
    return [*variables, *(next(alone) if place is None else place for place in factors)]


def _column(count: int, x: float, middle: float, step: float) -> list[Place]:
    return [(x, middle + (i - (count - 1) / 2) * step) for i in range(count)]


def _rows(count: int, start: float, step: float) -> list[Place]:
    """Places of `count` nodes in rows, the first row at y = start."""
    starts = range(0, count, _WIDTH)
    return [place for i, at in enumerate(starts) for place in _row(min(_WIDTH, count - at), start + i * step)]


def _row(count: int, y: float) -> list[Place]:
    return [((i - (count - 1) / 2) * _COLUMN, y) for i in range(count)]


def _describe(variable: str) -> str:
    """`X(v=0,t=3)` as `pose X(0, 3)`."""
    letter, _, rest = variable.partition("(")
    numbers = ", ".join(part.partition("=")[2] for part in rest.rstrip(")").split(","))
    return f"{_MEANINGS.get(letter, '')} {letter}({numbers})".strip()


def _label(factor: GraphFactor) -> str:
    name = factor.label.replace("_", " ")
    if factor.term == "reprojection" or (factor.term == "extra" and name):
        return name
    return f"{factor.term}: {name}" if name else factor.term
