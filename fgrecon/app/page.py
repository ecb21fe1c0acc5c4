"""The page: input at the left, results at the right."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import replace
from math import radians, tan
from typing import Any

from nicegui import events, ui
from nicegui.elements.upload_files import SmallFileUpload

from fgrecon.app.picture_editor import LOOK
from fgrecon.app.picture_panel import HINTS, PicturePanel
from fgrecon.app.result_tabs import TABLE, ResultTabs
from fgrecon.app.sample import GIVEN, sample_video
from fgrecon.app.upload_kinds import is_video
from fgrecon.app.video_panel import VideoPanel
from fgrecon.app.visit import Visit
from fgrecon.app.workers import Workers
from fgrecon.core.errors import FgreconError
from fgrecon.core.size_prior import SIZE_PRIORS
from fgrecon.viz.outcomes import HEADINGS

_ACCEPT = "image/*,video/*,.mkv,.json,.txt,.yaml,.yml"
_ENTRIES = {
    "intrinsics": "Camera: fx,fy,cx,cy [px]",
    "camera_height": "Height of the camera [m]",
    "ground": "Ground plane: nx,ny,nz,d",
}
_FRAMES = {
    "every": "Take every so many frames",
    "start": "Begin so many seconds after the first",
    "end": "End so many seconds after the first",
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
document.addEventListener('paste', e => {const c = e.clipboardData;
  if (c.files.length) return fgFiles([...c.files]);
  const text = c.getData('text').trim(), json = /^[{[]/.test(text);
  if (!text || /^(INPUT|TEXTAREA)$/.test(e.target.tagName)) return;
  fgFiles([new File([text], json ? 'pasted.json' : 'pasted.txt', {type: 'text/plain'})])});
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


class MainPage:
    """The elements of the page, and what happens when they are used."""

    def __init__(self, visit: Visit, video_workers: Workers, sample: bytes, problem: str | None) -> None:
        self.visit, self._video_workers, self._sample = visit, video_workers, sample
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
        self.upload = (
            ui.upload(
                label="Photographs, video, keypoints, boxes, calibration",
                multiple=True,
                auto_upload=True,
                max_file_size=self.visit.limits.video_bytes,
                on_upload=self._uploaded,
                on_rejected=lambda: self._say("Too large, or no such file.", bad=True),
            )
            .classes("fg-upload")
            .props(f"accept='{_ACCEPT}' flat bordered")
        )
        self.several = ui.select([], label="Uploaded", on_change=self._switch).classes("w-full")
        self.several.visible = False
        with ui.row():
            ui.button("Sample", icon="directions_car", on_click=self._take_sample).props("outline")
            ui.button("Video", icon="movie", on_click=self._take_video).props("outline aria-label='Sample video'")
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
        with ui.expansion("Frames of a video").classes("w-full"):
            for name, label in _FRAMES.items():
                self.fields[name] = ui.input(label, value=getattr(given, name)).classes("w-full").props("dense")
        ui.button("Solve", icon="play_arrow", on_click=self._solve).classes("w-full")

    def _make_results(self) -> None:
        self.status = ui.label(HINTS[LOOK]).props("role=status aria-live=polite")
        self.busy = ui.linear_progress(show_value=False).props("indeterminate aria-label=Working")
        self.busy.visible = False
        self.picture = PicturePanel(self.visit, self._say, self._edited)
        columns = [{"name": h, "label": h, "field": h, "align": "left"} for h in (*HEADINGS, "why")]
        self.table = ui.table(columns=columns, rows=[], row_key="id").classes("w-full").props(TABLE)
        self.table.props(":grid='window.innerWidth<700'")
        self.table.visible = False
        self.more = ui.column().classes("w-full")
        self.video = VideoPanel(self.visit, self._video_workers, self._say)

    def _say(self, words: str, *, bad: bool = False) -> None:
        self.status.text = words
        self.status.classes(add="text-negative" if bad else "", remove="" if bad else "text-negative")

    async def _uploaded(self, event: events.UploadEventArguments) -> None:
        self.upload.reset()
        if is_video(event.file.name):
            self._read_fields()
            await self.video.begin(event.file)
        elif event.file.size() > self.visit.limits.upload_bytes:
            self._say(
                f"{event.file.name}: too large. Give at most {self.visit.limits.upload_bytes >> 20} MB.", bad=True
            )
        else:
            await self._new(event.file.name, await event.file.read())

    def _give_sample(self) -> None:
        for name, text in GIVEN.items:
            self.fields[name].value = text

    async def _take_sample(self) -> None:
        self._give_sample()
        await self._new("street.png", self._sample)

    async def _take_video(self) -> None:
        self._give_sample()
        self._read_fields()
        made: list[bytes] = []
        await self._work(lambda: self.visit.workers({}, sample_video), made.append)
        for content in made:
            await self.video.begin(SmallFileUpload("street.mp4", "video/mp4", content))

    async def _new(self, name: str, content: bytes) -> None:
        try:
            self.visit.take(name, content)
        except FgreconError as error:
            self._say(str(error), bad=True)
            return
        self.picture.mode.value = LOOK
        self.several.set_options(list(self.visit.kept), value=self.visit.chosen or None)
        self.several.visible = len(self.visit.kept) > 1
        await self._solve()

    async def _switch(self, event: events.ValueChangeEventArguments) -> None:
        if self.visit.switch(event.value):
            self.picture.mode.value = LOOK
            await self._solve()

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
        width, height = self.visit.editor.size
        focal = width / 2 / tan(radians(self.view_angle.value) / 2)
        self.fields["intrinsics"].value = f"{focal:.1f},{focal:.1f},{(width - 1) / 2},{(height - 1) / 2}"
        await self._solve()

    def _read_fields(self) -> None:
        values: dict[str, Any] = {name: str(field.value or "").strip() for name, field in self.fields.items()}
        self.visit.requested = replace(self.visit.requested, **values)

    async def _solve(self) -> None:
        self._read_fields()
        await self._work(self.visit.solve, self._show)

    async def _work(self, work: Callable[[], Awaitable[Any]], then: Callable[..., None]) -> None:
        """Let a worker work, and say how it goes."""
        self.busy.visible = True
        self._say(
            "Working ..." if not self.visit.workers.waiting else f"{self.visit.workers.waiting} wait before you ..."
        )
        try:
            result = await work()
        except FgreconError as error:
            self._say(str(error), bad=True)
        else:
            if self.visit.left:
                return
            self._say(HINTS[self.visit.editor.mode])
            then(*([] if result is None else [result]))
        finally:
            self.busy.visible = False

    def _show(self) -> None:
        view = self.visit.view
        if view is None:
            return
        self.picture.show()
        self.table.rows = [dict(zip((*HEADINGS, "why"), car.cells, strict=True)) for car in view.cars]
        self.table.visible = True
        if view.warnings:
            self._say(" ".join(view.warnings))
        self.more.clear()
        with self.more:
            ResultTabs(self.visit, view, self.picture.draw, self._work)

    async def _edited(self) -> None:
        async def work() -> None:
            await self.visit.edited()
            await self.visit.solve()

        self._read_fields()
        await self._work(work, self._show)
