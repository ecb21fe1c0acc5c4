"""The optimisation step by step: a slider, the weights of the keypoints as bars, energies and factors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nicegui import events, ui

from fgrecon.app.view import PageView
from fgrecon.app.visit import Visit


class StepsTab:
    """The elements, and what the slider does."""

    def __init__(self, visit: Visit, view: PageView, draw: Callable[[], None]) -> None:
        """Make them.

        Args:
            visit: Whose cars they are.
            view: The cars.
            draw: Draws the visit's step on the photograph.
        """
        self._visit, self._view, self._draw = visit, view, draw
        cars = [number for number, car in enumerate(view.cars) if car.steps]
        if not cars:
            ui.label("No car has a pose.")
            return
        visit.car = visit.car if visit.car in cars else cars[0]
        names = {number: view.cars[number].name for number in cars}
        ui.select(names, label="Car", value=visit.car, on_change=self._choose).classes("w-40")
        self._title = ui.label()
        self._slider = ui.slider(min=0, max=1, value=0, on_change=self._set).props("label aria-label='Step'")
        self._bars = ui.echart(_bars()).classes("w-full").style("height: 16rem")
        self._energies = ui.label().classes("text-caption")
        self._begin()

    def _begin(self) -> None:
        last = len(self._view.cars[self._visit.car].steps) - 1
        self._slider.props(f"max={last}")
        self._slider.set_value(last)
        self._tell(last)
        self._visit.step = None
        self._draw()

    def _choose(self, event: events.ValueChangeEventArguments) -> None:
        self._visit.car = event.value
        self._begin()

    def _set(self, event: events.ValueChangeEventArguments) -> None:
        if event.value is None:
            return
        self._visit.step = int(event.value)
        self._tell(self._visit.step)
        self._draw()

    def _tell(self, number: int) -> None:
        car = self._view.cars[self._visit.car]
        step = car.steps[min(number, len(car.steps) - 1)]
        self._title.text = f"Step {number + 1} of {len(car.steps)}: {step.title}"
        self._bars.options["xAxis"]["data"] = [name.replace("_", " ") for name in car.keypoints]
        self._bars.options["series"][0]["data"] = step.weights
        energies = ", ".join(f"{term} {energy:.1f}" for term, energy in step.energies.items())
        graph = ", ".join(f"{count} {term}" for term, count in car.factors.items())
        self._energies.text = f"Energies in nats: {energies}." + (f" Factors of the graph: {graph}." if graph else "")


def _bars() -> dict[str, Any]:
    grey = {"color": "#888"}
    return {
        "grid": {"left": 36, "right": 8, "top": 10, "bottom": 96},
        "tooltip": {},
        "textStyle": grey,
        "xAxis": {"type": "category", "data": [], "axisLabel": {"rotate": 50, "interval": 0, "fontSize": 10, **grey}},
        "yAxis": {"axisLabel": grey, "min": 0, "max": 1, "name": "weight"},
        "series": [{"type": "bar", "data": []}],
    }
