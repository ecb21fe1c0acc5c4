"""Viewers that tests send recordings to."""

import socket
import time

from fgrecon.viz.sinks import LOOPBACK


def listening(port):
    try:
        with socket.create_connection((LOOPBACK, port), timeout=1.0):
            return True
    except OSError:
        return False


def wait_for(condition, seconds=20.0):
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.05)
