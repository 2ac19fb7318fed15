"""Real sockets and a real pseudo-terminal: agent and simulated autopilot over loopback."""

from __future__ import annotations

import os
import socket
import time
from pathlib import Path

import pytest

from benchmarks.fixtures.quad_rig import ORIGIN, STEP, PointMass, settings
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.platform import Unready
from targets.mavlink.transport import opened
from targets.quad.platform.platform import Quad
from targets.sim.autopilots.autopilot import SimulatedAutopilot
from targets.sim.base.bodies import DeviceContext
from tests.terminal import terminal

PACE = 4.0  # times faster than real time


def test_a_flight_over_loopback() -> None:
    body = PointMass()
    harness = {"boot": 0.2, "spool_up": 0.3, "position_noise": 0.005}
    autopilot = SimulatedAutopilot(body, DeviceContext("alice", {}, harness, ORIGIN, 1, b""))
    quad = Quad(settings(**autopilot.overrides, flight_height=0.5), None)
    try:
        begun = now = stepped = polled = time.monotonic()
        quad.start(now)
        while now - begun < 20.0 and not quad.stopped:
            now = begun + PACE * (time.monotonic() - begun)
            while stepped < now:
                stepped += STEP
                body.step(STEP)
                autopilot.step(stepped)
            if now >= polled:
                polled += quad.period
                quad.poll(now)
                if quad.ready:
                    quad.command({"Motion.target": Point(1.3, -2.0, 0.0)}, now)
                    if quad.sense(now).values["Motion.reached"]:
                        quad.stop(now)
            time.sleep(0.002)
        assert quad.stopped, quad.progress
        assert abs(body.position[0] - 1.3) < 0.2 and body.position[2] == 0.0
    finally:
        quad.close()
        autopilot.close()


def test_a_port_in_use_is_said() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        url = f"udpin:127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(Unready, match="in use") as error:
            opened(url)
    assert "another program may listen" in error.value.hint


def test_tcp_comes_back_after_a_break() -> None:
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen()
        server.settimeout(5)
        link = opened(f"tcp:127.0.0.1:{server.getsockname()[1]}")
        now = 0.0
        for word in (b"one", b"two"):
            link.receive(now)
            connection, _ = server.accept()
            with connection:
                connection.settimeout(5)
                connection.sendall(word)
                got = b""
                while got != word:
                    got += b"".join(data for data, _ in link.receive(now))
                assert link.send(b"hello")
                assert connection.recv(5) == b"hello"
            for _ in range(200):  # the break is noticed
                link.receive(now)
                time.sleep(0.002)
                if not link.send(b"?"):
                    break
            now += 2.0
        link.close()
    refused = opened("tcp:127.0.0.1:1")
    assert refused.receive(0.0) == [] and refused.receive(2.0) == []
    refused.close()


def test_a_serial_device_that_takes_nothing_blocks_nobody_and_gets_whole_frames_later() -> None:
    with terminal() as (master, path):
        link = opened(f"serial:{path}:115200")
        frames = [bytes([i % 251]) * 61 for i in range(2000)]
        taken = [frame for frame in frames if link.send(frame)]
        assert 0 < len(taken) < 1000
        got = os.read(master, 65536)
        while not link.send(b"last"):
            got += os.read(master, 65536)
        while not got.endswith(b"last"):
            got += os.read(master, 65536)
        assert got == b"".join(taken) + b"last"
        link.close()


def test_a_serial_device_that_is_plugged_in_again_is_opened_anew(tmp_path: Path) -> None:
    device = tmp_path / "autopilot"
    now = 0.0
    link = None
    for word in (b"one", b"two"):
        with terminal() as (master, path):
            device.unlink(missing_ok=True)
            device.symlink_to(path)
            link = link or opened(f"serial:{device}:115200")
            while not link.send(b"hello"):
                now += 0.05
                link.receive(now)
            assert os.read(master, 5) == b"hello"
            os.write(master, word)
            got = b""
            while got != word:
                got += b"".join(data for data, _ in link.receive(now))
        for _ in range(20):  # unplugged
            now += 0.05
            assert link.receive(now) == []
        assert not link.send(b"?")
    assert link is not None
    link.close()


def test_udpout_speaks_first_and_to_its_peer_alone() -> None:
    udp = socket.AF_INET, socket.SOCK_DGRAM
    with socket.socket(*udp) as peer, socket.socket(*udp) as other:
        peer.bind(("127.0.0.1", 0))
        peer.settimeout(5)
        link = opened(f"udpout:127.0.0.1:{peer.getsockname()[1]}")
        for word in (b"one", b"two"):
            assert link.send(b"hello")
            data, source = peer.recvfrom(100)
            assert data == b"hello"
            other.sendto(b"spoof", source)
            peer.sendto(word, source)
            got: list[bytes] = []
            while not got:
                got = [chunk for chunk, _ in link.receive(0.0)]
            assert got == [word]
        link.close()
