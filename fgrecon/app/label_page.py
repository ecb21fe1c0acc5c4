"""The page that corrects the labels of a folder, image by image, those that the graph disagrees with first."""

from __future__ import annotations

from nicegui import background_tasks, events, ui

from fgrecon.app.label_folder import LabelFolder
from fgrecon.app.labelling import labels_of
from fgrecon.app.page import MainPage
from fgrecon.app.picture_editor import KEYPOINTS
from fgrecon.app.visit import Visit
from fgrecon.app.workers import Workers
from fgrecon.core.errors import FgreconError
from fgrecon.core.text import counted
from fgrecon.io.coco_keypoints import VehicleLabel

_REFRESH = 1.0  # seconds


class LabelPage(MainPage):
    """The page of `fgrecon.app.page` with the images of a folder in the place of uploads."""

    def __init__(
        self, visit: Visit, folder: LabelFolder, video_workers: Workers, sample: bytes, problem: str | None
    ) -> None:
        """Make it, and let workers look at the images that were not looked at yet."""
        self._folder = folder
        self._shown = ""
        super().__init__(visit, video_workers, sample, problem)
        if not folder.judged:
            self._judge()
        ui.timer(_REFRESH, self._refresh)

    def _judge(self) -> None:
        self._read_fields()
        background_tasks.create(self._folder.judge_all(self.visit.workers, self.visit.requested))

    def _make_inputs(self) -> None:
        ui.label(f"Labels of {self._folder.folder.resolve().name}").classes("text-h6")
        self._progress = ui.label().props("role=status")
        self._image = ui.select({}, label="Image", on_change=self._choose).classes("w-full")
        with ui.row():
            ui.button("Save, next", icon="check", on_click=self._save)
            ui.button("Judge all again", icon="refresh", on_click=self._judge).props("outline")
        self._car = ui.select({}, label="Add to car").classes("w-full").props("dense")
        self._hidden = ui.select({}, label="Keypoint that is hidden", on_change=self._place).classes("w-full")
        self._hidden.props("dense")
        self._car.on_value_change(self._offer)
        self._refresh()

    def _refresh(self) -> None:
        """The images in order, and how far the graph has come with them."""
        folder = self._folder
        labels = {}
        for name in folder.order:
            judged = folder.judged.get(name)
            words = "righted" if name in folder.righted else judged.words if judged is not None else "not looked at"
            labels[name] = f"{name}: {words}"
        if labels != self._image.options:
            self._image.set_options(labels, value=self._shown or None)
        images = counted(len(folder.images), "image")
        self._progress.text = f"{images}, {len(folder.judged)} looked at, {len(folder.righted)} righted."

    async def _choose(self, event: events.ValueChangeEventArguments) -> None:
        if event.value and event.value != self._shown:
            await self._open(event.value)

    async def _open(self, name: str) -> None:
        self._shown = name
        self._image.value = name
        self.visit.begin(self._folder.upload(name))
        self.picture.mode.value = KEYPOINTS
        await self._solve()

    def _show(self) -> None:
        super()._show()
        editor = self.visit.editor
        self._car.set_options(dict(enumerate(editor.names)), value=0 if editor.names else None)
        self._offer()

    def _offer(self) -> None:
        """The keypoints of the chosen car that are not measured."""
        editor, number = self.visit.editor, self._car.value
        hidden = {} if number is None or number >= len(editor.names) else editor.hidden(number)
        self._hidden.set_options(hidden, value=None)

    async def _place(self, event: events.ValueChangeEventArguments) -> None:
        if event.value is not None:
            self.visit.editor.place(self._car.value, event.value)
            self.picture.mode.value = KEYPOINTS
            await self._edited()

    async def _save(self) -> None:
        if not self._shown or self.visit.view is None:
            return

        async def work() -> tuple[list[VehicleLabel], list[str]]:
            if not self.visit.editor.names:  # no car is left
                return [], []
            with self.visit.workers.place():
                upload = self.visit.upload
                return await self.visit.workers(upload.files, labels_of, upload.names, self.visit.requested)

        saved: list[str] = []

        def keep(found: tuple[list[VehicleLabel], list[str]]) -> None:
            labels, without = found
            saved.append(f"Saved {counted(len(labels), 'car')} in {self._folder.save(self._shown, labels).name}.")
            if without:
                saved.append(f"Without a pose, and therefore not saved: {', '.join(without)}.")

        try:
            await self._work(work, keep)
        except FgreconError as error:
            self._say(str(error), bad=True)
        if saved:
            self._refresh()
            following = next((name for name in self._folder.order if name not in self._folder.righted), None)
            if following is not None:
                await self._open(following)
            self._say(" ".join(saved))
