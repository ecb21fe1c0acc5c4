"""`fgrecon serve` over HTTP: results as the command line has them, refusals in the readers' words, and limits."""

import http.client
import json
import socket
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from jsonschema import Draft202012Validator
from typer.testing import CliRunner

from fgrecon.app.openapi import SCHEMAS, schema
from fgrecon.cli import main
from tests.conftest import REPOSITORY

ATTACKS = sorted(path for path in (REPOSITORY / "tests/corpus").rglob("*") if path.is_file())
KITTI = "?size_prior=kitti&camera_height=1.65"


def by_command(tmp_path, file, *arguments):
    out = tmp_path / "out.json"
    given = ["--size-prior", "kitti", "--camera-height", "1.65", "--json", str(out)]
    done = CliRunner().invoke(main.app, ["reconstruct", str(file), *arguments, *given])
    assert done.exit_code == 0, done.output
    return json.loads(out.read_text(encoding="utf-8"))


def without_times(document):
    for entry in document["instances"]:
        entry.pop("image", None)
        if entry["result"]:
            entry["result"].pop("milliseconds")
    return {name: document[name] for name in ("settings", "instances")}


def test_keypoints_give_what_the_command_gives(client, sample, tmp_path):
    status, answer = client.post((sample / "cars.json").read_bytes(), query=KITTI)
    assert status == 200
    Draft202012Validator(json.loads(schema("results.schema.json"))).validate(answer)
    assert without_times(answer) == without_times(by_command(tmp_path, sample / "cars.json"))


def test_a_photograph_gives_cars_and_says_that_its_camera_is_assumed(client, sample):
    body = (sample / "street.png").read_bytes()
    status, answer = client.post(body, "image/png", "?size_prior=kitti")
    assert status == 200
    Draft202012Validator(json.loads(schema("results.schema.json"))).validate(answer)
    assert len(answer["instances"]) >= 2
    assert any("No camera is given" in line for line in answer["warnings"])


def test_a_given_box_is_used(client, sample):
    camera = "&intrinsics=721.5,721.5,609.6,172.9"
    box = json.loads((sample / "cars.json").read_text())["instances"][0]["box"]
    query = f"{KITTI}{camera}&box={','.join(map(str, box))}&history=yes"
    status, answer = client.post((sample / "street.png").read_bytes(), "image/png", query)
    assert status == 200
    (car,) = answer["instances"]
    assert car["box"] == pytest.approx(box)
    assert car["result"]["history"]


def test_health_and_what_it_says_of_itself(client):
    assert json.loads(client.get("/health")[2]) == {"status": "ok", "workers": 1, "waiting": 0}
    description = json.loads(client.get("/openapi.json")[2])
    assert description["openapi"].startswith("3.1")
    for name in SCHEMAS:
        assert json.loads(client.get(f"/schemas/{name}")[2]) == json.loads(schema(name))
    page = client.get("/")[2].decode()
    for parameter in description["paths"]["/reconstruct"]["post"]["parameters"]:
        assert parameter["name"] in page
    assert "http://" not in page.replace("http://HOST", "")
    assert "https://" not in page


def test_the_schemas_of_the_package_are_those_of_the_documentation():
    for name in SCHEMAS:
        assert (REPOSITORY / "docs/schemas" / name).read_text(encoding="utf-8") == schema(name)


@pytest.mark.parametrize(
    "path", ["/schemas/..%2f..%2fweights", "/schemas/track.schema.json/..", "/etc/passwd", "//etc/passwd", "/%2e%2e/x"]
)
def test_no_path_of_the_server_is_readable(client, path):
    assert client.get(path)[0] == 404


def test_another_hosts_name_is_refused(client):
    assert client.get("/health", Host="evil.example")[0] == 400


@pytest.mark.parametrize(
    ("body", "kind", "query", "status", "words"),
    [
        (b"{}", "text/plain", "", 415, "Give one of application/json"),
        (b"{", "application/json", "", 422, "keypoints.json"),
        (b"[" * 100_000, "application/json", "", 422, "keypoints.json"),
        (b"\xff\xfe", "application/json", "", 422, "keypoints.json"),
        (b'{"instances": []}', "application/json", "", 422, "instances"),
        (b"no image", "image/png", "", 422, "Give an image"),
        (b"", "image/jpeg", "", 422, "Give an image"),
        (b"{}", "application/json", "?prior=/etc/passwd", 422, "Give one of"),
        (b"{}", "application/json", "?size_prior=/etc/passwd", 422, "size_prior"),
        (b"x" * (5 << 20), "image/png", "", 413, "too large"),
    ],
)
def test_what_cannot_be_used_is_refused_in_words(client, body, kind, query, status, words):
    got, answer = client.post(body, kind, query)
    assert got == status
    assert words in answer["error"]["message"]
    assert "Traceback" not in json.dumps(answer)
    assert tempfile.gettempdir() not in json.dumps(answer)


def test_an_image_that_claims_too_many_pixels(client):
    status, answer = client.post(b"P6 60000 60000 255\n", "image/png")
    assert status == 422
    assert "pixels" in answer["error"]["message"]


@pytest.mark.parametrize(
    "path", sorted(p for p in (REPOSITORY / "tests/corpus").rglob("*") if p.is_file()), ids=lambda p: p.name
)
def test_the_kept_attacks_of_the_readers(client, path):
    """Whatever they are, as each kind of body: an answer in words."""
    for kind in ("application/json", "image/png"):
        status, answer = client.post(path.read_bytes(), kind)
        assert 400 <= status < 500
        assert set(answer["error"]) >= {"type", "message"}
        assert tempfile.gettempdir() not in json.dumps(answer)


def test_a_slow_upload_is_given_up(client):
    host, port = client.place.split(":")
    with socket.create_connection((host, int(port)), timeout=30) as slow:
        slow.sendall(
            b"POST /reconstruct HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: image/png\r\n"
            b"Content-Length: 1000\r\n\r\nab"
        )
        answer = slow.recv(4096)
    assert b" 408 " in answer.split(b"\r\n")[0]


def test_a_cut_connection_does_no_harm_and_leaves_its_place(client, sample):
    host, port = client.place.split(":")
    for _ in range(3):
        with socket.create_connection((host, int(port)), timeout=30) as cut:
            cut.sendall(
                b"POST /reconstruct HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: image/png\r\n"
                b"Content-Length: 1000\r\n\r\nabc"
            )
    body = (sample / "cars.json").read_bytes()
    for _ in range(100):
        if client.post(body)[0] == 200:
            break
        time.sleep(0.1)
    else:
        pytest.fail("its place stays taken")


def test_a_length_that_is_a_lie_is_counted(client):
    host, port = client.place.split(":")
    connection = http.client.HTTPConnection(host, int(port), timeout=30)
    parts = (b"x" * (1 << 20) for _ in range(6))
    try:
        connection.request("POST", "/reconstruct", parts, {"Content-Type": "image/png"}, encode_chunked=True)
        assert connection.getresponse().status == 413
    except (BrokenPipeError, ConnectionResetError):  # it did not even listen to the end
        pass
    finally:
        connection.close()


def test_a_coded_body_is_refused(client, sample):
    headers = {"Content-Type": "application/json", "Content-Encoding": "gzip"}
    status, _, content = client.raw("POST", "/reconstruct", b"\x1f\x8b", headers)
    assert status == 415
    assert "coded as gzip" in json.loads(content)["error"]["message"]


def test_no_worker_works_for_those_who_are_gone(serve, sample):
    """Each would take seconds: who comes after them would wait for all."""
    client = serve(waiting=8)
    cars = json.loads((sample / "cars.json").read_text())
    cars["instances"] = [car | {"id": str(n)} for n in range(700) for car in cars["instances"][:1]]
    body = json.dumps(cars).encode()
    host, port = client.place.split(":")
    started = time.monotonic()
    assert client.post(body)[0] == 200
    one = time.monotonic() - started
    kind = "Content-Type: application/json"
    head = f"POST /reconstruct HTTP/1.1\r\nHost: 127.0.0.1\r\n{kind}\r\nContent-Length: {len(body)}"
    for _ in range(8):
        with socket.create_connection((host, int(port)), timeout=30) as gone:
            gone.sendall(head.encode() + b"\r\n\r\n" + body)
    started = time.monotonic()
    assert client.post((sample / "cars.json").read_bytes())[0] == 200
    assert time.monotonic() - started < 4.0 * one


def test_more_than_may_wait_are_refused_and_none_is_lost(client, sample):
    body, answers = (sample / "street.png").read_bytes(), []
    ask = lambda: answers.append(client.post(body, "image/png", KITTI)[0])  # noqa: E731
    threads = [threading.Thread(target=ask) for _ in range(10)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(120)
    assert len(answers) == 10
    assert set(answers) == {200, 503}
    assert client.post((sample / "cars.json").read_bytes())[0] == 200


def test_nothing_is_left_behind(client, sample):
    before = set(Path(tempfile.gettempdir()).glob("fgrecon-*"))
    client.post((sample / "cars.json").read_bytes())
    client.post(b"{", "application/json")
    assert set(Path(tempfile.gettempdir()).glob("fgrecon-*")) <= before


def test_work_that_takes_too_long_is_given_up_and_the_next_goes_on(serve, sample):
    client = serve(solve_seconds=20.0)
    cars = json.loads((sample / "cars.json").read_text())
    cars["instances"] = [car | {"id": str(n)} for n in range(4000) for car in cars["instances"][:1]]
    started = time.monotonic()
    status, answer = client.post(json.dumps(cars).encode())
    if status == 200:
        pytest.skip("this machine does it in time")
    assert (status, time.monotonic() - started < 60) == (422, True)
    assert "after 20 seconds. Give fewer vehicles" in answer["error"]["message"]
    # A busy machine may need more than the limit to start the next worker: then the one after that has it.
    assert any(client.post((sample / "cars.json").read_bytes())[0] == 200 for _ in range(3))


def test_without_the_extra_the_command_says_what_to_install(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "starlette.applications", None)
    monkeypatch.delitem(sys.modules, "fgrecon.app.service", raising=False)
    done = CliRunner().invoke(main.app, ["serve"])
    assert "pip install 'fgrecon[serve]'" in str(done.exception)


def test_a_port_that_is_taken_is_named():
    from fgrecon.app.serving import Server
    from fgrecon.core.errors import InvalidInputError

    pytest.importorskip("uvicorn")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(InvalidInputError, match=f"port {port}"):
            Server(port=port).run(lambda _: None, np.array)
