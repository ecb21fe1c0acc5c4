"""The factor graph of a recording: variables in the middle, keypoints' factors above, all others below."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fgrecon.core.reconstruction import GraphFactor
from fgrecon.viz import entities, style
from fgrecon.viz.columns import Outbox, column, fixed_columns
from fgrecon.viz.playback import Playback
from fgrecon.viz.style import Colour

__all__ = ["Layout", "lay_out", "log_graph", "log_layout"]

_MEANINGS = {"X": "pose", "L": "shape", "O": "offsets", "P": "plane", "M": "medial plane"}
_COLUMN, _ROW, _GAP = 130.0, 30.0, 75.0
_WIDTH = 4  # nodes in a row
_LARGE, _SMALL = 14.0, 6.0

Place = tuple[float, float]


@dataclass(frozen=True)
class Layout:
    """A graph as it is drawn: V variables, then F factors.

    Attributes:
        key: What is laid out.
        nodes: V + F unique names.
        labels: V + F texts.
        positions: (V + F, 2) places, x to the right, y down.
        colours: V + F colours.
        variables: V.
        edges: Pairs (factor, variable) of names.
    """

    key: tuple[GraphFactor, ...]
    nodes: tuple[str, ...]
    labels: tuple[str, ...]
    positions: NDArray[np.float64]
    colours: tuple[Colour, ...]
    variables: int
    edges: tuple[tuple[str, str], ...]


def log_graph(play: Playback) -> None:
    """The graph that the result minimises; the factors of keypoints are coloured by weight at every step."""
    import rerun as rr

    graph = play.reconstruction.graph
    if not graph:
        return
    layout = lay_out(graph)
    log_layout(play.stream, layout)
    place = {name: index for index, name in enumerate(play.reconstruction.keypoint_names)}
    drawn = [(row, place[f.label]) for row, f in enumerate(graph, start=layout.variables) if _is_keypoint(f, place)]
    colours = np.broadcast_to(np.array(layout.colours, dtype=np.uint8), (len(play.steps), len(layout.nodes), 3)).copy()
    if drawn:
        nodes, keypoints = np.array(drawn).T
        colours[:, nodes] = style.readable(play.colours[:, keypoints])
    columns = [column(rr.GraphNodes, "colors", colours.reshape(-1, 3), len(layout.nodes))]
    play.every_step(entities.GRAPH, columns)


def _is_keypoint(factor: GraphFactor, names: Mapping[str, int]) -> bool:
    return factor.term == "reprojection" and factor.label in names


def log_layout(stream: Outbox, layout: Layout, *, colours: bool = False) -> None:
    """Log nodes and edges without a time; the colours too, where no step changes them."""
    import rerun as rr

    small = len(layout.nodes) - layout.variables
    nodes: dict[str, Any] = {
        "node_ids": layout.nodes,
        "positions": layout.positions,
        "labels": layout.labels,
        "radii": np.repeat([_LARGE, _SMALL], [layout.variables, small]),
    }
    if colours:
        nodes["colors"] = np.array(layout.colours, dtype=np.uint8)
    columns = [
        *fixed_columns(rr.GraphNodes, show_labels=True),
        *(column(rr.GraphNodes, name, values) for name, values in nodes.items()),
        *fixed_columns(rr.GraphEdges, graph_type="undirected"),
        column(rr.GraphEdges, "edges", layout.edges),
    ]
    stream.send_columns(entities.GRAPH, [], columns)


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
    """One row per pose with the factors that it is in to its right; all else in columns on the left."""
    rows = {name: row for row, name in enumerate(name for name in names if name.startswith("X"))}
    middle = (len(rows) - 1) / 2
    shared = [name for name in names if name not in rows]
    places = [
        (0.0, rows[name] * _ROW) if name in rows else (-2 * _COLUMN, (middle + 2 * shared.index(name)) * _ROW)
        for name in names
    ]
    columns = dict.fromkeys(rows, 0)
    alone = [factor for factor in graph if not rows.keys() & set(factor.variables)]
    for factor in graph:
        pose = next((name for name in factor.variables if name in rows), None)
        if pose is None:
            row = middle + 1.5 * (alone.index(factor) - (len(alone) - 1) / 2)
            places.append((-3.5 * _COLUMN, row * _ROW))
        else:
            columns[pose] += 1
            places.append((columns[pose] * _COLUMN, rows[pose] * _ROW))
    return places


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
    if factor.term == "reprojection":
        return name
    return f"{factor.term}: {name}" if name else factor.term
