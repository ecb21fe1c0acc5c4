"""`fgrecon app` as an ASGI application, by NiceGUI. Each visitor has a `Visit`; nothing is kept of one who has gone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from fastapi import FastAPI, Request, Response
from nicegui import app as nicegui_app
from nicegui import ui
from starlette.responses import FileResponse

from fgrecon.app.guard import Guard
from fgrecon.app.label_folder import LabelFolder
from fgrecon.app.label_page import LabelPage
from fgrecon.app.limits import Limits
from fgrecon.app.page import MainPage
from fgrecon.app.requested import PageRequested
from fgrecon.app.sample import make_page_ready, sample_photograph
from fgrecon.app.visit import Made, Visit
from fgrecon.app.workers import Workers
from fgrecon.core.errors import FgreconError

_KIND = {".glb": "model/gltf-binary", ".jpg": "image/jpeg", ".png": "image/png"}
_VIDEOS = 4  # that may wait
_RECONNECT = 20.0  # seconds after which a visitor whose connection broke has gone


def page_app(
    count: int,
    limits: Limits,
    hosts: tuple[str, ...],
    ready: Callable[[], None],
    labels: LabelFolder | None = None,
    models: Path | None = None,
) -> Any:
    """The page as an ASGI application.

    Args:
        count: How many processes solve.
        limits: What it takes.
        hosts: Names under which it may be asked for; `*` is any.
        ready: Called when it answers.
        labels: A folder whose labels are righted, or None.
        models: Car models that cars are compared with, a folder or file; or None.
    """
    made: Made = {}
    workers: list[Workers] = []
    sample: list[bytes] = []
    api = FastAPI(openapi_url=None)

    async def start() -> None:
        workers.append(Workers(count, limits, limits.solve_seconds))
        workers.append(Workers(1, replace(limits, waiting=_VIDEOS), limits.video_seconds))
        await workers[0].make_ready(make_page_ready)
        sample.append(await workers[0]({}, sample_photograph))
        ready()

    async def stop() -> None:
        while workers:
            workers.pop().close()

    async def file(request: Request) -> Response:
        token, name = request.path_params["token"], request.path_params["name"]
        content = made.get(token, {}).get(name)
        if content is None:
            return Response("There is none.", 404)
        if isinstance(content, Path):
            return FileResponse(content, headers={"Cache-Control": "no-store"})
        kind = _KIND.get(Path(name).suffix, "application/octet-stream")
        return Response(content, media_type=kind, headers={"Cache-Control": "no-store"})

    def root(request: Request) -> None:
        try:
            requested, problem = PageRequested.of(request.query_params.multi_items()), None
        except FgreconError as error:
            requested, problem = PageRequested(), str(error)
        visit = Visit(workers[0], limits, made, requested, models)
        ui.context.client.on_delete(visit.leave)
        if labels is None:
            MainPage(visit, workers[1], sample[0], problem)
        else:
            LabelPage(visit, labels, workers[1], sample[0], problem)

    nicegui_app.on_startup(start)
    nicegui_app.on_shutdown(stop)
    api.add_api_route("/made/{token}/{name}", file)
    ui.page("/", title="fgrecon", dark=None)(root)
    ui.run_with(api, title="fgrecon", dark=None, show_welcome_message=False, reconnect_timeout=_RECONNECT)
    return Guard(api, limits, hosts)
