"""A visitor's session: uploads, settings and results; deleted when the visitor leaves."""

from __future__ import annotations

import json
import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fgrecon.app.limits import Limits
from fgrecon.app.picture_editor import BOXES, Editor
from fgrecon.app.requested import PageRequested, Requested
from fgrecon.app.solving import Uploaded, without_folder
from fgrecon.app.upload_kinds import Kind, kind_of, safe_name
from fgrecon.app.view import PageView, instance_of, view_of
from fgrecon.app.workers import Workers
from fgrecon.batch.vehicle_tasks import KeypointRequest, image_tasks
from fgrecon.core.errors import FgreconError
from fgrecon.io.cameras.camera_source import CameraSource
from fgrecon.io.catalogue import load_prior
from fgrecon.io.images import read_image
from fgrecon.perception.boxes import GivenBoxes


def instances_in_boxes(
    folder: Path, photograph: str, boxes: Sequence[Sequence[float]], requested: Requested
) -> list[dict[str, Any]]:
    """A vehicle in each box x1, y1, x2, y2 of a photograph, as a keypoint file has it."""
    path = folder / photograph
    with without_folder(folder):
        how = KeypointRequest(load_prior(requested.prior or "car14").category)
        pixels = read_image(path)
        tasks = image_tasks(path, CameraSource(image=pixels), GivenBoxes(boxes).of_image(path, pixels).cars, how)
        return [instance_of(task.instance) for task in tasks]


Made = dict[str, dict[str, bytes | Path]]
"""What was made for each visitor, by a secret and a name: content, or where a file is."""

_KEPT = 6  # uploads of a visitor
_EDITED = "keypoints.json"


@dataclass(frozen=True)
class Upload:
    """Files that belong together, and which is which."""

    names: Uploaded
    files: Mapping[str, bytes | Path]

    @classmethod
    def of(cls, names: Uploaded, files: Mapping[str, bytes | Path]) -> Upload:
        """The files of these names, among others."""
        wanted = (names.main, names.camera, names.boxes, names.photograph)
        return cls(names, {one: files[one] for one in wanted if one})

    def with_file(self, kind: Kind, name: str, content: bytes | Path) -> Upload:
        """Another file comes: a photograph or keypoints begin anew, but for what is about them."""
        before = self.names
        if kind is Kind.CAMERA:
            names = replace(before, camera=name)
        elif kind is Kind.BOXES:
            names = replace(Uploaded(self.photograph or "", camera=before.camera), boxes=name)
        elif kind is Kind.KEYPOINTS:
            drawn_on = self.photograph if self.photograph and _may_be_of(content, self.photograph) else None
            names = Uploaded(name, camera=before.camera, photograph=drawn_on)
        elif before.main and not before.of_image and name.encode() in _text(self.files[before.main]):
            names = replace(before, photograph=name)
        else:
            names = Uploaded(name, camera=before.camera, boxes=None if before.main else before.boxes)
        return Upload.of(names, {**self.files, name: content})

    @property
    def photograph(self) -> str | None:
        """The photograph's name; None where there is none."""
        return self.names.main if self.names.of_image else self.names.photograph


def _text(file: bytes | Path) -> bytes:
    return file if isinstance(file, bytes) else file.read_bytes()


def _may_be_of(keypoints: bytes | Path, photograph: str) -> bool:
    """Whether keypoints name this photograph, or none."""
    text = _text(keypoints)
    return photograph.encode() in text or not (b'"image"' in text or b'"file_name"' in text)


class Visit:
    """One visitor's upload, what is requested of it, and what is shown."""

    def __init__(
        self, workers: Workers, limits: Limits, made: Made, requested: PageRequested, models: Path | None = None
    ) -> None:
        """Begin with what a link requests; car models are a folder or file."""
        self._models = models
        self.workers, self.limits, self.requested = workers, limits, requested
        self.token, self._made = secrets.token_urlsafe(16), made
        made[self.token] = {}
        self.kept: dict[str, Upload] = {}
        self.upload = Upload(Uploaded(""), {})
        self.view: PageView | None = None
        self.editor = Editor()
        self.by_hand: set[str] = set()
        self.step: int | None = None
        self.car = 0
        self.left = False
        self._asked = 0

    def leave(self) -> None:
        """Forget everything."""
        self._made.pop(self.token, None)
        self.kept, self.upload, self.view, self.left = {}, Upload(Uploaded(""), {}), None, True

    @property
    def chosen(self) -> str:
        """Name of what is shown."""
        return self.upload.names.main

    def take(self, name: str, content: bytes) -> None:
        """A file comes, see `Upload.with_file`.

        Raises:
            FgreconError: It is too large, or nothing that is known.
        """
        if len(content) > self.limits.upload_bytes:
            raise FgreconError(f"{name}: too large. Give at most {self.limits.upload_bytes >> 20} MB.")
        safe = safe_name(name)
        kind = kind_of(safe, content)
        self.upload = self.upload.with_file(kind, safe, content)
        if kind is not Kind.CAMERA:
            self.requested = replace(self.requested, box=())
            self.by_hand = set()
        if self.chosen:
            self.kept.pop(self.chosen, None)
            self.kept = dict([*self.kept.items()][1 - _KEPT :]) | {self.chosen: self.upload}

    def switch(self, name: str) -> bool:
        """Show another upload; whether there is one of that name that was not shown."""
        if name not in self.kept or name == self.chosen:
            return False
        self.begin(self.kept[name])
        return True

    def begin(self, upload: Upload) -> None:
        """Take an upload as it is."""
        self.upload, self.by_hand, self.view = upload, set(), None
        self.requested = replace(self.requested, box=())

    async def solve(self) -> None:
        """Let a worker solve what there is.

        Raises:
            FgreconError: It cannot be used, or too many wait.
        """
        if not self.chosen:
            return
        self._asked = asked = self._asked + 1
        with self.workers.place():
            view = await self.workers(self.upload.files, view_of, self.upload.names, self.requested, self._models)
        if asked != self._asked or self.left:  # something newer was requested meanwhile
            return
        self.view, self.step = view, None
        if not self.upload.names.of_image and self.chosen != _EDITED:
            self.by_hand = {car.name for car in view.cars}  # given keypoints
        self.editor = Editor.of(view, self.editor.mode)
        self.car = min(self.car, len(view.cars) - 1)
        self.show({**view.files, "photograph.jpg": view.photograph})

    async def edited(self) -> None:
        """Take the boxes or keypoints as they are now for what is to be solved.

        Boxes that were drawn or changed get keypoints from the networks, but for those of cars whose keypoints were
        righted by hand.

        Raises:
            FgreconError: A box was drawn and there is no photograph, no box is left, or a box cannot be used.
        """
        assert self.view is not None
        editor, photograph = self.editor, self.upload.photograph
        self.by_hand |= {name for name, _ in editor.righted}
        if not any(editor.boxes) and not any(editor.points):
            raise FgreconError("No car is left: draw a box.")
        if editor.mode == BOXES and photograph is None and editor.anew(self.by_hand):
            raise FgreconError("Keypoints in a box need the photograph: drop it as well.")
        if photograph is not None and not self.by_hand:
            boxes = tuple(",".join(f"{x:.1f}" for x in box) for box in editor.boxes if box)
            names, files = Uploaded(photograph, camera=self.upload.names.camera), self.upload.files
        else:
            found = await self._detected(photograph) if editor.mode == BOXES else {}
            text = json.dumps(editor.keypoint_file(self.view, found), allow_nan=False).encode()
            names, boxes = Uploaded(_EDITED, camera=self.upload.names.camera, photograph=photograph), ()
            files = {**self.upload.files, _EDITED: text}
        self.requested = replace(self.requested, box=boxes)
        self.upload = Upload.of(names, files)

    async def _detected(self, photograph: str | None) -> dict[int, dict[str, object]]:
        """Instances by the networks for the boxes that were drawn or changed, by their number."""
        anew = self.editor.anew(self.by_hand)
        if not anew:
            return {}
        assert photograph is not None
        boxes = [self.editor.boxes[number] for number in anew]
        files = {photograph: self.upload.files[photograph]}
        with self.workers.place():
            found = await self.workers(files, instances_in_boxes, photograph, boxes, self.requested)
        return dict(zip(anew, found, strict=True))

    async def made(self, work: Callable[..., bytes]) -> bytes:
        """What a worker makes of the upload: a picture or a recording."""
        with self.workers.place():
            return await self.workers(self.upload.files, work, self.upload.names, self.requested)

    def show(self, files: Mapping[str, bytes | Path]) -> None:
        """Let this visitor find files under `url`."""
        self._made.setdefault(self.token, {}).update(files) if not self.left else None

    def url(self, name: str) -> str:
        """Where this visitor alone finds something that was made."""
        return f"/made/{self.token}/{name}?{self._asked}"
