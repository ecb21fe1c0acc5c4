"""A video on the page: progress, then the film, the timeline of each car, and its files."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

from nicegui import events, ui
from nicegui.elements.upload_files import FileUpload

from fgrecon.app.result_tabs import TABLE
from fgrecon.app.timeline import HEIGHT, chart_of, in_words
from fgrecon.app.upload_kinds import safe_name
from fgrecon.app.videos import FILM, FRAMES, RECORDING, TABLE_FILE, VideoView, progress_of, stop, track_upload
from fgrecon.app.visit import Visit
from fgrecon.app.workers import Workers
from fgrecon.app.written import as_video_command
from fgrecon.core.errors import FgreconError

_DOWNLOADS = {"Film": FILM, "JSON": FRAMES, "CSV": TABLE_FILE, "Recording": RECORDING}
_POLL = 0.5  # seconds


class VideoPanel:
    """The elements; empty until a video comes."""

    def __init__(self, visit: Visit, workers: Workers, say: Callable[..., None]) -> None:
        """Make them.

        Args:
            visit: Whose video it will be.
            workers: What works on videos.
            say: Tells the visitor something.
        """
        self._visit, self._workers, self._say = visit, workers, say
        self._folder: Path | None = None
        self._running = False
        self._view: VideoView | None = None
        self._car = 0
        self._column = ui.column().classes("w-full")
        ui.context.client.on_delete(self._leave)

    def _leave(self) -> None:
        """The visitor has gone: work that goes on ends soon, and then removes the folder itself."""
        if self._folder is not None and self._running:
            stop(self._folder, left=True)
        else:
            self._remove()

    def _remove(self) -> None:
        folder, self._folder = self._folder, None
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)

    async def begin(self, upload: FileUpload) -> None:
        """Work on a video, and show what becomes of it; photographs go on meanwhile."""
        limits, name = self._visit.limits, safe_name(upload.name)
        if self._running:
            self._say(f"{upload.name}: wait for the other video, or stop it.", bad=True)
            return
        if upload.size() > limits.video_bytes:
            self._say(f"{upload.name}: too large. Give at most {limits.video_bytes >> 20} MB.", bad=True)
            return
        self._remove()
        self._running, self._folder = True, Path(tempfile.mkdtemp(prefix="fgrecon-"))
        folder = self._folder
        try:
            self._show_progress(name, folder)
            await upload.save(folder / name)
            with self._workers.place():
                files = {name: folder / name}
                view = await self._workers(files, track_upload, name, folder, self._visit.requested)
        except FgreconError as error:
            self._end(str(error))
        else:
            self._end("")
            if not self._visit.left:
                self._show(name, view)
        finally:
            self._running = False
            if self._visit.left:
                self._remove()

    def _end(self, problem: str) -> None:
        if not self._visit.left:
            self._timer.deactivate()
            self._column.clear()
            if problem:
                self._say(problem, bad=True)

    def _show_progress(self, name: str, folder: Path) -> None:
        self._column.clear()
        with self._column, ui.card().classes("w-full"):
            ahead = f"{waiting + 1} before it" if (waiting := self._workers.waiting) else "begins"
            status = ui.label(f"{name}: {ahead} ...").props("role=status aria-live=polite")
            bar = ui.linear_progress(0.0, show_value=False).props("aria-label='Progress of the video'")
            ui.button("Stop", icon="stop", on_click=lambda: stop(folder)).props("outline")

            def poll() -> None:
                progress = progress_of(folder)
                if progress is not None:
                    status.text = f"{name}: {progress}"
                    bar.value = progress.done / progress.total if progress.total else 0.0

            self._timer = ui.timer(_POLL, poll)

    def _show(self, name: str, view: VideoView) -> None:
        self._view = view
        folder = self._folder
        assert folder is not None
        files = {label: file for label, file in _DOWNLOADS.items() if (folder / file).exists()}
        self._visit.show({file: folder / file for file in files.values()})
        with self._column, ui.card().classes("w-full"):
            ui.label(f"{name}: {view.words}")
            for line in view.warnings:
                ui.label(line).classes("text-caption")
            if view.filmed:
                self._film = ui.video(self._visit.url(FILM)).classes("w-full").props("aria-label='Film'")
                script = "(e) => emit(e.target.currentTime)"
                self._film.on("timeupdate", self._play, throttle=0.2, js_handler=script)
            with ui.row():
                for label, file in files.items():
                    ui.button(label, icon="download", on_click=lambda f=file: ui.download.from_url(self._visit.url(f)))
            self._make_timeline(view)
            ui.label("As a command")
            ui.code(as_video_command(self._visit.requested, name), language="bash").classes("w-full")

    def _make_timeline(self, view: VideoView) -> None:
        cars = {n: f"{car.name}, {len(car.moments)} poses" for n, car in enumerate(view.cars) if car.moments}
        if not cars:
            ui.label("No car has a pose.")
            return
        self._car = next(iter(cars))
        ui.select(cars, label="Car of the timeline", value=self._car, on_change=self._choose).classes("w-60")
        self._moment = ui.label().props("role=status")
        self._chart = ui.echart(chart_of(view.cars[self._car]), on_point_click=self._seek)
        self._chart.classes("w-full").style(f"height: {HEIGHT}px")
        self._tell(view.cars[self._car].moments[0].time)
        rows = [
            {"car": car.name, "frames": car.frames, "poses": len(car.moments), "from s": car.moments[0].time}
            for car in view.cars
            if car.moments
        ]
        columns = [{"name": h, "label": h, "field": h, "align": "left"} for h in rows[0]]
        ui.table(columns=columns, rows=rows).props(TABLE).classes("w-full")

    def _choose(self, event: events.ValueChangeEventArguments) -> None:
        assert self._view is not None
        self._car = event.value
        self._chart.options.clear()
        self._chart.options.update(chart_of(self._view.cars[self._car]))
        self._tell(self._view.cars[self._car].moments[0].time)

    def _seek(self, event: events.EChartPointClickEventArguments) -> None:
        if self._view is not None and self._view.filmed:
            self._film.seek(float(event.data[0]))
            self._tell(float(event.data[0]))

    def _play(self, event: events.GenericEventArguments) -> None:
        self._tell(float(event.args))

    def _tell(self, seconds: float) -> None:
        """What the chosen car does then, and a line there in the chart."""
        if self._view is None or not self._view.cars[self._car].moments:
            return
        car = self._view.cars[self._car]
        nearest = min(car.moments, key=lambda moment: abs(moment.time - seconds))
        self._moment.text = in_words(car, nearest)
        here = {"symbol": "none", "silent": True, "label": {"show": False}, "data": [{"xAxis": nearest.time}]}
        marks = [{"markLine": here} if "name" in one else {} for one in self._chart.options["series"]]
        self._chart.run_chart_method("setOption", {"series": marks})
