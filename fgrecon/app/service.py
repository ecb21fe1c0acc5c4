"""`fgrecon serve`: reconstruction over HTTP, for programs in any language.

POST /reconstruct (an image, or keypoints as JSON) ---- a place in the queue ---- a worker ---- results as JSON
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from typing import Any

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Route

from fgrecon.app.limits import LIMITS, Limits
from fgrecon.app.openapi import SCHEMAS, openapi, page, schema
from fgrecon.app.requested import Requested
from fgrecon.app.solving import Uploaded, make_ready, results_text
from fgrecon.app.workers import BusyError, Workers
from fgrecon.core.errors import FgreconError, InvalidInputError

_IMAGES = {"image/bmp": "bmp", "image/jpeg": "jpg", "image/png": "png", "image/tiff": "tif", "image/webp": "webp"}
KINDS: Mapping[str, str] = {"application/json": "keypoints.json"} | {k: f"image.{e}" for k, e in _IMAGES.items()}
"""What a request's body may be, and the name of the file that it becomes."""

_LISTENED = 4  # times what is taken: who still sends does not hear that it is too much
_RETRY = {"Retry-After": "2"}  # seconds


def service(
    workers: int,
    limits: Limits = LIMITS,
    hosts: tuple[str, ...] = ("*",),
    ready: Callable[[], None] = lambda: None,
) -> Any:
    """The service as an ASGI application.

    Args:
        workers: How many processes solve.
        limits: What it takes.
        hosts: Names under which it may be asked for; `*` is any.
        ready: Called when it answers.
    """

    @asynccontextmanager
    async def life(app: Starlette) -> AsyncIterator[None]:
        app.state.workers = pool = Workers(workers, limits, limits.solve_seconds)
        try:
            await pool.make_ready(make_ready)
            ready()
            yield
        finally:
            pool.close()

    routes = [
        Route("/", lambda _: HTMLResponse(page(limits))),
        Route("/health", _health),
        Route("/openapi.json", lambda _: JSONResponse(openapi(limits))),
        Route("/schemas/{name}", _schema),
        Route("/reconstruct", _reconstruct, methods=["POST"]),
    ]
    app = Starlette(
        routes=routes,
        lifespan=life,
        middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=list(hosts), www_redirect=False)],
        exception_handlers={HTTPException: _of_http, FgreconError: _of_ours, ClientDisconnect: _of_gone},
    )
    app.state.limits = limits
    return app


async def _health(request: Request) -> Response:
    workers: Workers = request.app.state.workers
    return JSONResponse({"status": "ok", "workers": workers.count, "waiting": workers.waiting})


async def _schema(request: Request) -> Response:
    name = request.path_params["name"]
    if name not in SCHEMAS:
        raise HTTPException(404, f"There is no schema of that name. Give one of {', '.join(SCHEMAS)}.")
    return Response(schema(name), media_type="application/schema+json")


async def _reconstruct(request: Request) -> Response:
    workers: Workers = request.app.state.workers
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind not in KINDS:
        raise HTTPException(415, f"The body is {kind or 'of no kind'}. Give one of {', '.join(KINDS)}.")
    if (coding := request.headers.get("content-encoding", "identity")) != "identity":
        raise HTTPException(415, f"The body is coded as {coding}. Give it as it is.")
    requested = Requested.of(request.query_params.multi_items())

    async def wanted() -> None:
        if await request.is_disconnected():
            raise ClientDisconnect

    with workers.place():
        body = await read_body(request, request.app.state.limits)
        await wanted()  # uvicorn stops to listen after a large body until somebody asks
        name = KINDS[kind]
        text = await workers({name: body}, results_text, Uploaded(name), requested, wanted=wanted)
    return Response(text, media_type="application/json")


async def read_body(request: Request, limits: Limits) -> bytes:
    """The body of a request.

    Raises:
        HTTPException: It is larger than may be (413), or does not come in time (408).
    """
    most, size = limits.upload_bytes, 0
    parts: list[bytes] = []
    try:
        async with asyncio.timeout(limits.upload_seconds):
            async for part in request.stream():
                size += len(part)
                if size > _LISTENED * most:
                    break
                if size <= most:
                    parts.append(part)
                else:
                    parts.clear()
    except TimeoutError as error:
        raise HTTPException(408, f"The body did not come within {limits.upload_seconds:g} seconds.") from error
    if size > most:
        raise HTTPException(413, f"The body is too large. Give at most {most} bytes.")
    return b"".join(parts)


def error_content(error: FgreconError) -> dict[str, Any]:
    """An error for JSON, as results files have those of single vehicles."""
    content = {"type": type(error).__name__, "message": str(error)}
    if isinstance(error, InvalidInputError):
        content |= {"field": str(error.field), "fix": str(error.fix)}
    return {"error": content}


def _of_ours(_: Request, error: Exception) -> Response:
    assert isinstance(error, FgreconError)
    if isinstance(error, BusyError):
        return JSONResponse(error_content(error), 503, headers={**_RETRY, "Connection": "close"})
    return JSONResponse(json.loads(json.dumps(error_content(error))), 422)


def _of_http(_: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    content = {"error": {"type": "HTTPException", "message": error.detail}}
    headers = dict(error.headers or {}) | ({"Connection": "close"} if error.status_code in (408, 413) else {})
    return JSONResponse(content, error.status_code, headers=headers)


def _of_gone(_: Request, error: Exception) -> Response:
    return Response(str(error), 400)  # nobody reads it
