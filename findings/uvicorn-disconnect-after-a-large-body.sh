#!/usr/bin/env bash
# uvicorn 0.54.0 with starlette 1.10.0, `Request.is_disconnected`: after a body of a few hundred kilobytes it is False
# for a client that hung up seconds ago, the first time that it is asked.
#
# Guess: a handler that has read the body, waits for its turn and then asks once hears that nobody waits any more.
# Seen: of a body of 100 bytes yes, of 1 MB no, and yes when it asks a second time. uvicorn stops to read from the socket
# when much of a body is buffered, and goes on when the application asks for the next message: the first question does.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet uvicorn==0.54.0 starlette==1.10.0 anyio==4.16.0 h11==0.16.0
env/bin/python - <<'PYTHON'
import asyncio
import socket
import threading
import time

import uvicorn
from starlette.applications import Starlette
from starlette.responses import Response
from starlette.routing import Route

seen = {}


async def handler(request):
    size = len(await request.body())
    await asyncio.sleep(1.5)  # the client hangs up meanwhile
    first = await request.is_disconnected()
    await asyncio.sleep(0.5)
    seen[size] = first, await request.is_disconnected()
    return Response("done")


app = Starlette(routes=[Route("/", handler, methods=["POST"])])
server = uvicorn.Server(uvicorn.Config(app, port=0, log_level="error", http="h11"))
threading.Thread(target=server.run, daemon=True).start()
while not server.started:
    time.sleep(0.05)
port = server.servers[0].sockets[0].getsockname()[1]
for size in (100, 1_000_000):
    with socket.create_connection(("127.0.0.1", port)) as client:
        client.sendall(f"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: {size}\r\n\r\n".encode() + b"x" * size)
        time.sleep(0.5)
    time.sleep(2.5)
print("disconnected, asked twice, by the size of the body:", seen)
assert seen == {100: (True, True), 1_000_000: (False, True)}, seen
PYTHON
