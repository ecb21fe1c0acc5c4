"""The photograph of the page: overlays, and boxes and keypoints that mouse and keys move."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any

from fgrecon.app.view import PageView, Pixels, ShownCar
from fgrecon.core.text import distinct

LOOK, BOXES, KEYPOINTS = "look", "boxes", "keypoints"
"""What mouse and keys do."""

_REACH = 14.0  # pixels on the screen within which something is taken hold of
_LEAST = 8.0  # pixels of a box's side; smaller ones are a click
_HAND_SHARE, _HAND_LEAST = 0.02, 1.0  # of the box's height, and pixels: how exact a hand is; not tuned
_KEYS = {"ArrowLeft": (-1, 0), "ArrowRight": (1, 0), "ArrowUp": (0, -1), "ArrowDown": (0, 1)}


@dataclass
class Editor:
    """Boxes and keypoints while they are edited, in pixels of the image."""

    size: tuple[int, int] = (1, 1)  # of the image
    names: list[str] = field(default_factory=list)  # of the vehicles, all different
    cars: dict[str, ShownCar] = field(default_factory=dict)  # what is known of those that were not drawn, by name
    boxes: list[list[float]] = field(default_factory=list)  # x1, y1, x2, y2 of each vehicle; empty where it has none
    # keypoints of each vehicle, None where one was not measured; empty for a box that was drawn
    points: list[Pixels] = field(default_factory=list)
    mode: str = LOOK  # one of `LOOK`, `BOXES` and `KEYPOINTS`
    chosen: tuple[int, int] | None = None  # vehicle and, in mode `KEYPOINTS`, keypoint that keys move; None for none
    changed: set[str] = field(default_factory=set)  # vehicles whose box was changed
    # keypoints that were moved or taken away, as vehicle and keypoint
    righted: set[tuple[str, int]] = field(default_factory=set)
    _corner: int | None = None
    _from: tuple[float, float] | None = None

    @classmethod
    def of(cls, view: PageView, mode: str) -> Editor:
        """What a view has to edit."""
        boxes = [[float(x) for x in car.instance.get("box", ())] for car in view.cars]
        taken = set[str]()
        cars = {distinct(car.name, taken): car for car in view.cars}
        return cls(view.size, [*cars], cars, boxes, [list(car.instance["keypoints"]) for car in view.cars], mode)

    def anew(self, by_hand: Collection[str]) -> list[int]:
        """Vehicles whose keypoints the networks have to look for: boxes drawn or changed, but for those by hand."""
        return [
            number
            for number, name in enumerate(self.names)
            if self.boxes[number] and (not self.points[number] or (name in self.changed and name not in by_hand))
        ]

    @property
    def scale(self) -> float:
        """Pixels of the image in one of the screen, about."""
        return max(self.size[0] / 900.0, 0.5)

    def press(self, u: float, v: float) -> None:
        """Take hold of what is there; in mode `BOXES`, where nothing is, a new box begins."""
        self._from = (u, v)
        if self.mode == KEYPOINTS:
            near = [
                ((point[0] - u) ** 2 + (point[1] - v) ** 2, (car, k))
                for car, points in enumerate(self.points)
                for k, point in enumerate(points)
                if point is not None
            ]
            distance, self.chosen = min(near, default=(float("inf"), None))
            if distance > (_REACH * self.scale) ** 2:
                self.chosen = self._from = None
        elif self.mode == BOXES:
            self._press_box(u, v)

    def _press_box(self, u: float, v: float) -> None:
        reach = _REACH * self.scale
        known = [(number, (box[0], box[1], box[2], box[3])) for number, box in enumerate(self.boxes) if box]
        for number, (x1, y1, x2, y2) in known:
            for corner, (x, y) in enumerate(((x1, y1), (x2, y1), (x2, y2), (x1, y2))):
                if abs(x - u) < reach and abs(y - v) < reach:
                    self.chosen, self._corner = (number, 0), corner
                    return
        inside = [(x2 - x1, n) for n, (x1, y1, x2, y2) in known if x1 < u < x2 and y1 < v < y2]
        if inside:
            self.chosen, self._corner = (min(inside)[1], 0), None
            return
        self.names.append(distinct(f"drawn-{len(self.boxes) + 1}", set(self.names)))
        self.points.append([])
        self.boxes.append([u, v, u, v])
        self.chosen, self._corner = (len(self.boxes) - 1, 0), 2

    def move(self, u: float, v: float) -> bool:
        """Move what is held; whether anything was."""
        if self._from is None or self.chosen is None:
            return False
        step = (u - self._from[0], v - self._from[1])
        self._from = (u, v)
        self._shift(*step)
        return True

    def _shift(self, across: float, down: float) -> None:
        assert self.chosen is not None
        car, k = self.chosen
        width, height = self.size
        if self.mode == KEYPOINTS:
            point = self.points[car][k]
            if point is not None:
                self.righted.add((self.names[car], k))
                self.points[car][k] = [_within(point[0] + across, width), _within(point[1] + down, height)]
            return
        moved = {0: (0, 1), 1: (2, 1), 2: (2, 3), 3: (0, 3), None: (0, 1, 2, 3)}[self._corner]
        box = self.boxes[car]
        self.changed.add(self.names[car])
        for side in moved:
            box[side] = _within(box[side] + (down if side % 2 else across), (width, height)[side % 2])

    def release(self) -> bool:
        """Let go; whether something has changed."""
        held, self._from = self._from is not None and self.chosen is not None, None
        if self.mode != BOXES or not held:
            return held and self.mode == KEYPOINTS
        number = self.chosen[0] if self.chosen is not None else 0
        x1, y1, x2, y2 = self.boxes[number]
        self.boxes[number] = [min(x1, x2), min(y1, y2), max(x1, x2), max(y1, y2)]
        self._corner = None
        if min(abs(x2 - x1), abs(y2 - y1)) >= _LEAST:
            return self.names[number] in self.changed
        self.remove()  # a click
        return False

    def key(self, name: str, *, far: bool = False) -> bool:
        """Do what a key means: arrows move, n and p choose, Delete removes; whether something changed."""
        if name in ("n", "p"):
            self._choose(1 if name == "n" else -1)
            return False
        if self.chosen is None or self.mode == LOOK:
            return False
        if name in ("Delete", "Backspace"):
            self.remove()
            return True
        if name in _KEYS:
            across, down = _KEYS[name]
            self._corner = None
            self._shift((10 if far else 1) * across, (10 if far else 1) * down)
            return True
        return False

    def _choose(self, step: int) -> None:
        places = (
            [(n, 0) for n, box in enumerate(self.boxes) if box]
            if self.mode == BOXES
            else [(c, k) for c, points in enumerate(self.points) for k, p in enumerate(points) if p is not None]
        )
        if places and self.mode != LOOK:
            at = places.index(self.chosen) + step if self.chosen in places else 0
            self.chosen = places[at % len(places)]

    def remove(self) -> None:
        """Remove the chosen box, or take the chosen keypoint for not measured."""
        if self.chosen is None:
            return
        car, k = self.chosen
        if self.mode == BOXES:
            del self.boxes[car], self.points[car], self.names[car]
        elif self.mode == KEYPOINTS:
            self.points[car][k] = None
            self.righted.add((self.names[car], k))
        self.chosen = None

    def hidden(self, number: int) -> dict[int, str]:
        """Names of a vehicle's keypoints that are not measured and that the graph has a place for, by their number."""
        car = self.cars.get(self.names[number])
        if car is None or not car.steps:
            return {}
        placed = car.steps[-1].wireframe
        return {
            k: name.replace("_", " ")
            for k, name in enumerate(car.keypoints)
            if self.points[number][k] is None and placed[k] is not None
        }

    def place(self, number: int, keypoint: int) -> None:
        """Put a keypoint that is not measured where the graph has it."""
        point = self.cars[self.names[number]].steps[-1].wireframe[keypoint]
        assert point is not None
        self.points[number][keypoint] = [_within(point[0], self.size[0]), _within(point[1], self.size[1])]
        self.chosen = (number, keypoint)
        self.righted.add((self.names[number], keypoint))

    def keypoint_file(self, view: PageView, found: Mapping[int, Mapping[str, Any]]) -> dict[str, Any]:
        """The vehicles as they are now, as a keypoint file has them.

        Args:
            view: What they were.
            found: What the networks make of boxes that were drawn or changed, by the vehicle's number.
        """
        instances = []
        for number, name in enumerate(self.names):
            if number in found:
                instances.append({**found[number], "id": name})
                continue
            box = {"box": self.boxes[number]} if self.boxes[number] else {}
            instance = {**self.cars[name].instance, **box, "keypoints": self.points[number]}
            instances.append(_righted(instance, {k for one, k in self.righted if one == name}))
        return {**view.camera, "instances": instances}


def _righted(instance: dict[str, Any], keypoints: Collection[int]) -> dict[str, Any]:
    """A vehicle some of whose keypoints were placed by hand: they are trusted, and as exact as a hand is."""
    points, confidence = instance["keypoints"], list(instance.get("confidence") or [1.0] * len(instance["keypoints"]))
    changes = {"confidence": [1.0 if p is None or c is None else c for p, c in zip(points, confidence, strict=True)]}
    for k in keypoints:
        changes["confidence"][k] = 1.0
    if instance.get("covariance") is not None and keypoints:
        variance = hand_variance(instance.get("box") or [0.0] * 4)
        exact = [[variance, 0.0], [0.0, variance]]
        changes["covariance"] = [exact if k in keypoints else c for k, c in enumerate(instance["covariance"])]
    return instance | changes


def hand_variance(box: Sequence[float]) -> float:
    """Of a coordinate of a keypoint that was placed by hand in a car's box x1, y1, x2, y2; square pixels."""
    return max(_HAND_SHARE * (box[3] - box[1]), _HAND_LEAST) ** 2


def _within(value: float, limit: int) -> float:
    return min(max(value, 0.0), limit - 1.0)


def drawing(view: PageView, editor: Editor, step: int | None, shown: int | None = None) -> str:
    """What is drawn on the photograph, as SVG in pixels of the image.

    Args:
        view: What there is to see.
        editor: Boxes and keypoints as they are now.
        step: Of the optimisation that is shown; None for the results.
        shown: The only vehicle that is shown at a step.
    """
    unit, parts = editor.scale, []
    if view.horizon and None not in view.horizon:
        parts.append(_line(view.horizon, "#fff", 1.0 * unit, f"{8 * unit} {4 * unit}"))
    for number, car in enumerate(view.cars):
        if not car.steps:
            continue
        at = car.steps[-1 if step is None or number != shown else min(step, len(car.steps) - 1)]
        faint = editor.mode != LOOK
        for a, b in car.edges:
            parts.append(_line([at.wireframe[a], at.wireframe[b]], car.colour, (1.0 if faint else 2.0) * unit))
        if step is None or number != shown:
            parts += [_line(edge, car.colour, 0.8 * unit, f"{3 * unit} {3 * unit}") for edge in car.frame]
    for number, box in enumerate(editor.boxes):
        if not box:
            continue
        parts.append(
            _box(box, unit, chosen=editor.mode == BOXES and editor.chosen == (number, 0), handles=editor.mode == BOXES)
        )
    if editor.mode == KEYPOINTS or step is not None:
        parts += _points(editor, unit)
    parts += [_name(car, unit) for car in view.cars]
    return "".join(parts)


def _points(editor: Editor, unit: float) -> list[str]:
    drawn = []
    for number, points in enumerate(editor.points):
        car = editor.cars.get(editor.names[number])
        for k, point in enumerate(points):
            if point is None or car is None:
                continue
            chosen, colour = editor.chosen == (number, k), car.colour
            title = escape(car.keypoints[k]) if k < len(car.keypoints) else ""
            fill = colour if car.is_trusted(k) or (editor.names[number], k) in editor.righted else "none"
            edge = "#ff0" if chosen else "#fff" if fill == colour else colour
            drawn.append(
                f'<circle cx="{point[0]:.1f}" cy="{point[1]:.1f}" r="{(6 if chosen else 4) * unit:.1f}" '
                f'fill="{fill}" stroke="{edge}" stroke-width="{1.5 * unit:.1f}"><title>{title}</title></circle>'
            )
    return drawn


def _line(points: Sequence[list[float] | None], colour: str, width: float, dashes: str = "") -> str:
    if None in points:
        return ""
    (a, b), (c, d) = points  # type: ignore[misc]  # none of them is None
    look = f'stroke="{colour}" stroke-width="{width:.2f}" stroke-linecap="round"'
    dashed = f' stroke-dasharray="{dashes}"' if dashes else ""
    return f'<line x1="{a}" y1="{b}" x2="{c}" y2="{d}" {look}{dashed}/>'


def _box(box: Sequence[float], unit: float, *, chosen: bool, handles: bool) -> str:
    x1, y1 = min(box[0], box[2]), min(box[1], box[3])
    width, height = abs(box[2] - box[0]), abs(box[3] - box[1])
    colour = "#ff0" if chosen else "#fff"
    shape = (
        f'<rect x="{x1:.1f}" y="{y1:.1f}" width="{width:.1f}" height="{height:.1f}" fill="none" stroke="{colour}" '
        f'stroke-width="{(2.5 if handles else 1.0) * unit:.2f}"/>'
    )
    if not handles:
        return shape
    side = 8 * unit
    corners = ((x1, y1), (x1 + width, y1), (x1 + width, y1 + height), (x1, y1 + height))
    return shape + "".join(
        f'<rect x="{x - side / 2:.1f}" y="{y - side / 2:.1f}" width="{side:.1f}" height="{side:.1f}" fill="{colour}"/>'
        for x, y in corners
    )


def _name(car: ShownCar, unit: float) -> str:
    box = car.instance.get("box")
    if not box:
        return ""
    look = f'font-size="{15 * unit:.1f}" font-family="sans-serif" font-weight="bold" stroke="#fff" paint-order="stroke"'
    return (
        f'<text x="{box[0]:.1f}" y="{max(box[1] - 4 * unit, 14 * unit):.1f}" {look} stroke-width="{3 * unit:.1f}" '
        f'fill="{car.colour}">{escape(car.name)}</text>'
    )
