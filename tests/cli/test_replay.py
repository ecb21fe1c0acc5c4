"""`fgrecon replay`, and where recordings can be sent."""

import json
import socket
import urllib.request
from urllib.parse import quote

import numpy as np
import pytest

from fgrecon.cli import replay as command
from fgrecon.viz import SolvedVehicle, recording_of, replay, scene_recording_of
from fgrecon.viz.sinks import LOOPBACK, check_viewer, free_port, viewer_command
from fgrecon.viz.subjects import RecordedFrame
from fgrecon.viz.video_recording import video_recording_of
from tests.cli.conftest import INTRINSICS
from tests.command_line import run
from tests.viz.made_up import STAGES, make_example
from tests.viz.viewers import listening, wait_for


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    car = make_example()
    path = tmp_path_factory.mktemp("replay") / "car.rrd"
    return recording_of(SolvedVehicle(car.reconstruction, car.observation, car.camera)).write(path)


def test_summary_prints_stages_iterations_and_energies(recording):
    done = run("replay", recording, "--summary")
    assert done.exit_code == 0, done.output
    lines = done.stdout.splitlines()
    for stage, (updates, steps) in STAGES.items():
        (row,) = (line.split() for line in lines if line.startswith(stage))
        assert row[1:3] == [str(updates), str(updates * steps)]
    assert "reprojection" in done.stdout
    assert lines[-1].startswith("INFO: converged: ")


def test_summary_as_json_has_the_numbers(recording):
    done = run("replay", recording, "--summary", "--json", "-")
    content = json.loads(done.stdout)
    expected = replay.read(recording).summary()
    assert [stage["stage"] for stage in content["stages"]] == list(STAGES)
    assert [stage["last_energy"] for stage in content["stages"]] == [stage.last_energy for stage in expected]
    assert content["stages"][-1]["terms"] == dict(expected[-1].terms)
    assert content["frames"] == {"0": sum(updates * steps for updates, steps in STAGES.values())}
    assert content["log"][-1]["level"] == "INFO"


@pytest.mark.parametrize("flag", [(), ("--web",), ("--summary",)])
def test_what_is_no_recording_is_refused(tmp_path, flag, monkeypatch):
    monkeypatch.setattr(command, "_become", pytest.fail)
    (tmp_path / "x.rrd").write_text("nothing")
    done = run("replay", tmp_path / "x.rrd", *flag)
    assert done.exit_code != 0
    assert "recording" in str(done.exception)


@pytest.mark.parametrize("flags", [(), ("--web",), ("--bind", "127.0.0.2")])
def test_the_viewer_listens_on_this_machine_alone_unless_asked(recording, monkeypatch, flags):
    monkeypatch.setenv("DISPLAY", ":0")
    commands = []
    monkeypatch.setattr(command, "_become", commands.append)
    done = run("replay", recording, *flags)
    assert done.exit_code == 0, done.output
    ((*_, last),) = commands
    assert last == str(recording)
    bind = flags[1] if "--bind" in flags else LOOPBACK
    assert commands[0][commands[0].index("--bind") + 1] == bind
    assert ("--serve-web" in commands[0]) == ("--web" in flags)


def test_without_a_display_it_says_what_to_do(recording, monkeypatch):
    monkeypatch.setattr("sys.platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(command, "_become", pytest.fail)
    refused = run("replay", recording).exception
    assert refused.field == "display"
    assert "--web" in refused.fix
    assert "--summary" in refused.fix


@pytest.mark.parametrize(
    ("bind", "host"), [("::1", "[::1]"), ("127.0.0.1", "127.0.0.1"), ("0.0.0.0", "10.1.2.3"), ("::", "10.1.2.3")]
)
def test_the_address_is_one_that_a_browser_can_open(recording, monkeypatch, bind, host):
    class Probe(socket.socket):
        def connect(self, _):
            pass

        def getsockname(self):
            return ("10.1.2.3", 5)

    commands = []
    monkeypatch.setattr(command, "_become", commands.append)
    monkeypatch.setattr("fgrecon.viz.sinks.socket.socket", Probe)
    shown = run("replay", recording, "--web", "--bind", bind, "--port", 7001, "--data-port", 7002).stdout
    assert f"http://{host}:7001?url=rerun%2Bhttp%3A%2F%2F{quote(host)}%3A7002%2Fproxy " in shown
    assert commands[0][commands[0].index("--port") + 1] == "7002"


def test_a_page_of_another_name_gets_the_data_and_others_do_not(recording, monkeypatch, start):
    """Browsers ask before they read from another port; the viewer's server allows this machine's pages alone."""
    commands = []
    monkeypatch.setattr(command, "_become", commands.append)
    monkeypatch.setattr("fgrecon.viz.sinks.reachable", lambda _: "street.example")
    page, data = free_port(), free_port()
    run("replay", recording, "--web", "--port", page, "--data-port", data)
    start(commands[0])
    wait_for(lambda: listening(data))

    def allowed(origin):
        asked = {"Origin": origin, "Access-Control-Request-Method": "POST"}
        request = urllib.request.Request(f"http://{LOOPBACK}:{data}/x", headers=asked, method="OPTIONS")
        with urllib.request.urlopen(request, timeout=10) as answer:
            return answer.headers["access-control-allow-origin"]

    for origin in (f"http://street.example:{page}", f"http://localhost:{page}"):
        assert allowed(origin) == origin
    assert allowed("http://other.example") is None


def test_the_web_viewer_is_served_on_the_loopback_address(recording, monkeypatch, start):
    commands = []
    monkeypatch.setattr(command, "_become", commands.append)
    port = free_port()
    shown = run("replay", recording, "--web", "--port", port).stdout
    assert f"http://{LOOPBACK}:{port}?url=" in shown
    start(commands[0])
    wait_for(lambda: listening(port))
    with urllib.request.urlopen(f"http://{LOOPBACK}:{port}", timeout=10) as page:
        assert b"Rerun" in page.read()
    own = next((ip for ip in socket.gethostbyname_ex(socket.gethostname())[2] if not ip.startswith("127.")), None)
    if own is not None:
        with socket.socket() as outside:
            outside.settimeout(2.0)
            assert outside.connect_ex((own, port)) != 0


@pytest.mark.filterwarnings("ignore:RRD file has no footer")  # a server that is ended does not write one
def test_connect_sends_the_recording_to_a_viewer_that_listens(write, instance, tmp_path, start):
    port, received = free_port(), tmp_path / "received.rrd"
    server = start(viewer_command("--port", str(port), "--save", str(received)))
    wait_for(lambda: listening(port))
    saved = tmp_path / "saved.rrd"
    done = run("reconstruct", write(instance), INTRINSICS, "--connect", f"{LOOPBACK}:{port}", "--save", saved)
    assert done.exit_code == 0, done.output
    expected = replay.read(saved)

    def complete():
        try:
            return replay.read(received).log == expected.log
        except ValueError:
            return False

    wait_for(complete)
    server.terminate()
    server.wait(timeout=20)
    back = replay.read(received)
    assert [step.energies for step in back.history] == [step.energies for step in expected.history]
    assert all(
        (a.camera_T_object == b.camera_T_object).all() for a, b in zip(back.history, expected.history, strict=True)
    )


@pytest.mark.parametrize("address", ["nowhere", "127.0.0.1:", "127.0.0.1:99999", "127.0.0.1:FREE"])
def test_an_address_without_a_viewer_is_refused_before_solving(write, instance, address, monkeypatch):
    address = address.replace("FREE", str(free_port()))
    monkeypatch.setattr("fgrecon.batch.solve_tasks.solve_task", pytest.fail)
    done = run("reconstruct", write(instance), INTRINSICS, "--connect", address)
    assert "connect" in str(done.exception)
    with pytest.raises(ValueError, match="connect"):
        check_viewer(address)


def test_spawn_starts_a_viewer_and_sends_there(write, instance, monkeypatch):
    sent = []
    monkeypatch.setattr("fgrecon.viz.sinks.start_viewer", lambda: "127.0.0.1:1234")
    monkeypatch.setattr("fgrecon.viz.sinks.Recording.send", lambda _, name, address: sent.append((name, address)))
    cars = {"instances": [{"id": "one", **instance}, {"id": "two", **instance}]}
    assert run("reconstruct", write(cars), INTRINSICS, "--spawn").exit_code == 0
    assert sent == [("scene", "127.0.0.1:1234")]


def test_a_scene_is_summarised_vehicle_by_vehicle(tmp_path):
    car = make_example()
    sights = [
        SolvedVehicle(car.reconstruction, car.observation, car.camera, title=title) for title in ("left", "right")
    ]
    scene, summary = scene_recording_of(sights).write(tmp_path / "scene.rrd"), tmp_path / "summary.json"
    done = run("replay", scene, "--summary", "--json", summary)
    assert done.exit_code == 0
    assert [line for line in done.stdout.splitlines() if line.endswith(":")] == ["left:", "right:", "All 2 vehicles:"]
    document = json.loads(summary.read_text())
    assert list(document["vehicles"]) == ["left", "right"]
    alone, together = document["vehicles"]["left"]["stages"], document["stages"]
    assert [stage["steps"] for stage in together] == [2 * stage["steps"] for stage in alone]


@pytest.fixture(scope="module")
def of_a_video(tmp_path_factory):
    """A recording of two frames in which car 3 drives 7 and 8 m/s, and its width is known in the second alone."""
    car = make_example()
    values = [{"speed": (7.0 + n,), "width": (1.8, np.nan if n == 0 else 1.7, 1.9)} for n in range(2)]
    frames = [RecordedFrame(4 + n, 0.1 * n, None, (), np.eye(4), values={3: values[n]}) for n in range(2)]
    return video_recording_of(lambda: frames, car.camera).write(tmp_path_factory.mktemp("video") / "video.rrd")


def test_a_video_is_played(of_a_video, monkeypatch):
    commands = []
    monkeypatch.setattr(command, "_become", commands.append)
    assert run("replay", of_a_video, "--web").exit_code == 0
    assert commands[0][-1] == str(of_a_video)


def test_a_video_is_summarised_by_what_it_plots(of_a_video):
    done = run("replay", of_a_video, "--summary")
    assert done.exit_code == 0, done.output
    (row,) = (line.split() for line in done.stdout.splitlines() if line.startswith("plots/speed/3"))
    assert row[1:] == ["2", "4", "5", "7.000", "8.000"]
    plots = json.loads(run("replay", of_a_video, "--json", "-").stdout)["plots"]
    assert plots["plots/speed/3"] == {"frames": [4, 5], "names": ["3"], "values": [[7.0], [8.0]]}
    assert plots["plots/width/3"]["values"] == [[1.8, "nan", 1.9], [1.8, 1.7, 1.9]]
    series = replay.read(of_a_video).scalars["plots/width/3"]
    assert series.timeline == "frame"
    assert series["3, 95 % from"][1] == 1.7


def test_a_shape_prior_is_played(tmp_path, monkeypatch):
    monkeypatch.setattr(command, "_become", lambda _: None)
    path = tmp_path / "prior.rrd"
    assert run("prior", "show", "car14", "--save", path).exit_code == 0
    assert run("replay", path, "--web").exit_code == 0
    assert run("replay", path, "--summary").stdout == "It has drawings alone.\n"


def test_a_recording_of_another_program_is_refused(tmp_path):
    import rerun as rr

    stream = rr.RecordingStream("theirs")
    stream.save(tmp_path / "theirs.rrd")
    stream.log("x", rr.TextLog("x"))
    stream.flush()
    stream.disconnect()
    done = run("replay", tmp_path / "theirs.rrd", "--summary")
    assert "This one holds no log of it." in str(done.exception)
