"""Tabs below the table of cars: from above, in 3D, step by step, alternative poses, files, code."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from nicegui import events, ui

from fgrecon.app.steps_tab import StepsTab
from fgrecon.app.view import PageView, picture_of, recording_of_upload
from fgrecon.app.visit import Visit
from fgrecon.app.written import as_code, as_command

TABLE = "dense flat wrap-cells hide-pagination :rows-per-page-options=[0]"
"""How tables look."""

Work = Callable[[Callable[[], Awaitable[Any]], Callable[..., None]], Awaitable[None]]
"""Lets a worker work and says how it goes, then does something with the result."""

_DOWNLOADS = {"results.json": "JSON", "cars.csv": "CSV", "cars.glb": "GLB"}


class ResultTabs:
    """The tabs of a view."""

    def __init__(self, visit: Visit, view: PageView, draw: Callable[[], None], work: Work) -> None:
        """Make them.

        Args:
            visit: Whose cars they are.
            view: The cars.
            draw: Draws the visit's step on the photograph.
            work: Lets a worker work.
        """
        self._visit, self._view, self._work = visit, view, work
        fill: dict[str, Callable[[], Any]] = {
            "From above": self._above,
            "3D": self._scene,
            "Steps": lambda: StepsTab(visit, view, draw),
            "Other poses": self._others,
            "Save": self._saves,
            "Code": self._code,
        }
        with ui.tabs().props("dense outside-arrows mobile-arrows no-caps").classes("w-full") as tabs:
            made = {name: ui.tab(name) for name in fill}
        with ui.tab_panels(tabs, value=made["From above"]).classes("w-full"):
            for name, tab in made.items():
                with ui.tab_panel(tab).classes("q-pa-sm"):
                    fill[name]()

    def _above(self) -> None:
        if "above.png" not in self._view.files:
            ui.label("No car has a pose.")
            return
        words = "Cars from above, with headings and the regions where they are"
        shown = ui.image(self._visit.url("above.png")).classes("w-full").style("max-width: 34rem")
        shown.props(f"alt='{words}'")

    def _scene(self) -> None:
        if "cars.glb" not in self._view.files:
            ui.label("No car has a pose.")
            return
        scene = ui.scene(width=600, height=360, grid=(60, 60), background_color="#e8e8e8").classes("w-full")
        with scene, scene.group().rotate(1.5708, 0.0, 0.0).move(0.0, 0.0, self._view.height):  # GLB's y points up
            cars = scene.gltf(self._visit.url("cars.glb"))
            models = scene.gltf(self._visit.url("models.glb")) if "models.glb" in self._view.files else None
        scene.move_camera(x=0.0, y=1.0, z=4.5, look_at_x=0.0, look_at_y=12.0, look_at_z=0.0, duration=0.0)
        if models is not None:
            models.visible(value=False)

            def choose(event: events.ValueChangeEventArguments) -> None:
                cars.visible(value=not event.value)
                models.visible(value=event.value)

            ui.switch("Closest car models", on_change=choose)
            for line in self._view.closest:
                ui.label(line).classes("text-caption")
        ui.label("Turn it by dragging, move it with the right button, zoom with the wheel.").classes("text-caption")

    def _others(self) -> None:
        headings = ("car", "probability", "nats", "yaw °", "x, y, z m")
        columns = [{"name": h, "label": h, "field": h, "align": "left"} for h in headings]
        rows = [dict(zip(headings, (car.name, *other), strict=True)) for car in self._view.cars for other in car.others]
        ui.table(columns=columns, rows=rows).props(TABLE).classes("w-full")
        words = "The first of each car is the result; the others are where its search ended as well."
        ui.label(words).classes("text-caption")

    def _saves(self) -> None:
        files = self._view.files
        with ui.row():
            for name, label in _DOWNLOADS.items():
                if name in files:
                    ui.button(label, icon="download", on_click=lambda n=name: ui.download.content(files[n], n))
            if "cars.csv" in files:
                ui.button("Picture", icon="image", on_click=lambda: self._make(picture_of, "cars.png"))
                ui.button("Recording", icon="movie", on_click=lambda: self._make(recording_of_upload, "cars.rrd"))

    async def _make(self, work: Callable[..., bytes], name: str) -> None:
        await self._work(lambda: self._visit.made(work), lambda content: ui.download.content(content, name))

    def _code(self) -> None:
        requested, names = self._visit.requested, self._visit.upload.names
        ui.label("As a command")
        ui.code(as_command(requested, names), language="bash").classes("w-full")
        ui.label("As code")
        ui.code(as_code(requested, names), language="python").classes("w-full")
        ui.link("A link with these settings", f"/?{requested.query}")
