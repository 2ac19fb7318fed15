"""The live view: what clients get, that none can slow a run, and, on loopback, the page of a run that goes on."""

from __future__ import annotations

import http.client
import json
import re
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from koordgen.runtime.trace.schema import InitRecord, Round, Violation
from targets.sim.base.bodies import BodyState
from targets.sim.base.folder import MARKER
from targets.sim.view.web import live, serve
from targets.sim.view.web.live import Live, PaceLimit
from targets.sim.view.web.serve import MOST_CLIENTS, MOST_WAITING, EventHub
from tests.sim.lockstep.lockstep import built, digest, ran
from tests.sim.run.fake_fleet import bundle
from tests.sim.view.canned import header

FLEET = Path(__file__).parents[1] / "run" / "fake_fleet.py"
HEAD = header(["alice", "bert"])


def events(queue: Any) -> list[tuple[str, Any]]:
    found = []
    while not queue.empty():
        name, data = queue.get_nowait().decode().strip().split("\n")
        found.append((name.removeprefix("event: "), json.loads(data.removeprefix("data: "))))
    return found


def pose(t: float) -> dict[str, Any]:
    return {"poses": [[0, t, 1.0, 2.0, 3.0, 0.0]]}


def test_who_comes_late_gets_all_of_it_and_then_what_is_new() -> None:
    hub = EventHub(HEAD)
    hub.rows(pose(1.0))
    client = hub.join()
    hub.rows(pose(2.0))
    (first, whole), *more = events(client)
    assert first == "whole" and whole["poses"] == pose(1.0)["poses"]
    assert more == [("rows", pose(2.0))]


def test_what_was_before_round_1_does_not_count() -> None:
    hub = EventHub(HEAD)
    hub.rows(pose(1.0))
    client = hub.join()
    hub.begin()
    late = hub.join()
    assert [(name, chunk["poses"]) for name, chunk in events(client)][1:] == [("whole", [])]
    assert [(name, chunk["poses"]) for name, chunk in events(late)] == [("whole", [])]


def test_a_client_that_reads_nothing_waits_with_few_events_and_then_misses_nothing() -> None:
    hub = EventHub(HEAD)
    slow = hub.join()
    for k in range(10 * MOST_WAITING):
        hub.rows(pose(k))
        assert slow is not None and slow.qsize() <= MOST_WAITING
    found = events(slow)
    assert found[0][0] == "whole"
    times = [row[1] for _, chunk in found for row in chunk["poses"]]
    assert times == sorted(times) and times[0] == 0 and times[-1] == 10 * MOST_WAITING - 1 and len(times) == 640


def test_there_is_a_limit_to_clients() -> None:
    hub = EventHub(HEAD)
    first = hub.join()
    assert first is not None
    assert all(hub.join() for _ in range(MOST_CLIENTS - 1)) and hub.join() is None
    hub.leave(first)
    assert hub.join() is not None


def made(monkeypatch: pytest.MonkeyPatch, program: str) -> Live:
    monkeypatch.setattr(
        live, "SERVE", (sys.executable, "-c", "import sys, time; print('{\"port\": 7}', flush=True);" + program)
    )
    return Live(HEAD, 0)


def running(zero: float | None = None) -> Any:
    """What a companion sees of a run."""
    agents = [SimpleNamespace(robot=r, phase=SimpleNamespace(phase="running", detail="")) for r in HEAD.robots]
    run = SimpleNamespace(
        conduct=SimpleNamespace(now=lambda: 100.0, agents=agents), zero=zero, marks=[],
        scene=SimpleNamespace(watch=SimpleNamespace(too_close={}, collisions={}, bumps={}, min_separation=0.3)),
        fleets=[SimpleNamespace(states=lambda states: states, members=())], agents_of=lambda fleet: agents,
        scenario=SimpleNamespace(robots=HEAD.robots),
    )  # fmt: skip
    run.t = lambda at: None if run.zero is None else at - run.zero
    return run


STATES = [BodyState((float(k), 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 0.0) for k in range(2)]


def test_a_view_that_takes_nothing_does_not_hold_up_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    view = made(monkeypatch, "time.sleep(60)")  # as long as one step would take; a busy host takes seconds
    monkeypatch.setattr(live, "SEND_EVERY", 0.0)
    monkeypatch.setattr(live, "MOST_PENDING", 100_000)
    run = running(0.0)
    view.launched(run)
    longest = 0.0
    for k in range(60_000):
        begun = time.monotonic()
        view.step(k / 240, STATES)
        longest = max(longest, time.monotonic() - begun)
    assert longest < 20.0 and len(view._pending) < 110_000
    view._process.kill()
    view.close("over")


def test_a_view_that_has_gone_does_not_hold_up_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    view = made(monkeypatch, "")
    view._process.wait(10)
    view.launched(running(0.0))
    for k in range(100):
        view.step(k / 240, STATES)
    view.end(1.0)
    view.close("over")
    view.close("over")


def test_a_view_that_does_not_begin_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "SERVE", (sys.executable, "-c", 'print(\'{"error": "Address already in use"}\')'))
    with pytest.raises(OSError, match="port 80: Address already in use"):
        Live(HEAD, 80)


def test_all_that_happened_since_round_1_is_told_with_times_since_then(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    out = tmp_path / "told"
    view = made(monkeypatch, f"open({str(out)!r}, 'wb').write(sys.stdin.buffer.read())")
    run = running()
    view.launched(run)
    view.heard(run.conduct.agents[1], [InitRecord(time=101.9), Round(1, "Go", time=102.0)])
    view.step(102.0, STATES)
    run.zero = 102.0
    for k in range(12):
        view.step(103.0 + k / 240, STATES)
    run.marks.append(Violation(103.5, "property", ("bert",), "x"))
    run.scene.watch.bumps[0, 4] = 103.2
    view.end(104.0)
    view.close("bye")
    told = [json.loads(line) for line in out.read_bytes().splitlines()]
    kinds = [next(iter(each)) for each in told]
    after = told[kinds.index("begin") :]
    assert kinds[0] == "header" and after[-1] == {"over": "bye"}
    rows: dict[str, list[Any]] = {}
    for each in after:
        for table, more in each.get("rows", {}).items():
            rows.setdefault(table, []).extend(more)
    assert rows["rounds"] == [[1, 0.0, 0.0, 1, 0, "Go"]]
    assert [row[1] for row in rows["poses"]] == [1.046, 1.046] and [row[1] for row in rows["phases"]] == [0.0, 0.0]
    assert [[row[0], row[2], row[3]] for row in rows["marks"]] == [
        [1.2, "collision", ["alice"]], [1.5, "property", ["bert"]],
    ]  # fmt: skip


def test_a_paced_run_waits_for_the_host() -> None:
    paced = PaceLimit(4.0)
    paced.launched(running())
    begun = time.monotonic()
    for k in range(48):
        paced.step(100.0 + k / 240, [])
    assert 0.04 < time.monotonic() - begun < 5.0  # 0.2 s of the world, on a host that may be busy


@contextmanager
def watched(tmp_path: Path, *more: str) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """A run of two trivial agents with a live view; its port."""
    root = bundle(tmp_path / "sim", ["good", "good"])
    command = [sys.executable, str(FLEET), str(root), "--duration", "3", "--quiet", "--out", str(tmp_path / "out")]
    process = subprocess.Popen(
        [*command, "--live", "0", *more], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stderr is not None
    try:
        found = re.fullmatch(r"live: http://127\.0\.0\.1:(\d+)/\n", process.stderr.readline())
        assert found is not None
        yield process, int(found[1])
        process.communicate(timeout=60)
    finally:
        process.kill()
        process.wait()


def asked(port: int, path: str, method: str = "GET", **headers: str) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    connection.request(method, path, headers=headers)
    return connection.getresponse()


def test_a_run_can_be_watched_from_this_computer_and_from_no_other_site(tmp_path: Path) -> None:
    with watched(tmp_path) as (process, port):
        page = asked(port, "/")
        text = page.read().decode()
        assert page.status == 200 and "default-src 'none'" in text and "line<form>" not in text
        for host in ("evil.example", f"evil.example:{port}", "127.0.0.1", f"127.0.0.1:{port + 1}", ""):
            assert asked(port, "/", Host=host).status == 403
            assert asked(port, "/events", Host=host).status == 403
        assert asked(port, "/", Host=f"localhost:{port}").status == 200
        assert asked(port, "/etc/passwd").status == 404
        for method in ("PUT", "DELETE", "OPTIONS", "HEAD"):
            assert asked(port, "/", method).status == 501
        idle = socket.create_connection(("127.0.0.1", port))  # says nothing, ever
        stream = asked(port, "/events")
        seen: dict[str, Any] = {}
        for line in stream:
            if line.startswith(b"event: "):
                name = line.split()[1].decode()
            elif line.startswith(b"data: "):
                seen.setdefault(name, []).append(json.loads(line[6:]))
        idle.close()
        assert next(iter(seen)) == "whole" and any("poses" in chunk for chunk in seen["rows"])
        assert (
            "held" in seen["over"][-1]["words"] and str(tmp_path / "out" / "report.html") in seen["over"][-1]["words"]
        )
    assert process.returncode == 0
    with pytest.raises(OSError):
        asked(port, "/")


def test_a_port_that_is_taken_is_told_before_anything_runs(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        root = bundle(tmp_path / "sim", ["good"])
        earlier = tmp_path / "out" / "trace.jsonl"
        earlier.parent.mkdir()
        earlier.touch()
        (tmp_path / "out" / MARKER).touch()
        command = [sys.executable, str(FLEET), str(root), "--out", str(tmp_path / "out"), "--live", str(port)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 5 and f"port {port}: Address already in use; name another port" in done.stderr
    assert earlier.exists(), "what an earlier run left is lost to nothing that never ran"


def test_the_views_process_knows_nothing_of_pybullet_or_matplotlib() -> None:
    code = f"import sys; import {serve.__name__}; sys.exit(any(m in sys.modules for m in ('pybullet', 'matplotlib')))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_watching_a_run_in_lockstep_changes_nothing_in_its_trace(tmp_path: Path) -> None:
    mapping = built(tmp_path, "mapping")
    assert (
        ran(mapping, tmp_path / "alone", 1.0) == ran(mapping, tmp_path / "watched", 1.0, "--live", "--pace", "5") == 0
    )
    assert digest(tmp_path / "alone") == digest(tmp_path / "watched")
