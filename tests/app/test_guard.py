"""What stands before the page: names, origins, sizes and times."""

import asyncio

import pytest

from fgrecon.app.guard import Guard
from fgrecon.app.limits import Limits

LIMITS = Limits(video_bytes=100, upload_seconds=0.2)


def ask(method="GET", kind="http", messages=(), **headers):
    """What comes back, and what the application received."""
    sent, received, waiting = [], [], list(messages)

    async def application(scope, receive, send):
        while (message := await receive())["type"] == "http.request":
            received.append(message)
            if not message.get("more_body"):
                break
        else:
            received.append(message)
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def receive():
        if not waiting:
            await asyncio.sleep(30)
        return waiting.pop(0)

    async def send(message):
        sent.append(message)

    names = [(name.replace("_", "-").encode(), value.encode()) for name, value in headers.items()]
    scope = {"type": kind, "method": method, "headers": names}
    asyncio.run(Guard(application, LIMITS, ("127.0.0.1", "localhost"))(scope, receive, send))
    return sent[0], received


WHOLE = ({"type": "http.request", "body": b"x", "more_body": False},)


def test_our_own_pages_are_served():
    answer, _ = ask(messages=WHOLE, host="127.0.0.1:8080", origin="http://127.0.0.1:8080")
    assert answer["status"] == 200


@pytest.mark.parametrize(
    ("status", "headers"),
    [
        (400, {"host": "evil.example"}),
        (400, {}),
        (403, {"host": "localhost:1", "origin": "http://evil.example"}),
        (403, {"host": "localhost:1", "origin": "null"}),
    ],
)
def test_pages_of_others_are_not(status, headers):
    assert ask(messages=WHOLE, **headers)[0]["status"] == status


def test_nor_do_their_sockets_open():
    answer, _ = ask(kind="websocket", host="localhost", origin="http://evil.example")
    assert answer == {"type": "websocket.close", "code": 1008, "reason": "Pages of other hosts are not served."}


@pytest.mark.parametrize(("status", "length"), [(411, ""), (411, "many"), (413, "101"), (200, "1")])
def test_uploads_say_how_long_they_are(status, length):
    headers = {"host": "localhost", **({"content_length": length} if length else {})}
    assert ask("POST", messages=WHOLE, **headers)[0]["status"] == status


def test_a_slow_upload_is_as_if_it_were_cut():
    part = {"type": "http.request", "body": b"x", "more_body": True}
    _, received = ask("POST", messages=(part,), host="localhost", content_length="50")
    assert [message["type"] for message in received] == ["http.request", "http.disconnect"]
