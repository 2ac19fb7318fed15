"""What a service manager hears from an agent, over real sockets."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import msgspec
import pytest

from benchmarks.fixtures.fleet import NAMES, settings
from koordgen.runtime.config.settings import Peer
from koordgen.runtime.ops.notify import Notifier
from tests.runtime.net.transports import free_ports

MAIN = str(Path(__file__).with_name("robot_main.py"))


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(str(tmp_path / "notify"))
        listening.settimeout(0.0)
        yield listening


def heard(manager: socket.socket) -> list[str]:
    found = []
    while True:
        try:
            found.append(manager.recv(4096).decode())
        except BlockingIOError:
            return found


def notifier(manager: socket.socket, **more: str) -> closing[Notifier]:
    return closing(Notifier({"NOTIFY_SOCKET": str(manager.getsockname()), **more}, 42))


def test_the_watchdog_is_fed_three_times_a_period_and_the_status_told_when_it_changes(manager: socket.socket) -> None:
    with notifier(manager, WATCHDOG_USEC="3000000", WATCHDOG_PID="42") as told:
        told.ready()
        for turn in range(50):  # 5 s
            told.alive(100 + turn / 10, "joining" if turn < 30 else "running")
        told.stopping()
    messages = heard(manager)
    assert [m for m in messages if m != "WATCHDOG=1"] == ["READY=1", "STATUS=joining", "STATUS=running", "STOPPING=1"]
    assert messages.count("WATCHDOG=1") == 5


@pytest.mark.parametrize(
    "environment",
    [{}, {"WATCHDOG_USEC": "0"}, {"WATCHDOG_USEC": "often"}, {"WATCHDOG_USEC": "1000", "WATCHDOG_PID": "41"}],
)
def test_who_does_not_watch_is_not_fed(manager: socket.socket, environment: dict[str, str]) -> None:
    with notifier(manager, **environment) as told:
        told.alive(1.0, "running")
        told.alive(9.0, "running")
    assert heard(manager) == ["STATUS=running"]


@pytest.mark.parametrize("place", ["", "relative", "/no/such/place"])
def test_without_a_manager_nothing_happens(place: str) -> None:
    told = Notifier({"NOTIFY_SOCKET": place, "WATCHDOG_USEC": "1000"}, 42)
    told.ready()
    told.alive(1.0, "running")
    told.close()


def test_a_manager_that_does_not_listen_never_blocks(manager: socket.socket) -> None:
    with notifier(manager, WATCHDOG_USEC="3") as told:
        for turn in range(5000):
            told.alive(float(turn), "running")
    assert "WATCHDOG=1" in heard(manager)


def test_an_abstract_socket_is_reached(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(f"\0koordgen-{os.getpid()}")
        with closing(Notifier({"NOTIFY_SOCKET": f"@koordgen-{os.getpid()}"}, 42)) as told:
            told.ready()
        listening.settimeout(10)
        assert listening.recv(100) == b"READY=1"


def test_an_agent_tells_its_manager_that_it_is_ready_lives_and_stops(tmp_path: Path, manager: socket.socket) -> None:
    ports = free_ports(3)
    peers = [Peer(NAMES[i], "127.0.0.1", port) for i, port in enumerate(ports[:2])]
    plain = msgspec.to_builtins(settings(0, 2, insecure=True))
    plain |= {"peers": msgspec.to_builtins(peers), "control": ports[2]}
    (tmp_path / "settings.json").write_bytes(msgspec.json.encode(plain))
    manager.settimeout(60)
    service = {"NOTIFY_SOCKET": str(manager.getsockname()), "WATCHDOG_USEC": "300000"}
    process = subprocess.Popen(
        [sys.executable, MAIN, str(tmp_path)], stderr=subprocess.DEVNULL, env=os.environ | service
    )
    try:
        for expected in ("READY=1", "STATUS=joining, round 0", "WATCHDOG=1", "WATCHDOG=1"):
            while manager.recv(4096).decode() != expected:
                pass
        process.send_signal(signal.SIGTERM)
        while manager.recv(4096).decode() != "STOPPING=1":
            pass
        assert process.wait(60) == 0
    finally:
        process.kill()
        process.wait()
