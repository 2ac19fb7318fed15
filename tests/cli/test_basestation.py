"""Base station: receivers and rates of poses, and its messages. The last tests open sockets on loopback."""

from __future__ import annotations

import io
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from koordgen.build.pipeline import read_fleet
from koordgen.cli import main
from koordgen.cli.base.terminal import ProgressLine
from koordgen.fleet.mocap import Mocap
from koordgen.operate import basestation
from koordgen.operate.basestation import (
    Body,
    Camera,
    CannotServe,
    Forwarder,
    Receiver,
    all_targets,
    connected,
    next_session,
    receivers,
    station,
)
from koordgen.runtime.vehicle.feed import Feed
from tests.terminal import terminal

KEY = bytes(range(32))
FLEET = """
delta: 0.1
origin: {latitude: 47.0, longitude: 8.0, altitude: 488.0}
geofence: {lo: [-6, -5, -0.5], hi: [6, 5, 4]}
params: {laps: 3, of_a_program: that is not here}
robots:
  - {name: alice, target: quad, address: "127.0.0.1:47100", settings: {positioning: vision, feed: "udp:0.0.0.0:PORT"}}
  - {name: bert, target: car, address: "127.0.0.1:47101"}
  - {name: cleo, target: quad, address: "127.0.0.1:47102"}
"""


def body(x: float, y: float = 0.0, z: float = 0.0) -> Body:
    return (x, y, z), (0.0, 0.0, 0.0, 1.0)


def forwarder(rate: float = 50.0, mocap: Mocap | None = None) -> Forwarder:
    return Forwarder(("alice", "bert"), mocap or Mocap(), KEY, 7, rate)


def written(folder: Path, text: str = FLEET, port: int = 47310) -> Path:
    path = folder / "fleet.yaml"
    path.write_text(text.replace("PORT", str(port)))
    key = folder / "fleet.key"
    key.write_bytes(KEY)
    key.chmod(0o600)
    return path


def fleet_of(path: Path) -> Any:
    return read_fleet(str(path), all_targets(), None)[0]


def test_each_robot_gets_its_own_pose() -> None:
    mocap = Mocap(offset=(0.0, 0.0, 1.0))
    sent = forwarder(mocap=mocap).frame({"alice": body(1.0), "bert": body(2.0)}, 99.99, 100.0)
    for name, x in (("alice", 1.0), ("bert", 2.0)):
        feed = Feed(name, KEY)
        assert feed.receive(sent[name], 50.0) and feed.pose is not None and feed.time == pytest.approx(49.99)
        assert (feed.pose.position.x, feed.pose.position.z, feed.pose.yaw) == (x, 1.0, 0.0)
    assert not Feed("alice", KEY).receive(sent["bert"], 50.0)


@pytest.mark.parametrize(
    ("cameras", "rate", "expected"), [(240, 50, 50), (100, 50, 50), (60, 50, 50), (51, 50, 50), (30, 50, 30)]
)
def test_not_more_often_than_asked_for_and_no_less(cameras: int, rate: float, expected: int) -> None:
    passed, feed = forwarder(rate), Feed("alice", KEY)
    taken = 0
    for i in range(cameras * 4):
        now = 100.0 + i / cameras
        for datagram in passed.frame({"alice": body(i * 1e-3)}, now, now).values():
            taken += feed.receive(datagram, now)
    assert taken / 4 == pytest.approx(expected, rel=0.05)


def test_a_body_that_is_lost_or_has_no_pose_is_not_passed_on() -> None:
    passed = forwarder()
    assert "alice" in passed.frame({"alice": body(1.0)}, 1.0, 1.0)
    for now in (1.1, 1.2, 3.0):
        assert not passed.frame({"alice": body(1.0), "bert": body(float("nan"))}, now, now), "frozen, and occluded"
    told = passed.summary(3.0, 1.0)
    assert "alice NOT SEEN" in told and "bert NOT SEEN" in told
    assert "alice" in passed.frame({"alice": body(1.001)}, 3.1, 3.1)


def test_what_is_told() -> None:
    passed = forwarder()
    for i in range(50):
        passed.frame({"alice": body(i * 0.01, -1.0), "wand": body(0.0)}, i * 0.02, i * 0.02)
    assert passed.summary(1.0, 1.0) == "alice 50/s (0.49, -1.00, 0.00)  bert NOT SEEN  not in the fleet: wand"
    assert "not in the fleet" not in passed.summary(3.0, 1.0)


def test_who_is_told_and_where(tmp_path: Path) -> None:
    fleet = fleet_of(written(tmp_path))
    assert receivers(fleet, all_targets()) == (
        Receiver("alice", "127.0.0.1", 47310), Receiver("bert", "127.0.0.1", 47300)
    )  # fmt: skip
    assert basestation.keyed(fleet, str(tmp_path / "fleet.yaml"), None) == KEY


def test_a_feed_that_is_no_address_and_a_fleet_that_takes_none(tmp_path: Path) -> None:
    fleet = fleet_of(written(tmp_path, FLEET.replace("udp:0.0.0.0:PORT", "serial:a")))
    with pytest.raises(CannotServe, match="alice: feed 'serial:a' is not understood"):
        receivers(fleet, all_targets())
    own = "\n".join(line for line in FLEET.splitlines() if "alice" not in line and "bert" not in line)
    with pytest.raises(CannotServe, match="no robot of this fleet receives"):
        receivers(fleet_of(written(tmp_path, own)), all_targets())


def test_the_package_can_be_imported_and_its_mistakes_are_told() -> None:
    pytest.importorskip("motioncapture")
    with pytest.raises(CannotServe, match="sundial at localhost: Unknown") as told:
        connected("sundial", "localhost")
    assert told.value.help


class FakeSystem:
    """Stand-in for `motioncapture.MotionCapture`: a body circles, with a frame each 5 ms."""

    def __init__(self, fails: bool = False) -> None:
        self._count = 0
        self._fails = fails

    def waitForNextFrame(self) -> None:
        time.sleep(0.005)
        self._count += 1
        if self._fails and self._count > 3:
            raise RuntimeError("connection lost")

    @property
    def rigidBodies(self) -> dict[str, Any]:
        rotation = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
        return {"alice": SimpleNamespace(name="alice", position=[self._count * 1e-3, 0.0, 1.0], rotation=rotation)}


@pytest.fixture
def robot() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind(("127.0.0.1", 0))
        opened.settimeout(5.0)
        yield opened


def fake(monkeypatch: pytest.MonkeyPatch, fails: bool = False) -> list[Any]:
    asked: list[Any] = []

    def connect(*given: Any) -> FakeSystem:
        asked.append(given)
        return FakeSystem(fails)

    monkeypatch.setitem(sys.modules, "motioncapture", SimpleNamespace(connect=connect))
    return asked


class Enough(Exception):
    pass


def test_from_the_system_to_the_robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, robot: socket.socket) -> None:
    asked, path = fake(monkeypatch), written(tmp_path, port=robot.getsockname()[1])
    serving = station(fleet_of(path), str(path), None, "vicon", "10.0.0.2", 50.0, pytest.fail)
    told: list[str] = []

    def enough(text: str) -> None:
        told.append(text)
        raise Enough

    with pytest.raises(Enough):
        serving.serve(enough)
    assert serving.camera.end()
    assert asked == [("vicon", {"hostname": "10.0.0.2"})]
    assert told[0].startswith("alice ") and "/s (" in told[0] and "bert NOT SEEN" in told[0]
    feed, taken = Feed("alice", KEY), 0
    robot.setblocking(False)
    while True:
        try:
            taken += feed.receive(robot.recv(2048), time.monotonic())
        except BlockingIOError:
            break
    assert 20 < taken <= 60 and feed.rejected == {}


def test_a_system_that_goes_ends_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    fake(monkeypatch, fails=True)
    assert main(["basestation", str(written(tmp_path)), "--system", "vicon", "--host", "h"]) == 5
    told = capsys.readouterr()
    assert "the motion capture system failed: connection lost" in told.err and told.out == ""


def test_without_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "motioncapture", None)
    assert main(["basestation", str(written(tmp_path)), "--system", "vicon", "--host", "h"]) == 5
    assert "motioncapture is missing" in (err := capsys.readouterr().err) and "koordgen[mocap]" in err


def test_without_a_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    fake(monkeypatch)
    path = written(tmp_path)
    (tmp_path / "fleet.key").unlink()
    assert main(["basestation", str(path), "--system", "vicon", "--host", "h"]) == 1
    assert "fleet.key" in (err := capsys.readouterr().err) and "--key FILE" in err


def test_mistakes_of_the_fleet_file_have_a_place(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, FLEET + "mocap: {up: x}\n")
    assert main(["basestation", str(path), "--system", "vicon", "--host", "h"]) == 1
    assert "fleet.yaml:10:13: error[F005]: mocap.up cannot be 'x'" in capsys.readouterr().err


@pytest.mark.parametrize("rate", ["0", "-1", "nan", "fast"])
def test_a_rate_that_is_none_is_a_usage_error(rate: str, tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["basestation", "f.yaml", "--system", "vicon", "--host", "h", f"--rate={rate}"])
    assert ended.value.code == 2


def test_old_frames_are_not_kept() -> None:
    camera = Camera(FakeSystem())
    time.sleep(0.1)
    assert camera.end() and camera.frames.qsize() <= 2
    first = camera.frames.get()
    assert not isinstance(first, Exception) and first[1]["alice"][0][0] > 0.005


def test_an_interrupt_while_the_line_is_shown_leaves_it_a_line_of_its_own() -> None:
    class Interrupted(io.StringIO):
        def isatty(self) -> bool:
            return True

        def flush(self) -> None:
            raise KeyboardInterrupt

    stream = Interrupted()
    line = ProgressLine(stream)
    with pytest.raises(KeyboardInterrupt):
        line.show("alice 50/s")
    line.end()
    assert stream.getvalue() == "\r\x1b[Kalice 50/s\n"


@pytest.mark.parametrize("system", ["mock", pytest.param("vrpn", marks=pytest.mark.slow)])
def test_it_ends_in_order_when_interrupted(system: str, tmp_path: Path) -> None:
    """Uses the real package, whose vrpn waits in its library for a frame that never comes.

    The interrupt comes after the progress line is shown: Python that is still loading would print its own message.
    """
    pytest.importorskip("motioncapture")
    options = [str(written(tmp_path)), "--system", system, "--host", "127.0.0.1"]
    command = [sys.executable, "-m", "koordgen", "basestation", *options]
    with terminal() as (ours, device), open(device, "wb") as theirs:
        process = subprocess.Popen(command, stderr=theirs)
        try:
            told = b""
            while b"NOT SEEN" not in told:
                told += os.read(ours, 4096)
            process.send_signal(signal.SIGINT)
            while b"\ninterrupted\n" not in told:
                told += os.read(ours, 4096)
            assert process.wait() == 130
        finally:
            process.kill()
            process.wait()
    assert b"Traceback" not in told


def test_a_session_is_greater_than_any_before_whatever_the_clock_says(tmp_path: Path) -> None:
    path, told = tmp_path / "basestation.session", [""]
    assert next_session(path, 1000, told.append) == 1000
    assert next_session(path, 900, told.append) == 1001, "the clock is behind"
    assert next_session(path, 5000, told.append) == 5000
    assert next_session(path, 5000, told.append) == 5001
    assert told == [""]
    path.write_text("noise")
    assert next_session(path, 7000, told.append) == 7000
    assert "cannot be read" in told[-1] and str(path) in told[-1]
    assert [p.name for p in tmp_path.iterdir()] == ["basestation.session"]


def test_a_folder_that_keeps_no_session_stops_no_base_station(tmp_path: Path) -> None:
    told: list[str] = []
    assert next_session(tmp_path / "gone" / "basestation.session", 1000, told.append) == 1000
    assert len(told) == 1 and "No such file" in told[0]


def test_samples_carry_the_application_id() -> None:
    passed = Forwarder(("alice",), Mocap(), KEY, 1, 50.0, 7)
    feed = Feed("alice", KEY, 7)
    assert feed.receive(passed.frame({"alice": body(1.0)}, 3.0, 3.0)["alice"], 10.0)
