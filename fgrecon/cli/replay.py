"""`fgrecon replay`: look at a recording, or read its numbers back without a viewer."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fgrecon.cli.outputs import check_outputs
from fgrecon.cli.terminal import Verbosity, compact_table
from fgrecon.core.text import whole_text

if TYPE_CHECKING:  # the command line must start fast: what the command needs is imported when it runs
    from collections.abc import Mapping

    from rich.table import Table

    from fgrecon.cli.terminal import Screen
    from fgrecon.viz.replay import Replay, Series

_WEB_PORT = 9090


def replay_command(
    recording: Annotated[Path, typer.Argument(metavar="FILE.rrd", help="Recording, as written by --save.")],
    terminal: Verbosity,
    summary: Annotated[bool, typer.Option("--summary", help="Print stages, iterations and energies instead.")] = False,
    json_out: Annotated[
        str | None, typer.Option("--json", metavar="FILE", help="Write that summary as JSON instead; - for the output.")
    ] = None,
    web: Annotated[bool, typer.Option("--web", help="Serve the viewer to a browser instead of a window.")] = False,
    bind: Annotated[str, typer.Option(metavar="ADDRESS", help="Address that the viewer's servers listen on.")] = (
        "127.0.0.1"
    ),
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of --web; 0 for a free one.")] = _WEB_PORT,
    data_port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port that the viewer has its data from; 0 for a free one.")
    ] = 0,
) -> None:
    """Play a recording in rerun's viewer.

    The servers that it starts listen on this machine alone, unless --bind says otherwise. Through a tunnel both ports
    of --web are needed: --port for the page, --data-port for the recording. --summary --verbose prints the whole log.
    """
    from fgrecon.viz.replay import read

    check_outputs(json_out)
    screen = terminal.screen(json_out)
    content = read(recording)  # a file that is none is refused here, in words, and not by the viewer
    if summary:
        _print(content, screen)
    if json_out is not None:
        screen.write_json(json.dumps(_document(recording, content), allow_nan=False) + "\n")
    if not summary and json_out is None:
        _become(_viewer(recording, bind, port, data_port, screen, web=web))


def _viewer(recording: Path, bind: str, port: int, data_port: int, screen: Screen, *, web: bool) -> list[str]:
    """The viewer's command line; says where to find it in a browser."""
    from urllib.parse import quote

    from fgrecon.viz.sinks import free_port, has_display, reachable, viewer_command

    if not web and not has_display():
        from fgrecon.core.errors import InvalidInputError

        fix = "Give --web to look at it in a browser, or --summary to print its numbers."
        raise InvalidInputError("display", "none", fix)
    server = data_port or free_port(bind)
    if not web:
        return viewer_command("--port", str(server), str(recording), bind=bind)
    page = port or free_port(bind)
    host = reachable(bind)
    source = quote(f"rerun+http://{host}:{server}/proxy", safe="")
    screen.print(f"Open http://{host}:{page}?url={source} in a browser; end with Ctrl-C.")
    ports = ("--port", str(server), "--web-viewer-port", str(page))
    allowed = ("--cors-allow-origin", f"http://{host}:{page}")  # else only pages of this machine get the data
    return viewer_command(*ports, *allowed, "--serve-web", str(recording), bind=bind)


def _become(command: list[str]) -> None:
    """Let the viewer take this process's place, so that whoever ends this command ends the viewer."""
    sys.stdout.flush()
    os.execv(command[0], command)  # noqa: S606 - our own command line


def _print(content: Replay, screen: Screen) -> None:
    for name, vehicle in content.vehicles.items():
        screen.print(f"{name}:")
        _print(vehicle, screen)
    if content.vehicles:
        screen.print(f"All {len(content.vehicles)} vehicles:")
    if plots := _of_video(content):
        screen.print(_plots(plots))
    elif content.history or content.log:
        screen.print(_table(content))
    else:
        screen.print("It has drawings alone.")
    if len(content.frames) > 1:
        screen.print(f"{len(content.frames)} frames, {min(content.frames)} to {max(content.frames)}.")
    for line in content.log if screen.verbose else content.log[-1:]:
        screen.print(f"{line.level}: {line.text}")


def _table(content: Replay) -> Table:
    headings = ("stage", "weight updates", "iterations", "energy first", "last", "by term at the end (nats)")
    table = compact_table(*headings, text=(headings[0], headings[-1]), overflow="fold")
    for stage in content.summary():
        terms = ", ".join(f"{name} {energy:.2f}" for name, energy in stage.terms.items())
        counts = (str(stage.weight_updates), str(stage.steps))
        table.add_row(stage.stage, *counts, f"{stage.first_energy:.3f}", f"{stage.last_energy:.3f}", terms)
    return table


def _of_video(content: Replay) -> dict[str, Series]:
    """The plots of a video's recording, which has them by frame and no steps; none of others."""
    from fgrecon.viz.entities import FRAME

    plots = {name: series for name, series in content.scalars.items() if series.timeline == FRAME}
    return {} if content.frames else plots


def _plots(plots: Mapping[str, Series]) -> Table:
    """What a video's recording has of its cars over the frames."""
    table = compact_table("value", "frames", "first", "last", "value first", "value last", text=("value",))
    for name, series in plots.items():
        ends = (f"{series.times[0]}", f"{series.times[-1]}", *(f"{series.values[row, 0]:.3f}" for row in (0, -1)))
        table.add_row(name, str(len(series.times)), *ends)
    return table


def _document(recording: Path, content: Replay) -> dict[str, Any]:
    """The summary as plain values; numbers that are not finite become strings."""
    vehicles = {name: _content(vehicle) for name, vehicle in content.vehicles.items()}
    document = {"format": "fgrecon.replay/1", "recording": whole_text(str(recording)), **_content(content)}
    return document | ({"vehicles": vehicles} if vehicles else {})


def _content(content: Replay) -> dict[str, Any]:
    from fgrecon.core.serialise import plain

    plots = {
        name: {"frames": series.times, "names": series.names, "values": series.values}
        for name, series in _of_video(content).items()
    }
    return {
        **({"plots": plain(plots)} if plots else {}),
        "stages": plain(content.summary()),
        "frames": {str(number): len(steps) for number, steps in content.frames.items()},
        "log": plain(content.log),
    }
