"""Limits of what a page may be sent: size and time of uploads, and from whom."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any
from urllib.parse import urlsplit

from fgrecon.app.limits import Limits

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]


class Guard:
    """An ASGI application behind limits: pages of other hosts reach nothing, and no upload is too large or too slow."""

    def __init__(self, app: Any, limits: Limits, hosts: tuple[str, ...]) -> None:
        """Put it before an application.

        Args:
            app: The application.
            limits: Of uploads.
            hosts: Names under which it may be asked for; `*` is any.
        """
        self._app, self._limits, self._hosts = app, limits, hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        if (refusal := self._refusal(scope, headers)) is not None:
            await _refuse(scope, send, *refusal)
        else:
            await self._app(scope, _in_time(receive, self._limits.upload_seconds) if _sends(scope) else receive, send)

    def _refusal(self, scope: Scope, headers: MutableMapping[str, str]) -> tuple[int, str] | None:
        """Status and reason with which it is refused; None where it is not."""
        host, origin = headers.get("host", ""), headers.get("origin")
        if "*" not in self._hosts and (urlsplit(f"//{host}").hostname or "") not in self._hosts:
            return 400, "Ask for it by the address that it said when it started."
        if origin is not None and urlsplit(origin).netloc != host:
            return 403, "Pages of other hosts are not served."
        if _sends(scope):
            length = headers.get("content-length", "")
            if not length.isdecimal():
                return 411, "Say how long it is."
            if int(length) > self._limits.video_bytes:
                return 413, f"Give at most {self._limits.video_bytes} bytes."
        return None


def _sends(scope: Scope) -> bool:
    return scope["type"] == "http" and scope["method"] in ("POST", "PUT")


def _in_time(receive: Receive, seconds: float) -> Receive:
    """Like a connection that is cut when its body has not come in time."""
    end = asyncio.get_running_loop().time() + seconds
    whole = False

    async def limited() -> MutableMapping[str, Any]:
        nonlocal whole
        if whole:  # what comes now is that the other end has gone
            return await receive()
        try:
            async with asyncio.timeout_at(end):
                message = await receive()
        except TimeoutError:
            return {"type": "http.disconnect"}
        whole = not message.get("more_body", False)
        return message

    return limited


async def _refuse(scope: Scope, send: Send, status: int, words: str) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": words})
        return
    body = words.encode()
    headers = [(b"content-type", b"text/plain"), (b"content-length", b"%d" % len(body)), (b"connection", b"close")]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
