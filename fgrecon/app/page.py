"""`fgrecon app`: the page, by NiceGUI. Each visitor has a `Visit`; nothing is kept of one who has gone."""

from __future__ import annotations

import json
import re
import secrets
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from fastapi import FastAPI, Request, Response
from nicegui import app as nicegui_app
from nicegui import events, ui

from fgrecon.app.guard import Guard
from fgrecon.app.limits import Limits
from fgrecon.app.picture_editor import BOXES, KEYPOINTS, LOOK, Editor, drawing
from fgrecon.app.requested import Requested
from fgrecon.app.sample import make_page_ready, sample_photograph
from fgrecon.app.solving import Uploaded
from fgrecon.app.view import PageView, ShownCar, picture_of, recording_of_upload, view_of
from fgrecon.app.workers import BusyError, Workers
from fgrecon.app.written import as_code, as_command
from fgrecon.core.errors import FgreconError
from fgrecon.core.size_prior import SIZE_PRIORS
from fgrecon.io.images import IMAGES
from fgrecon.viz.outcomes import HEADINGS

_NAME = re.compile(r"[^\w.-]+")
_KIND = {".glb": "model/gltf-binary", ".jpg": "image/jpeg", ".png": "image/png"}
_KEPT = 6  # uploads of a visitor
_CAMERAS = (".txt", ".yaml", ".yml")
_ENTRIES = {
    "intrinsics": "Camera: fx,fy,cx,cy [px]",
    "camera_height": "Height of the camera [m]",
    "ground": "Ground plane: nx,ny,nz,d",
}
_TABLE = "dense flat wrap-cells hide-pagination :rows-per-page-options=[0]"
_HINTS = {
    LOOK: "Drop a photograph, a keypoint file (JSON) or a calibration anywhere, or paste one.",
    BOXES: "Drag in the picture: a new box, a corner, or a box. Keys: n and p choose, arrows move, Delete removes.",
    KEYPOINTS: "Drag a keypoint. Keys: n and p choose, arrows move (Shift: ten pixels), Delete takes it away.",
}
_HEAD = """<style>
.q-uploader{width:100%;max-height:none}.fg-picture img,.fg-picture svg{display:block}
.fg-page{display:grid;width:100%;gap:1rem;grid-template-columns:minmax(0,1fr)}
@media(min-width:900px){.fg-page{grid-template-columns:20rem minmax(0,1fr);grid-template-rows:auto 1fr}
.fg-results{grid-area:1/2/3/3}}
.fg-edit{touch-action:none;cursor:crosshair}.fg-picture:focus-visible{outline:3px solid #5898d4}
</style><script>
const fgFiles = files => {const el = document.querySelector('.fg-upload'); if (el && files.length)
  getElement(parseInt(el.id.slice(1))).$refs.qRef.addFiles(files)};
document.addEventListener('paste', e => fgFiles([...e.clipboardData.files]));
document.addEventListener('dragover', e => e.preventDefault());
document.addEventListener('drop', e => {if (!e.target.closest('.q-uploader')) {e.preventDefault();
  fgFiles([...e.dataTransfer.files])}});
async function fgCamera(video) {window.fgStream = await navigator.mediaDevices.getUserMedia({video: true});
  video.srcObject = window.fgStream; await video.play()}
function fgStop() {window.fgStream && window.fgStream.getTracks().forEach(t => t.stop())}
function fgTake(video) {const c = document.createElement('canvas');
  c.width = video.videoWidth; c.height = video.videoHeight;
  c.getContext('2d').drawImage(video, 0, 0); fgStop();
  c.toBlob(b => fgFiles([new File([b], 'webcam.jpg', {type: 'image/jpeg'})]), 'image/jpeg', 0.95)}
</script>"""


class Visit:
    """One visitor's upload, what is requested of it, and what is shown."""

    def __init__(
        self, workers: Workers, limits: Limits, made: dict[str, dict[str, bytes]], requested: Requested
    ) -> None:
        """Begin with what a link requests."""
        self.workers, self.limits, self.requested = workers, limits, requested
        self.token, self._made = secrets.token_urlsafe(16), made
        made[self.token] = {}
        self.files: dict[str, bytes] = {}
        self.kept: dict[str, bytes] = {}
        self.chosen: str | None = None
        self.uploaded: Uploaded | None = None
        self.view: PageView | None = None
        self.editor = Editor()
        self.step: int | None = None
        self.car = 0
        self._asked = 0

    def leave(self) -> None:
        """Forget everything."""
        self._made.pop(self.token, None)
        self.files, self.kept, self.view = {}, {}, None

    def take(self, name: str, content: bytes) -> None:
        """An upload: a photograph or keypoints begin anew, a calibration is of what comes with it.

        Raises:
            FgreconError: It is too large.
        """
        if len(content) > self.limits.upload_bytes:
            raise FgreconError(f"{name}: too large. Give at most {self.limits.upload_bytes >> 20} MB.")
        safe = (_NAME.sub("_", Path(name.replace("\\", "/")).name).lstrip(".") or "file")[-100:]
        ending = Path(safe).suffix.lower()
        before = self.uploaded
        if ending in _CAMERAS:
            self.files[safe] = content
            self.uploaded = replace(before, camera=safe) if before is not None else Uploaded("", camera=safe)
            return
        if ending not in (*IMAGES, ".json"):
            raise FgreconError(
                f"{name}: of no known kind. Give an image, keypoints (.json) or a calibration (.txt, .yaml)."
            )
        camera = before.camera if before is not None else None
        self.files = {safe: content, **({camera: self.files[camera]} if camera else {})}
        self.kept.pop(safe, None)
        self.kept, self.chosen = dict([*self.kept.items()][1 - _KEPT :]) | {safe: content}, safe
        self.uploaded = Uploaded(safe, camera=camera)
        self.requested = replace(self.requested, box=())

    async def solve(self) -> None:
        """Let a worker solve what there is.

        Raises:
            FgreconError: It cannot be used, or too many wait.
        """
        uploaded = self.uploaded
        if uploaded is None or not uploaded.main:
            return
        self._asked = asked = self._asked + 1
        with self.workers.place():
            view = await self.workers(self.files, view_of, uploaded, self.requested)
        if asked != self._asked:  # something newer was requested meanwhile
            return
        self.view, self.step = view, None
        self.editor = Editor.of(view, self.editor.mode)
        self.car = min(self.car, len(view.cars) - 1)
        self._made[self.token] = {**view.files, "photograph.jpg": view.photograph}

    def edited(self) -> None:
        """Take the boxes or keypoints as they are now for what is to be solved."""
        assert self.view is not None
        assert self.uploaded is not None
        photograph = self.uploaded.photograph or (self.uploaded.main if self.uploaded.of_image else None)
        if self.editor.mode == BOXES and photograph is not None:
            boxes = tuple(",".join(f"{x:.1f}" for x in box) for box in self.editor.boxes)
            self.requested = replace(self.requested, box=boxes)
            self.uploaded = Uploaded(photograph, camera=self.uploaded.camera)
        elif self.editor.mode == KEYPOINTS:
            text = json.dumps(self.editor.keypoint_file(self.view), allow_nan=False)
            self.files["keypoints.json"] = text.encode()
            self.requested = replace(self.requested, box=())
            self.uploaded = Uploaded("keypoints.json", photograph=photograph)

    async def made(self, work: Callable[..., bytes]) -> bytes:
        """What a worker makes of the upload: a picture or a recording."""
        with self.workers.place():
            return await self.workers(self.files, work, self.uploaded, self.requested)

    def url(self, name: str) -> str:
        """Where this visitor alone finds something that was made."""
        return f"/made/{self.token}/{name}?{self._asked}"


def page_app(count: int, limits: Limits, hosts: tuple[str, ...], ready: Callable[[], None]) -> Any:
    """The page as an ASGI application.

    Args:
        count: How many processes solve.
        limits: What it takes.
        hosts: Names under which it may be asked for; `*` is any.
        ready: Called when it answers.
    """
    made: dict[str, dict[str, bytes]] = {}
    workers: list[Workers] = []
    sample: list[bytes] = []
    api = FastAPI(openapi_url=None)

    async def start() -> None:
        workers.append(Workers(count, limits, limits.solve_seconds))
        await workers[0].make_ready(make_page_ready)
        sample.append(await workers[0]({}, sample_photograph))
        ready()

    async def stop() -> None:
        workers.pop().close()

    async def file(request: Request) -> Response:
        token, name = request.path_params["token"], request.path_params["name"]
        content = made.get(token, {}).get(name)
        if content is None:
            return Response("There is none.", 404)
        kind = _KIND.get(Path(name).suffix, "application/octet-stream")
        return Response(content, media_type=kind, headers={"Cache-Control": "no-store"})

    def root(request: Request) -> None:
        try:
            requested, problem = Requested.of(request.query_params.multi_items()), None
        except FgreconError as error:
            requested, problem = Requested(), str(error)
        visit = Visit(workers[0], limits, made, requested)
        ui.context.client.on_delete(visit.leave)
        _Page(visit, lambda: sample[0], problem)

    nicegui_app.on_startup(start)
    nicegui_app.on_shutdown(stop)
    api.add_api_route("/made/{token}/{name}", file)
    ui.page("/", title="fgrecon", dark=None)(root)
    ui.run_with(api, title="fgrecon", dark=None, show_welcome_message=False)
    return Guard(api, limits, hosts)


class _Page:
    """The elements of the page, and what happens when they are used."""

    def __init__(self, visit: Visit, sample: Callable[[], bytes], problem: str | None) -> None:
        self.visit, self._sample = visit, sample
        ui.add_head_html(_HEAD)
        self.dark = ui.dark_mode(value=None)
        with ui.header().classes("items-center q-py-xs").style("background: #1f5f9e"):
            ui.label("fgrecon").classes("text-h6")
            ui.label("a photograph in, cars in 3D out").classes("gt-xs")
            ui.space()
            ui.button(icon="dark_mode", on_click=self._toggle).props(
                "flat round color=white aria-label='Light or dark'"
            )
        ui.colors(primary="#3d85c8")
        with ui.element("div").classes("fg-page"):
            with ui.column().classes("min-w-0"):
                self._make_inputs()
            with ui.column().classes("fg-results min-w-0"):
                self._make_results()
            with ui.column().classes("min-w-0"):
                self._make_settings()
        if problem:
            self._say(problem, bad=True)

    def _toggle(self) -> None:
        self.dark.value = not self.dark.value

    def _make_inputs(self) -> None:
        limit = self.visit.limits.upload_bytes
        self.upload = (
            ui.upload(
                label="Photographs, keypoints, calibration",
                multiple=True,
                auto_upload=True,
                max_file_size=limit,
                on_upload=self._uploaded,
                on_rejected=lambda: self._say("Too large, or no such file.", bad=True),
            )
            .classes("fg-upload")
            .props("accept='image/*,.json,.txt,.yaml,.yml' flat bordered")
        )
        self.several = ui.select([], label="Uploaded", on_change=self._switch).classes("w-full")
        self.several.visible = False
        with ui.row():
            ui.button("Sample", icon="directions_car", on_click=self._take_sample).props("outline")
            ui.button("Webcam", icon="photo_camera", on_click=self._webcam).props("outline")

    def _make_settings(self) -> None:
        given = self.visit.requested
        self.fields: dict[str, Any] = {}
        for name, label in _ENTRIES.items():
            self.fields[name] = ui.input(label, value=getattr(given, name)).classes("w-full").props("dense clearable")
        ui.label("Or its horizontal field of view").classes("text-caption")
        self.view_angle = ui.slider(min=20, max=120, value=60).props("label aria-label='Field of view, degrees'")
        self.view_angle.on("change", self._angle)
        fleets = {"": "as in the shape prior", **{name: name for name in SIZE_PRIORS}}
        self.fields["size_prior"] = ui.select(fleets, label="Fleet", value=given.size_prior).classes("w-full")
        traffic = {"": "not known", "right": "right", "left": "left"}
        self.fields["traffic"] = ui.select(traffic, label="Traffic keeps to the", value=given.traffic).classes("w-full")
        ground = {"": "as usual", "yes": "together", "no": "each alone"}
        self.fields["together"] = ui.select(ground, label="Cars on one ground", value=given.together).classes("w-full")
        self.fields["min_score"] = (
            ui.input("Least score of boxes", value=given.min_score).classes("w-full").props("dense")
        )
        ui.button("Solve", icon="play_arrow", on_click=self._solve).classes("w-full")

    def _make_results(self) -> None:
        self.status = ui.label(_HINTS[LOOK]).props("role=status aria-live=polite")
        self.busy = ui.linear_progress(show_value=False).props("indeterminate aria-label=Working")
        self.busy.visible = False
        self.mode = ui.toggle(
            {LOOK: "Look", BOXES: "Boxes", KEYPOINTS: "Keypoints"}, value=LOOK, on_change=self._set_mode
        )
        pointer = ["pointerdown", "pointermove", "pointerup"]
        self.picture = ui.interactive_image(size=(1242, 375), on_mouse=self._mouse, events=pointer, sanitize=False)
        self.picture.classes("w-full fg-picture bg-grey-8").props("tabindex=0 role=application aria-label=Photograph")
        keys = ["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "n", "p", "Delete", "Backspace"]
        script = f"(e) => {{ if ({json.dumps(keys)}.includes(e.key)) {{ e.preventDefault(); emit(e) }} }}"
        self.picture.on("keydown", self._key, args=["key", "shiftKey"], js_handler=script)
        columns = [{"name": h, "label": h, "field": h, "align": "left"} for h in (*HEADINGS, "why")]
        self.table = ui.table(columns=columns, rows=[], row_key="id").classes("w-full").props(_TABLE)
        self.table.props(":grid='window.innerWidth<700'")
        self.table.visible = False
        self.more = ui.column().classes("w-full")

    def _say(self, words: str, *, bad: bool = False) -> None:
        self.status.text = words
        self.status.classes(add="text-negative" if bad else "", remove="" if bad else "text-negative")

    async def _uploaded(self, event: events.UploadEventArguments) -> None:
        await self._new(event.file.name, await event.file.read())
        self.upload.reset()

    async def _take_sample(self) -> None:
        for name, text in {
            "intrinsics": "721.5,721.5,609.6,172.9",
            "camera_height": "1.65",
            "size_prior": "kitti",
        }.items():
            self.fields[name].value = text
        await self._new("street.png", self._sample())

    async def _new(self, name: str, content: bytes) -> None:
        try:
            self.visit.take(name, content)
        except FgreconError as error:
            self._say(str(error), bad=True)
            return
        self.mode.value = LOOK
        self.several.set_options(list(self.visit.kept), value=self.visit.chosen)
        self.several.visible = len(self.visit.kept) > 1
        await self._solve()

    async def _switch(self, event: events.ValueChangeEventArguments) -> None:
        name = event.value
        if name in self.visit.kept and name != self.visit.chosen:
            await self._new(name, self.visit.kept[name])

    def _webcam(self) -> None:
        with ui.dialog() as dialog, ui.card():
            video = ui.element("video").classes("w-full").props("autoplay muted playsinline")
            taking = f"fgTake(document.getElementById('c{video.id}'))"

            def take() -> None:
                ui.run_javascript(taking)
                dialog.close()

            ui.button("Take", icon="photo_camera", on_click=take)
        dialog.on("hide", lambda: ui.run_javascript("fgStop()"))
        dialog.open()
        ui.run_javascript(f"setTimeout(() => fgCamera(document.getElementById('c{video.id}')), 300)")

    async def _angle(self) -> None:
        from math import radians, tan

        width, height = self.visit.editor.size
        focal = width / 2 / tan(radians(self.view_angle.value) / 2)
        self.fields["intrinsics"].value = f"{focal:.1f},{focal:.1f},{(width - 1) / 2},{(height - 1) / 2}"
        await self._solve()

    async def _solve(self) -> None:
        values: dict[str, Any] = {name: str(field.value or "").strip() for name, field in self.fields.items()}
        self.visit.requested = replace(self.visit.requested, **values)
        await self._work(self.visit.solve, self._show)

    async def _work(self, work: Callable[[], Awaitable[Any]], then: Callable[..., None]) -> None:
        """Let a worker work, and say how it goes."""
        self.busy.visible = True
        self._say(
            "Working ..." if not self.visit.workers.waiting else f"{self.visit.workers.waiting} wait before you ..."
        )
        try:
            result = await work()
        except BusyError as error:
            self._say(str(error), bad=True)
        except FgreconError as error:
            self._say(str(error), bad=True)
        else:
            self._say(_HINTS[self.visit.editor.mode])
            then(*([] if result is None else [result]))
        finally:
            self.busy.visible = False

    def _show(self) -> None:
        view = self.visit.view
        if view is None:
            return
        if view.photograph:
            self.picture.set_source(self.visit.url("photograph.jpg"))
        self._draw()
        self.table.rows = [dict(zip((*HEADINGS, "why"), car.cells, strict=True)) for car in view.cars]
        self.table.visible = True
        if view.warnings:
            self._say(" ".join(view.warnings))
        self.more.clear()
        with self.more:
            self._make_more(view)

    def _draw(self) -> None:
        if self.visit.view is not None:
            visit = self.visit
            assert visit.view is not None
            self.picture.content = drawing(visit.view, visit.editor, visit.step, visit.car)

    def _set_mode(self, event: events.ValueChangeEventArguments) -> None:
        editor = self.visit.editor
        editor.mode, editor.chosen = event.value, None
        self.picture.classes(
            add="fg-edit" if event.value != LOOK else "", remove="fg-edit" if event.value == LOOK else ""
        )
        self._say(_HINTS[event.value])
        self._draw()

    async def _mouse(self, event: events.MouseEventArguments) -> None:
        editor = self.visit.editor
        if self.visit.view is None or editor.mode == LOOK:
            return
        u, v = event.image_x, event.image_y
        if event.type == "pointerdown":
            editor.press(u, v)
        elif event.type == "pointermove":
            if not editor.move(u, v):
                return
        elif editor.release():
            await self._edited()
            return
        self._draw()

    async def _key(self, event: events.GenericEventArguments) -> None:
        changed = self.visit.view is not None and self.visit.editor.key(event.args["key"], far=event.args["shiftKey"])
        self._draw()
        if changed:
            await self._edited()

    async def _edited(self) -> None:
        self._draw()
        chosen = self.visit.editor.chosen
        self.visit.edited()
        await self._solve()
        self.visit.editor.chosen = chosen
        self._draw()

    def _make_more(self, view: PageView) -> None:
        with ui.tabs().props("dense outside-arrows mobile-arrows no-caps").classes("w-full") as tabs:
            names = ("From above", "3D", "Steps", "Other poses", "Save", "Code")
            made = {name: ui.tab(name) for name in names}
        with ui.tab_panels(tabs, value=made["From above"]).classes("w-full"):
            fill: Mapping[str, Callable[[], None]] = {
                "From above": self._above,
                "3D": self._scene,
                "Steps": self._steps,
                "Other poses": lambda: _others(view.cars),
                "Save": self._saves,
                "Code": self._code,
            }
            for name, tab in made.items():
                with ui.tab_panel(tab).classes("q-pa-sm"):
                    fill[name]()

    def _above(self) -> None:
        if "above.png" in self._files:
            words = "Cars from above, with headings and the regions where they are"
            ui.image(self.visit.url("above.png")).classes("w-full").style("max-width: 34rem").props(f"alt='{words}'")
        else:
            ui.label("No car has a pose.")

    @property
    def _files(self) -> Mapping[str, bytes]:
        return {} if self.visit.view is None else self.visit.view.files

    def _scene(self) -> None:
        if "cars.glb" not in self._files:
            ui.label("No car has a pose.")
            return
        scene = ui.scene(width=600, height=360, grid=(60, 60), background_color="#e8e8e8").classes("w-full")
        with scene:
            height = 0.0 if self.visit.view is None else self.visit.view.height
            with scene.group().rotate(1.5708, 0.0, 0.0).move(0.0, 0.0, height):  # up is z here, and y in GLB
                scene.gltf(self.visit.url("cars.glb"))
        scene.move_camera(x=0.0, y=1.0, z=4.5, look_at_x=0.0, look_at_y=12.0, look_at_z=0.0, duration=0.0)
        ui.label("Turn it by dragging, move it with the right button, zoom with the wheel.").classes("text-caption")

    def _steps(self) -> None:
        assert self.visit.view is not None
        cars = [(number, car) for number, car in enumerate(self.visit.view.cars) if car.steps]
        if not cars:
            ui.label("No car has a pose.")
            return
        self.visit.car = next((n for n, _ in cars if n == self.visit.car), cars[0][0])
        ui.select(
            {n: car.name for n, car in cars}, label="Car", value=self.visit.car, on_change=self._choose_car
        ).classes("w-40")
        self.at_step = ui.label()
        self.slider = ui.slider(min=0, max=1, value=0, on_change=self._set_step).props("label aria-label='Step'")
        self.bars = ui.echart(_bars()).classes("w-full").style("height: 16rem")
        self.energies = ui.label().classes("text-caption")
        self._begin_steps()

    def _begin_steps(self) -> None:
        assert self.visit.view is not None
        last = len(self.visit.view.cars[self.visit.car].steps) - 1
        self.slider.props(f"max={last}")
        self.slider.set_value(last)
        self._tell_step(last)
        self.visit.step = None
        self._draw()

    def _choose_car(self, event: events.ValueChangeEventArguments) -> None:
        self.visit.car = event.value
        self._begin_steps()

    def _set_step(self, event: events.ValueChangeEventArguments) -> None:
        if event.value is None:
            return
        self.visit.step = int(event.value)
        self._tell_step(self.visit.step)
        self._draw()

    def _tell_step(self, number: int) -> None:
        assert self.visit.view is not None
        car = self.visit.view.cars[self.visit.car]
        step = car.steps[min(number, len(car.steps) - 1)]
        self.at_step.text = f"Step {number + 1} of {len(car.steps)}: {step.title}"
        self.bars.options["xAxis"]["data"] = [name.replace("_", " ") for name in car.keypoints]
        self.bars.options["series"][0]["data"] = step.weights
        energies = ", ".join(f"{term} {energy:.1f}" for term, energy in step.energies.items())
        graph = ", ".join(f"{count} {term}" for term, count in car.factors.items())
        self.energies.text = f"Energies in nats: {energies}." + (f" Factors of the graph: {graph}." if graph else "")

    def _saves(self) -> None:
        names = {"results.json": "JSON", "cars.csv": "CSV", "cars.glb": "GLB"}
        with ui.row():
            for name, label in names.items():
                if name in self._files:
                    ui.button(label, icon="download", on_click=lambda n=name: ui.download.content(self._files[n], n))
            if "cars.csv" in self._files:
                ui.button("Picture", icon="image", on_click=lambda: self._make(picture_of, "cars.png"))
                ui.button("Recording", icon="movie", on_click=lambda: self._make(recording_of_upload, "cars.rrd"))

    async def _make(self, work: Callable[..., bytes], name: str) -> None:
        await self._work(lambda: self.visit.made(work), lambda content: ui.download.content(content, name))

    def _code(self) -> None:
        uploaded = self.visit.uploaded
        assert uploaded is not None
        asked = self.visit.requested
        ui.label("As a command")
        ui.code(as_command(asked, uploaded.main), language="bash").classes("w-full")
        ui.label("As code")
        ui.code(as_code(asked, uploaded.main, of_image=uploaded.of_image), language="python").classes("w-full")
        ui.link("A link with these settings", f"/?{asked.query}")


def _bars() -> dict[str, Any]:
    return {
        "grid": {"left": 36, "right": 8, "top": 10, "bottom": 96},
        "tooltip": {},
        "textStyle": {"color": "#888"},
        "xAxis": {
            "type": "category",
            "data": [],
            "axisLabel": {"rotate": 50, "interval": 0, "fontSize": 10, "color": "#888"},
        },
        "yAxis": {"axisLabel": {"color": "#888"}, "min": 0, "max": 1, "name": "weight"},
        "series": [{"type": "bar", "data": []}],
    }


def _others(cars: list[ShownCar]) -> None:
    headings = ("car", "probability", "nats", "yaw °", "x, y, z m")
    columns = [{"name": h, "label": h, "field": h, "align": "left"} for h in headings]
    rows = [dict(zip(headings, (car.name, *other), strict=True)) for car in cars for other in car.others]
    ui.table(columns=columns, rows=rows).props(_TABLE).classes("w-full")
    ui.label("The first of each car is the result; the others are where its search ended as well.").classes(
        "text-caption"
    )
