"""The controls of a live run: which requests are obeyed, what a run does with a command, and the page's buttons."""

from __future__ import annotations

import http.client
import json
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from koordgen.runtime.values.obstacles import Sphere
from koordgen.runtime.values.points import Point
from targets.sim.base.folder import GIVEN
from targets.sim.base.schedule import read
from targets.sim.run import faults
from targets.sim.view.web.control import FOLLOWING, REAL_TIME, Control, ManualFaults
from targets.sim.view.web.guard import HEADER, MOST_BYTES
from targets.sim.view.web.live import PaceLimit
from targets.sim.view.web.serve import EventHub, Server
from tests.sim.lockstep.lockstep import built, digest, ran, summary
from tests.sim.run.test_faults import ROBOTS, ZERO, FakeRun
from tests.sim.view.browser import CHROMIUM, Browser
from tests.sim.view.canned import header
from tests.sim.view.test_live import asked, watched
from tests.sim.view.test_stream import Client

HEAD = header(["alice", "bert"])
PAUSE = b'{"do": "pause"}'


class Served:
    """A page's server in this process, and what it passed on."""

    def __init__(self, offer: dict[str, Any] | None) -> None:
        self.obeyed: list[dict[str, Any]] = []
        self.takes = True
        self.server = Server(0, EventHub(HEAD), offer, self._obey)
        self.port = self.server.server_address[1]
        threading.Thread(target=self.server.serve_forever, args=(0.01,), daemon=True).start()

    def _obey(self, command: dict[str, Any]) -> bool:
        self.obeyed.append(command)
        return self.takes

    def post(self, body: bytes = PAUSE, path: str = "/control", **changes: str | None) -> int:
        """The status of a request that is as the page's but for some headers; None leaves one out."""
        assert self.server.guard is not None
        usual = {"Host": f"127.0.0.1:{self.port}", "Content-Type": "application/json", HEADER: self.server.guard.token}
        named = {name.replace("_", "-"): value for name, value in changes.items()}
        headers = {key: value for key, value in {**usual, **named}.items() if value is not None}
        return posted(self.port, path, body, headers)


def posted(port: int, path: str, body: bytes, headers: dict[str, str]) -> int:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    try:
        connection.request("POST", path, body, headers)
        return connection.getresponse().status
    finally:
        connection.close()


@pytest.fixture
def served() -> Iterator[Served]:
    made = Served({"lockstep": True, "faults": True})
    yield made
    made.server.shutdown()
    made.server.server_close()


def test_a_command_of_the_page_is_obeyed(served: Served) -> None:
    text = asked(served.port, "/").read().decode()
    (token,) = re.findall(r'"token":"([\w-]{40,})"', text)
    assert served.server.guard is not None and token == served.server.guard.token
    assert served.post() == served.post(Origin=f"http://localhost:{served.port}") == 204
    assert served.obeyed == [{"do": "pause"}] * 2
    served.takes = False
    assert served.post() == 503


@pytest.mark.parametrize(
    ("status", "body", "changes"),
    [
        (403, PAUSE, {HEADER: None}), (403, PAUSE, {HEADER: "x" * 43}), (403, PAUSE, {HEADER: "é"}),
        (403, PAUSE, {"Host": "evil.example"}), (403, PAUSE, {"Host": "127.0.0.1:1"}),
        (403, PAUSE, {"Origin": "https://evil.example"}), (403, PAUSE, {"Origin": "null"}),
        (415, PAUSE, {"Content_Type": None}), (415, PAUSE, {"Content_Type": "text/plain"}),
        (415, PAUSE, {"Content_Type": "application/x-www-form-urlencoded"}),
        (413, b"", {}), (413, PAUSE, {"Content_Length": str(MOST_BYTES + 1)}),
        (413, PAUSE, {"Content_Length": "9" * 5000}), (413, PAUSE, {"Content_Length": "-1"}),
        (415, PAUSE, {"Transfer_Encoding": "chunked"}),
        (400, b"not JSON", {}), (400, b"[1]", {}), (400, b"\xff\xfe", {}), (400, b"[" * MOST_BYTES, {}),
        (404, PAUSE, {"path": "/"}), (404, PAUSE, {"path": "/control/../control"}),
    ],
)  # fmt: skip
def test_any_other_request_is_refused_and_changes_nothing(
    served: Served, status: int, body: bytes, changes: dict[str, Any]
) -> None:
    assert served.post(body, **changes) == status
    assert served.obeyed == [] and served.post() == 204


def test_a_page_without_controls_has_no_token_and_takes_no_command() -> None:
    made = Served(None)
    text = asked(made.port, "/").read().decode()
    assert '"control":null' in text and "run-pause" not in text
    assert posted(made.port, "/control", PAUSE, {HEADER: "", "Content-Type": "application/json"}) == 404
    made.server.shutdown()
    made.server.server_close()
    assert made.obeyed == []


class Page:
    """What a control sees of the live view: commands that wait, and what was reported."""

    def __init__(self) -> None:
        self.waiting: list[list[Any]] = []
        self.told: list[tuple[bool, str, bool]] = []
        self.is_closed = False

    def commands(self, wait: float = 0.0) -> list[Any]:
        if wait and not self.waiting:
            self.is_closed = True  # a test that would wait for ever
        return self.waiting.pop(0) if self.waiting else []

    def report(self, state: dict[str, Any]) -> None:
        self.told.append((state["paused"], state["message"], state["bad"]))

    def show(self, at: float, states: list[Any]) -> None: ...


class Controlled(FakeRun):
    """A run of three robots whose control gets one command at each step, of 0.25 s."""

    def __init__(self, tmp_path: Path, lockstep: bool = True, scenario: Any = None, follows: bool = False) -> None:
        super().__init__()
        self.interrupted = False
        self.page = Page()
        self.file = tmp_path / GIVEN
        self.scenario.delta = 0.5
        self.scenario.obstacles = [Sphere(Point(), 1.0)]
        self.scenario.robots = [
            SimpleNamespace(name=name, external=False, settings={}, sim=SimpleNamespace(fidelity="full"))
            for name in ROBOTS
        ]
        schedule, _ = read(scenario or {}, ROBOTS)
        given = None if follows else ManualFaults(faults.Faults(schedule, open=True), scenario, tmp_path)
        page: Any = self.page
        run: Any = self
        self.control = Control(page, given, PaceLimit(None) if lockstep else None)
        self.control.launched(run)
        self.zero = self.now = ZERO

    def does(self, *commands: Any) -> list[tuple[str, bool]]:
        """What was said of commands, one at a step."""
        del self.page.told[:]
        for command in commands:
            self.page.waiting.append([command])
            self.control.step(self.now, [])
            self.now += 0.25
        return [(message, bad) for _, message, bad in self.page.told if message]

    def gives(self, **event: Any) -> list[tuple[str, bool]]:
        return self.does({"do": "fault", "event": event})


def test_faults_by_hand_happen_now_and_are_a_scenario(tmp_path: Path) -> None:
    scenario = {"network": {"loss": 0.1}, "events": [{"at": 60, "crash": "cem"}]}
    run = Controlled(tmp_path, lockstep=False, scenario=scenario)
    assert run.gives(crash="ann") == [("crash ann, at 0.00 s", False)]
    run.gives(**{"for": 2}, cut=["bob", "cem"])
    run.gives(wind={"mean": [1, 0, 1e-5]})
    assert [(t, what[0]) for t, what in run.done[1:]] == [(0.0, "crash"), (0.25, "disturb"), (0.5, "blow")]
    assert [cause.what for cause in run.marks] == ["network", "crash", "cut", "wind"]
    assert faults.load(run.file, ROBOTS)[1] == {
        "network": {"loss": 0.1},
        "events": [
            {"at": 60, "crash": "cem"}, {"at": 0.0, "crash": "ann"}, {"at": 0.25, "for": 2, "cut": ["bob", "cem"]},
            {"at": 0.5, "wind": {"mean": [1, 0, 1e-5]}},
        ],
    }  # fmt: skip


@pytest.mark.parametrize(
    ("event", "said"),
    [
        ({"crash": "zoe"}, "no robot 'zoe' in this fleet (there are: ann, bob, cem)"),
        ({"crush": "ann"}, "did you mean 'crash'"),
        ({"crash": "ann", "at": 3}, "without `at`, because it begins now"),
        ({"continue": "ann"}, "ann is not frozen"),
        ({"restore": ["ann", "bob"]}, "the link between ann and bob is not cut"),
        ({"obstacle": {"number": 4, "by": [1, 0, 0]}}, "there is no obstacle 4 (they are numbered 0 to 0)"),
        (
            {"crash": "cem"},
            "at 1 s, begins while this fault (0 s for good) lasts (a restart ends a crash)",
        ),
        ({"wind": {"mean": ["1", 0, 0]}}, "must be a finite number"),
        ([], "a fault is an event of a scenario file"),
    ],
)
def test_a_fault_that_cannot_be_is_told_and_changes_nothing(tmp_path: Path, event: Any, said: str) -> None:
    run = Controlled(tmp_path, scenario={"events": [{"at": 1, "crash": "cem"}]})
    before = list(run.done)
    ((message, bad),) = run.does({"do": "fault", "event": event})
    assert bad and said in message
    assert run.done == before and not run.marks and not run.file.exists()


def test_no_faults_before_round_1_after_the_mission_or_along_a_counterexample(tmp_path: Path) -> None:
    run = Controlled(tmp_path)
    run.zero = None
    assert run.gives(crash="ann") == [("faults can be injected only after round 1 has begun", True)]
    run.zero = ZERO
    run.conduct.agents[0].asked_to_end = True
    assert run.gives(crash="ann") == [("the mission is over", True)]
    assert Controlled(tmp_path, follows=True).gives(crash="ann") == [(FOLLOWING, True)]


def test_pauses_are_refused_in_real_time_and_what_is_unknown_always(tmp_path: Path) -> None:
    real = Controlled(tmp_path, lockstep=False)
    assert real.does({"do": "pause"}, {"do": "speed", "factor": 2}) == [
        (f"pause: {REAL_TIME}", True), (f"speed: {REAL_TIME}", True),
    ]  # fmt: skip
    run = Controlled(tmp_path)
    found = run.does({"do": "land"}, {}, {"do": "speed", "factor": 0}, {"do": "speed", "factor": True})
    assert [bad for _, bad in found] == [True] * 4 and "there are: pause, go, step, speed, fault" in found[0][0]


def test_a_pause_takes_faults_and_ends_at_the_next_round_after_a_step(tmp_path: Path) -> None:
    run = Controlled(tmp_path)
    crash = {"do": "fault", "event": {"crash": "ann"}}
    run.page.waiting = [[{"do": "pause"}], [crash], [], [{"do": "step"}]]
    run.control.step(run.now, [])
    assert run.done[1:] == [(0.0, ("crash", "ann"))] and not run.page.waiting
    assert [paused for paused, _, _ in run.page.told[-2:]] == [False, False]
    run.now += 0.25
    run.control.step(run.now, [])
    assert not run.page.is_closed
    run.now += 0.25
    run.page.waiting = [[], [{"do": "go"}]]
    run.control.step(run.now, [])  # the round is over
    assert any(paused for paused, _, _ in run.page.told[-3:]) and not run.page.waiting and not run.page.is_closed


def test_a_pause_ends_with_the_pages_server_and_with_the_run(tmp_path: Path) -> None:
    run = Controlled(tmp_path)
    run.does({"do": "pause"})
    assert run.page.is_closed, "the run goes on when nobody can tell it to"
    run.page.is_closed, run.interrupted = False, True
    run.does({"do": "pause"})
    assert not run.page.is_closed


@pytest.mark.slow
def test_faults_by_hand_in_real_time_beside_a_stream(tmp_path: Path) -> None:
    with watched(tmp_path, "--duration", "2", "--no-report", "--foxglove", "0") as (process, port):
        assert process.stderr is not None
        url = re.fullmatch(r"foxglove: ws://127\.0\.0\.1:(\d+)\n", process.stderr.readline())
        assert url is not None
        with Client(int(url[1])) as client:
            client.until("/tf")
            assert client.next()[2]["child_frame_id"] in ("r0", "r1")
        (token,) = re.findall(r'"token":"([\w-]+)"', asked(port, "/").read().decode())
        headers = {HEADER: token, "Content-Type": "application/json"}
        said: list[str] = []
        sent = [{"do": "pause"}, *({"do": "fault", "event": event} for event in ({"crash": "r1"}, {"freeze": "r0"}))]
        for line in asked(port, "/events"):
            if line.startswith(b"event: "):
                name = line.split()[1]
            elif line.startswith(b"data: ") and name == b"control":
                said += filter(None, [json.loads(line[6:])["message"]])
            elif line.startswith(b"data: ") and name == b"rows" and b'"rounds"' in line:
                while sent:
                    assert posted(port, "/control", json.dumps(sent.pop(0)).encode(), headers) == 204
    assert process.returncode == 0, "a freeze without an end ends with the mission"
    assert said[0] == f"pause: {REAL_TIME}" and said[1].startswith("crash r1, at ")
    causes = summary(tmp_path / "out")["causes"]
    assert [(cause["what"], cause["robots"]) for cause in causes] == [("crash", ["r1"]), ("freeze", ["r0"])]
    assert f"--scenario {tmp_path / 'out' / GIVEN}" in summary(tmp_path / "out")["reproduce"]["faults by hand"]


@pytest.mark.skipif(CHROMIUM is None, reason="no browser: on Debian, apt install chromium")
def test_a_run_is_paused_stepped_and_disturbed_from_its_page_and_repeats_itself(tmp_path: Path) -> None:
    mapping, out = built(tmp_path, "mapping"), tmp_path / "out"
    command = [sys.executable, str(mapping), "--lockstep", "--duration", "3", "--quiet", "--no-report"]
    process = subprocess.Popen(
        [*command, "--out", str(out), "--live", "0", "--pace", "1"], stderr=subprocess.PIPE, stdout=subprocess.PIPE,
        text=True,
    )  # fmt: skip
    try:
        assert process.stderr is not None
        found = re.search(r":(\d+)/$", process.stderr.readline().strip())
        assert found is not None
        with Browser(tmp_path / "profile") as page:
            page.open(f"http://127.0.0.1:{found[1]}/")
            page.wait("model.robots[0].rounds.length", bool)
            shown = "document.getElementById('time').textContent"
            press = "document.getElementById('{}').click()".format
            page.value(press("run-pause"))
            page.wait("document.getElementById('run-said').textContent", lambda said: said == "paused")
            assert page.text("run-pause") == "go on"
            stood = page.value("model.last")
            page.wait(shown, lambda said: said == f"{stood:.2f} s")
            before = stood
            for _ in range(2):
                page.value(press("run-step"))
                after = page.wait(f"run.paused && model.last > {before} && model.last", bool)
                page.wait(shown, lambda said, after=after: said == f"{after:.2f} s")  # type: ignore[misc]
                last, before = before, after
            assert after - last == pytest.approx(0.2, abs=0.01), "a round"
            page.value(press("fault-crash"))
            page.wait("document.getElementById('marks').innerText", lambda said: "crash\talice" in said)
            page.value(press("fault-obstacle"))
            page.wait("model.moved.length", bool)
            page.value(press("fault-continue"))
            page.wait("document.getElementById('run-said').className", lambda kind: kind == "bad")
            assert page.text("run-said") == "alice does not run"
            assert page.value("model.last") == after, "all that takes no time"
            page.value("document.getElementById('run-speed').value = ''")
            page.value("document.getElementById('run-speed').onchange()")
            page.value(press("run-pause"))
            page.wait("document.getElementById('status').textContent", lambda said: "held" in said)
            assert page.value("document.getElementById('run-pause').disabled") and page.complaints == []
        process.communicate(timeout=60)
    finally:
        process.kill()
        process.communicate()
    causes = summary(out)["causes"]
    assert [(cause["what"], cause["robots"]) for cause in causes] == [("crash", ["alice"]), ("obstacle", [])]
    assert all(cause["t"] == pytest.approx(after, abs=0.005) for cause in causes)
    assert "crash (alice)" in (out / "summary.txt").read_text()
    assert ran(mapping, tmp_path / "again", 3.0, "--scenario", str(out / GIVEN)) == process.returncode == 0
    assert digest(tmp_path / "again") == digest(out)
