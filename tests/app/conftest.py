"""A running service, for the tests of this folder."""

import http.client
import json
import threading
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from fgrecon.app.limits import LIMITS


class Client:
    """Asks a server on this machine, each time by a connection of its own."""

    def __init__(self, address):
        self.place = address.removeprefix("http://")

    def raw(self, method, path, body=None, headers=None):
        connection = http.client.HTTPConnection(self.place, timeout=120)
        try:
            connection.request(method, path, body, headers or {})
            answer = connection.getresponse()
            return answer.status, answer.headers, answer.read()
        finally:
            connection.close()

    def get(self, path, **headers):
        return self.raw("GET", path, headers=headers)

    def post(self, body, kind="application/json", query=""):
        status, _, content = self.raw("POST", f"/reconstruct{query}", body, {"Content-Type": kind})
        return status, json.loads(content)


@pytest.fixture(scope="session")
def sample(tmp_path_factory) -> Path:
    from fgrecon.cli import main

    folder = tmp_path_factory.mktemp("app") / "sample"
    assert CliRunner().invoke(main.app, ["sample", "--out", str(folder)]).exit_code == 0
    return folder


@pytest.fixture(scope="session")
def serve():
    """Starts a server in a thread: `serve(limits, ready)`; all are stopped at the end."""
    uvicorn = pytest.importorskip("uvicorn", reason="the extra serve is not installed")
    pytest.importorskip("starlette", reason="the extra serve is not installed")
    import time

    from fgrecon.app.service import service

    running = []

    def start(**limits):
        config = uvicorn.Config(service(1, replace(LIMITS, **limits), ("127.0.0.1",)), port=0, log_level="warning")
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, daemon=True)
        thread.start()
        running.append((server, thread))
        while not server.started:
            assert thread.is_alive()
            time.sleep(0.05)
        return Client(f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}")

    yield start
    for server, thread in running:
        server.should_exit = True
        thread.join(30)


@pytest.fixture(scope="session")
def client(serve):
    return serve(upload_seconds=2.0, waiting=1, upload_bytes=4 << 20)
