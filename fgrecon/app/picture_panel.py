"""The photograph on the page with its overlays, and the mouse and keys that edit it."""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable

from nicegui import events, ui

from fgrecon.app.picture_editor import BOXES, KEYPOINTS, LOOK, drawing
from fgrecon.app.visit import Visit

HINTS = {
    LOOK: "Drop a photograph, a video, keypoints, boxes or a calibration anywhere, or paste one.",
    BOXES: "Drag in the picture: a new box, a corner, or a box. Keys: n and p choose, arrows move, Delete removes.",
    KEYPOINTS: "Drag a keypoint. Keys: n and p choose, arrows move (Shift: ten pixels), Delete takes it away.",
}
"""What can be done in each mode."""

_KEYS = ["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "n", "p", "Delete", "Backspace"]


class PicturePanel:
    """The elements, and what mouse and keys do."""

    def __init__(self, visit: Visit, say: Callable[[str], None], edited: Callable[[], Awaitable[None]]) -> None:
        """Make them.

        Args:
            visit: Whose photograph it is.
            say: Tells the visitor something.
            edited: Called when boxes or keypoints were edited.
        """
        self._visit, self._say, self._then = visit, say, edited
        modes = {LOOK: "Look", BOXES: "Boxes", KEYPOINTS: "Keypoints"}
        self.mode = ui.toggle(modes, value=LOOK, on_change=self._set_mode)
        pointer = ["pointerdown", "pointermove", "pointerup"]
        self._picture = ui.interactive_image(size=(1242, 375), on_mouse=self._mouse, events=pointer, sanitize=False)
        self._picture.classes("w-full fg-picture bg-grey-8").props("tabindex=0 role=application aria-label=Photograph")
        script = f"(e) => {{ if ({json.dumps(_KEYS)}.includes(e.key)) {{ e.preventDefault(); emit(e) }} }}"
        self._picture.on("keydown", self._key, args=["key", "shiftKey"], js_handler=script)

    def show(self) -> None:
        """Show what the visit has."""
        if self._visit.view is not None and self._visit.view.photograph:
            self._picture.set_source(self._visit.url("photograph.jpg"))
        self.draw()

    def draw(self) -> None:
        """Draw on the photograph."""
        visit = self._visit
        if visit.view is not None:
            self._picture.content = drawing(visit.view, visit.editor, visit.step, visit.car)

    def _set_mode(self, event: events.ValueChangeEventArguments) -> None:
        editor = self._visit.editor
        editor.mode, editor.chosen = event.value, None
        look = event.value == LOOK
        self._picture.classes(add="" if look else "fg-edit", remove="fg-edit" if look else "")
        self._say(HINTS[event.value])
        self.draw()

    async def _mouse(self, event: events.MouseEventArguments) -> None:
        editor = self._visit.editor
        if self._visit.view is None or editor.mode == LOOK:
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
        self.draw()

    async def _key(self, event: events.GenericEventArguments) -> None:
        editor = self._visit.editor
        changed = self._visit.view is not None and editor.key(event.args["key"], far=event.args["shiftKey"])
        self.draw()
        if changed:
            await self._edited()

    async def _edited(self) -> None:
        self.draw()
        editor = self._visit.editor
        chosen = None if editor.chosen is None else (editor.names[editor.chosen[0]], editor.chosen[1])
        await self._then()
        editor = self._visit.editor
        if chosen is not None and chosen[0] in editor.names:
            editor.chosen = editor.names.index(chosen[0]), chosen[1]
        self.draw()
