"""`--foxglove`: topics are advertised to a WebSocket client, messages come, and nothing waits for clients."""

from __future__ import annotations

import json
import socket
import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from koordgen.runtime.trace.schema import InitRecord, LogLine, Moved, Round
from koordgen.runtime.values.obstacles import Sphere
from koordgen.runtime.values.points import Point
from targets.sim import harness
from targets.sim.view.foxglove import stream
from targets.sim.view.foxglove.messages import Messages
from targets.sim.view.foxglove.stream import FoxgloveServer, Streamed
from tests.sim.run.fake_fleet import bundle
from tests.sim.view.canned import header
from tests.sim.view.test_live import STATES, running
from tests.sim.view.websocket import WebSocket

HEAD = header(["alice", "bert"])
PROTOCOL = "foxglove.sdk.v1"
Found = tuple[str, float, dict[str, Any]]


class Client(WebSocket):
    """Reads topics of a server: what is advertised, and messages as topic, time (s) and value."""

    def __init__(self, port: int) -> None:
        super().__init__(port, PROTOCOL)
        self.schemas: dict[str, str] = {}
        self._topics: dict[int, str] = {}

    def until(self, *topics: str) -> None:
        """Subscribe to these topics once they are advertised; the server does so in this order."""
        channels: dict[str, int] = {}
        while not channels.keys() >= set(topics):
            told = self.receive()
            for each in told.get("channels", ()) if told["op"] == "advertise" else ():
                channels[each["topic"]], self.schemas[each["topic"]] = each["id"], each["schemaName"]
                assert each["encoding"] == "json" and json.loads(each["schema"])["title"] == each["schemaName"]
        for number, topic in enumerate(topics):
            self._topics[number] = topic
            self.send({"op": "subscribe", "subscriptions": [{"id": number, "channelId": channels[topic]}]})

    def next(self) -> Found:
        while not isinstance(told := self.receive(), bytes):
            pass
        number, at = struct.unpack("<IQ", told[1:13])
        return self._topics[number], at / 1e9, json.loads(told[13:])


@pytest.fixture
def client(server: FoxgloveServer) -> Iterator[Client]:
    with Client(int(server.url.rpartition(":")[2])) as made:
        yield made


@pytest.fixture
def server() -> Iterator[FoxgloveServer]:
    made = FoxgloveServer(HEAD, 0)
    yield made
    made.close()


def rows(t: float) -> Any:
    return {
        "poses": [[0, t, 1.0, 2.0, 3.0, 0.0]], "logs": [[1, t, "warning", "low"]], "phases": [[1, t, "running", ""]],
        "rounds": [[0, t, t + 0.11, 2, 1, "no event enabled"]], "paths": [[0, t, [[1.0, 2.0, 3.0], [4.0, 2.0, 3.0]]]],
        "shared": [["x", 1, t, 3, 42]], "marks": [[t, "cause", "wind", ["bert"], "strong", 2.0]],
        "markers": [[t, 0, 1, {"name": "m", "position": [1.0, 1.0, 0.0], "radius": 0.3}]],
    }  # fmt: skip


def test_a_fleets_rows_come_as_foxgloves_messages(server: FoxgloveServer, client: Client) -> None:
    def nanoseconds(t: float) -> int:
        return round((t + 5) * 1e9)

    server.rows(rows(0.0), nanoseconds)
    topics = ("/tf", "/poses/alice", "/log", "/phases", "/rounds/alice", "/shared/x", "/causes", "/scene")
    client.until(*topics)
    assert [client.schemas[topic] for topic in topics] == [
        "foxglove.FrameTransform", "foxglove.PoseInFrame", "foxglove.Log", "koord.Phase", "koord.Round", "koord.Shared",
        "koord.Verdict", "foxglove.SceneUpdate",
    ]  # fmt: skip
    kept = {topic: what for topic, _, what in (client.next() for _ in range(3))}
    assert kept["/phases"]["robot"] == "bert" and kept["/shared/x"]["value"] == 42
    assert {entity["id"] for entity in kept["/scene"]["entities"]} >= {"robot alice", "path alice", "marker 0"}
    server.rows(rows(1.0), nanoseconds)
    found: dict[str, list[Any]] = {}
    while "/causes" not in found or "/shared/x" not in found:
        topic, at, what = client.next()
        found.setdefault(topic, []).append(what)
        assert 6.0 <= at < 6.2
    assert found["/tf"][0]["translation"] == {"x": 1.0, "y": 2.0, "z": 3.0}
    assert [(each["name"], each["message"]) for each in found["/log"]] == [("bert", "low"), ("bert", "wind: strong")]
    (told,) = found["/rounds/alice"]
    assert (told["round"], told["skipped"], told["event"], told["late"]) == (12, "no event enabled", None, 0.01)


def test_a_run_is_streamed_with_times_from_the_launch(server: FoxgloveServer, client: Client) -> None:
    streamed, run = Streamed(HEAD, server), running()
    streamed.launched(run)
    agent = run.conduct.agents[1]
    streamed.heard(agent, [InitRecord(time=101.9), Round(1, "Go", time=102.0), LogLine("info", "hello", time=102.0)])
    streamed.step(102.0, STATES)
    client.until("/log", "/tf", "/scene")
    assert client.next()[0] == "/scene"
    run.zero = 102.0
    for k in range(12):
        streamed.step(103.0 + k / 240, STATES)
    run.marks.append(Moved(103.0, 0, Sphere(Point(1.0, 0.0, 0.0), 0.5)))
    streamed.show(103.2, [])
    seen = [client.next() for _ in range(3)]
    assert [(topic, round(at, 3)) for topic, at, _ in seen] == [("/tf", 3.046), ("/tf", 3.046), ("/scene", 3.0)]
    (ball,) = seen[2][2]["entities"]
    assert ball["id"] == "obstacle 0" and ball["spheres"][0]["pose"]["position"]["x"] == 1.0


def test_a_client_that_reads_nothing_holds_up_nothing(server: FoxgloveServer, client: Client) -> None:
    server.rows(rows(0.0), lambda t: 0)
    client.until("/log")
    long = "x" * 10_000
    for k in range(5000):  # 50 MB, more than any buffer of the system holds
        server.put(k, [("/log", "foxglove.Log", {"message": long})])
    assert server.url


def test_records_and_rows_of_one_run_have_the_same_topics() -> None:
    of_rows = {topic for _, (topic, _, _) in Messages(HEAD).of_rows(rows(0.0), lambda t: 0)}
    assert of_rows == {
        "/poses/alice", "/tf", "/phases", "/log", "/rounds/alice", "/shared/x", "/scene", "/causes",
    }  # fmt: skip


def test_a_port_that_is_taken_and_a_package_that_is_missing_are_told_before_anything_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    root = bundle(tmp_path / "sim", ["good"])
    monkeypatch.setattr(harness, "_require", lambda *_, **__: None)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        number = taken.getsockname()[1]
        assert harness.main(root, ["--out", str(tmp_path / "out"), "--foxglove", str(number)]) == 5
    assert f"port {number}" in (said := capsys.readouterr().err) and "name another port" in said
    monkeypatch.setitem(sys.modules, "foxglove", None)
    assert harness.main(root, ["--out", str(tmp_path / "out"), "--foxglove"]) == 5
    said = capsys.readouterr().err
    assert "the Python package 'foxglove-sdk' is missing" in said and "'koordgen[foxglove]'" in said
    assert not (tmp_path / "out").exists()
    assert stream.PACKAGE in harness.EXTRAS
