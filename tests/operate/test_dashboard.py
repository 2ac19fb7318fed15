"""`koordgen dashboard` beside stand-ins with real control ports: the page in a browser, freshness, access, the stop."""

from __future__ import annotations

import http.client
import json
import math
import signal
import socket
import ssl
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from benchmarks.fixtures.fleet import KEY
from koordgen.cli import main
from koordgen.operate.dashboard import EVERY, WITHIN, Poller, built_facts
from koordgen.operate.dashboard_access import AccessRefused, access, read_token
from koordgen.operate.estop import Contact, StoppableFleet, find_fleet
from targets.sim.view.foxglove.stream import FoxgloveServer
from targets.sim.view.web.dashboard import TICK, Dashboard, FleetServer, first_header
from targets.sim.view.web.fleet_rows import FRESH
from tests.operate.stand_ins import StandIns
from tests.sim.view.browser import CHROMIUM, Browser
from tests.sim.view.test_stream import Client

ROOT = Path(__file__).parents[2]
STOPPED = "[...document.querySelectorAll('#stopped li')].map((row) => row.innerText)"
TABLE = "[...document.querySelectorAll('#robots tr')].map((row) => [...row.cells].map((cell) => cell.innerText.trim()))"
INK = (  # how many different colours the map has
    "(() => { const { width, height } = $('top'), shown = $('top').getContext('2d').getImageData(0, 0, width, height);"
    " return new Set(new Uint32Array(shown.data.buffer)).size; })()"
)


def until(good: Callable[[], Any]) -> Any:
    limit = time.monotonic() + 60
    while not (found := good()):
        assert time.monotonic() < limit
        time.sleep(0.02)
    return found


@contextmanager
def command(fleet: Path, *options: str) -> Iterator[str]:
    """The command's process; the page's address."""
    line = [sys.executable, "-m", "koordgen", "dashboard", str(fleet), "--no-browser", "--port", "0", *options]
    process = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=fleet.parent)
    try:
        assert process.stdout is not None
        first = process.stdout.readline()
        assert first.startswith("dashboard: http"), process.stderr and process.stderr.read()
        yield first.split()[1]
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=30)
        assert process.returncode == 130 and "interrupted" in said and "Traceback" not in said
    finally:
        process.kill()
        process.communicate()


def opened(browser: Browser, url: str) -> None:
    """Show the page once the reports have completed its header, so that it need not be loaded anew."""
    until(lambda: b'"kind":"allread"' in urllib.request.urlopen(url, timeout=20).read())
    browser.open(url)


def press(browser: Browser, *, release: bool) -> None:
    """The mouse button down on the stop button; and up again at once, or not."""
    at = browser.value("(() => { const box = $('stop').getBoundingClientRect(); return [box.x + 9, box.y + 9]; })()")
    for kind in ("mousePressed", "mouseReleased")[: 1 + release]:
        browser.mouse(kind, *at)


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
def test_the_page_shows_every_robot_and_stops_them_when_the_button_is_held(tmp_path: Path) -> None:
    with StandIns(tmp_path, 3) as fleet, Browser(tmp_path / "profile") as browser:
        fleet.robots[1].changes |= {"release": "b" * 32, "battery": 0.12}
        with command(fleet.fleet) as url:
            opened(browser, url)
            browser.wait("fleet && fleet.robots.every((robot) => robot.phase)", bool)
            assert browser.value("$('stop')") is None, "read-only without --control"
        with command(fleet.fleet, "--control") as url:
            opened(browser, url)
            browser.wait(
                "fleet && fleet.robots.every((robot) => robot.phase) && $('lines').rows.length > 2",
                bool,
            )
            rows = browser.value(TABLE)
            assert [row[:2] for row in rows] == [[f"robot{pid:02}", "running"] for pid in range(3)]
            assert [row[5] for row in rows] == ["aaaaaaaa", "bbbbbbbb differs", "aaaaaaaa"] and rows[1][4] == "12 %"
            assert browser.value("model.robots.every((robot) => robot.t.length)") and browser.value(INK) > 20
            said = browser.text("summary")
            assert "another release: robot01" in said and "battery low: robot01" in said and "silent" not in said
            assert browser.value("model.header.obstacles.length") == 1, "of the fleet file"
            assert browser.value("document.querySelector('meta[name=viewport]').content").startswith(
                "width=device-width"
            )

            fleet.robots[2].deaf = True
            browser.wait("$('summary').innerText", lambda text: "silent: robot02" in text)
            old = browser.wait(TABLE, lambda rows: float(rows[2][2]) > FRESH and "no answer" in rows[2][3])
            assert old[2][:2] == ["robot02", "silent (was running)"]
            assert browser.value("model.robots[2].silent") and browser.value("model.robots[2].t.length") > 0

            press(browser, release=True)
            browser.value("window.before = fleet.t")
            browser.wait("fleet.t - window.before", lambda seconds: seconds > 1.5)
            assert browser.value("$('stopped').innerText") == "" and not any(r.stopped for r in fleet.robots)
            press(browser, release=False)
            answers = browser.wait(STOPPED, bool)
            assert [robot.stopped for robot in fleet.robots] == [True, True, False]
            assert "STOP IT BY HAND" in answers[0] and "robot00 is stopping" in answers[1]
            assert "1 of 3 robots did NOT answer" in browser.text("stopped")
            browser.wait("fleet.robots.map((robot) => robot.phase)", lambda found: found[:2] == ["stopping"] * 2)
        browser.wait("$('summary').innerText", lambda text: "no connection to the dashboard" in text)
        assert not browser.complaints


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
def test_the_page_has_a_row_for_each_application_if_there_are_several(tmp_path: Path) -> None:
    with StandIns(tmp_path, 2) as fleet, command(fleet.fleet) as url, Browser(tmp_path / "profile") as browser:
        opened(browser, url)
        assert browser.value("$('parts').hidden")
        map_ = {"name": "map", "pid": 0, "members": [0], "stopped": True, "event": "End", "event_round": 7}
        task = {"name": "task", "pid": 1, "members": [1, 0], "fault": "task.koord:3: late", "counts": {"faults": 2}}
        fleet.robots[0].changes["applications"] = [map_ | {"round": 9, "fault": "", "counts": {}}, task]
        text = browser.wait("$('applications').innerText", lambda text: "task" in text)
        assert [line.split("\t") for line in text.splitlines()] == [
            ["robot00", "map", "0 of 1", "9", "End (round 7)", "0", "stopped"],
            ["robot00", "task", "1 of 2", "0", "none yet", "2", "holds: task.koord:3: late"],
        ]
        assert not browser.value("$('parts').hidden") and not browser.complaints


def test_what_is_shown_of_20_robots_is_never_more_than_a_question_old(tmp_path: Path) -> None:
    assert EVERY + WITHIN + TICK < 1.0, "seconds from a report until the next one is shown, at most"
    with StandIns(tmp_path, 20) as fleet:
        found = find_fleet(fleet.fleet, pytest.fail)
        poller = Poller(contacts(found), lambda pid, asked: board.on_answer(pid, asked.report, asked.note))
        board = Dashboard(first_header([(place.name, "") for place in found.places], {}), lambda: poller.odd)
        client = board.hub.join()
        assert client is not None
        poller.start()
        behind = 0
        for _ in range(40):
            board.tick()
            made = [robot.reports for robot in fleet.robots]
            robots = board._rows.table()
            behind = max(behind, *(m - r.get("round", 0) for m, r in zip(made, robots, strict=True)))
            time.sleep(0.02)
        until(lambda: min(r["answers"] for r in board._rows.table()) >= 4)
        poller.close()
        robots = board._rows.table()
        assert behind <= 1, "each report is shown before the next one is asked for"
        assert max(r["questions"] - r["answers"] for r in robots) <= 1
        size = len(json.dumps(fleet.robots[0].report()))
        assert size < 8000, f"a report has {size} bytes"


def test_the_same_goes_to_foxglove(tmp_path: Path) -> None:
    with StandIns(tmp_path, 2) as fleet:
        found = find_fleet(fleet.fleet, pytest.fail)
        poller = Poller(contacts(found), lambda pid, asked: board.on_answer(pid, asked.report, asked.note))
        header = first_header([(place.name, "quad") for place in found.places], {})
        server = FoxgloveServer(header, 0)
        board = Dashboard(header, lambda: poller.odd, server)
        poller.start()
        until(lambda: all(r.get("answers", 0) >= 2 for r in board._rows.table()))
        board.tick()
        with Client(int(server.url.rpartition(":")[2])) as client:
            client.until("/scene", "/shared/at", "/tf", "/log")
            standing = client.next()[2]["entities"]  # the geofence is known from reports alone
            assert {"geofence", "robot robot00", "robot robot01"} <= {entity["id"] for entity in standing}
            threading.Thread(target=board.run, daemon=True).start()
            seen: dict[str, Any] = {}
            while "/tf" not in seen:
                topic, at, what = client.next()
                seen[topic] = what
                assert abs(at - time.time()) < 3600
            assert abs(math.hypot(*(seen["/tf"]["translation"][axis] for axis in "xy")) - 4.0) < 0.01
        poller.close()
        board.close()


def contacts(found: StoppableFleet) -> list[Contact]:
    return [Contact(place, place.name, found.application, KEY) for place in found.places]


def counted(stops: list[int]) -> list[dict[str, Any]]:
    """An emergency stop of nobody, which is noted."""
    stops.append(1)
    return []


@contextmanager
def served(host: str, tls: ssl.SSLContext | None, token: str, stop: Any) -> Iterator[FleetServer]:
    board = Dashboard(first_header([("alice", "quad")], {}), frozenset)
    with FleetServer(host, 0, board, stop, token, tls) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def asked(
    server: FleetServer, method: str, path: str, body: str = "", tls: ssl.SSLContext | None = None,
    headers: Mapping[str, str] = {},
) -> http.client.HTTPResponse:  # fmt: skip
    port = server.server_address[1]
    connection = (
        http.client.HTTPConnection("127.0.0.1", port, timeout=20)
        if tls is None
        else http.client.HTTPSConnection("127.0.0.1", port, timeout=20, context=tls)
    )
    connection.request(method, path, body or None, dict(headers))
    return connection.getresponse()


def test_only_the_page_itself_can_stop_the_fleet() -> None:
    stops: list[int] = []
    order = '{"do": "stop"}'
    with served("127.0.0.1", None, "", lambda: counted(stops)) as server:
        other = {"Host": f"evil.example:{server.server_address[1]}"}
        page = asked(server, "GET", "/").read().decode()
        assert server.guard is not None and server.guard.token in page
        right = {"Content-Type": "application/json", "X-Koordgen-Token": server.guard.token}
        assert asked(server, "GET", "/", headers=other).status == 403
        assert asked(server, "POST", "/control", order, headers={"Content-Type": "application/json"}).status == 403
        assert asked(server, "POST", "/control", order, headers=right | {"X-Koordgen-Token": "x" * 43}).status == 403
        assert asked(server, "POST", "/control", order, headers=right | {"Origin": "http://evil.example"}).status == 403
        assert asked(server, "POST", "/control", order, headers=right | other).status == 403
        assert asked(server, "POST", "/control", '{"do": "go"}', headers=right).status == 400
        assert asked(server, "POST", "/login", "token=x").status == 404 and stops == []
        assert asked(server, "POST", "/control", order, headers=right).status == 200 and stops == [1]
    with served("127.0.0.1", None, "", None) as server:
        assert asked(server, "POST", "/control", order, headers=right).status == 404 and stops == [1]
        assert 'id="stop"' not in asked(server, "GET", "/").read().decode()


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    folder = tmp_path_factory.mktemp("tls")
    cert, key = str(folder / "cert.pem"), str(folder / "key.pem")
    line = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    line += ["-subj", "/CN=localhost", "-addext", "subjectAltName=IP:127.0.0.1", "-keyout", key, "-out", cert]
    subprocess.run(line, check=True, capture_output=True)
    return cert, key


def test_at_another_address_a_browser_sends_the_token_once_over_tls(
    certificate: tuple[str, str], tmp_path: Path
) -> None:
    cert, key = certificate
    allowed = access("0.0.0.0", 8470, cert, key, str(tmp_path / "token"))
    stops: list[int] = []
    trust = ssl.create_default_context(cafile=cert)
    with served(allowed.host, allowed.tls, allowed.token, lambda: counted(stops)) as server:
        assert server.url.startswith("https://")
        login = asked(server, "GET", "/", tls=trust)
        text = login.read().decode()
        assert login.status == 401 and "Token" in text and "alice" not in text
        assert asked(server, "GET", "/events", tls=trust).status == 403
        wrong = asked(server, "POST", "/login", "token=" + "x" * 43, tls=trust)
        assert wrong.status == 401 and wrong.getheader("Set-Cookie") is None
        assert asked(server, "POST", "/login", "x" * 1100, tls=trust).status == 413
        done = asked(server, "POST", "/login", f"token={allowed.token}", tls=trust)
        cookie = done.getheader("Set-Cookie", "")
        assert done.status == 303 and allowed.token not in cookie
        assert {"HttpOnly", "SameSite=Strict", "Secure"} <= set(cookie.split("; "))
        own = cookie.split(";")[0]
        page = asked(server, "GET", "/", tls=trust, headers={"Cookie": own})
        assert page.status == 200 and "alice" in page.read().decode()
        assert asked(server, "GET", "/", tls=trust, headers={"Cookie": "koordgen-dashboard=\xe4"}).status == 401
        assert server.guard is not None
        right = {"Content-Type": "application/json", "X-Koordgen-Token": server.guard.token}
        order = '{"do": "stop"}'
        assert asked(server, "POST", "/control", order, tls=trust, headers=right).status == 403
        foreign = right | {"Cookie": own, "Origin": "https://evil.example"}
        assert asked(server, "POST", "/control", order, tls=trust, headers=foreign).status == 403 and stops == []
        known = right | {"Cookie": own}
        assert asked(server, "POST", "/control", order, tls=trust, headers=known).status == 200 and stops == [1]
        with pytest.raises((http.client.HTTPException, OSError)):
            asked(server, "GET", "/")  # plain HTTP


@pytest.mark.parametrize("bind", ["0.0.0.0", "192.168.1.5", "::", "robot-base.local"])
def test_another_address_is_refused_without_token_and_tls(bind: str, certificate: tuple[str, str]) -> None:
    with pytest.raises(AccessRefused, match="--tls-cert, --tls-key, --token missing") as refused:
        access(bind, 8470, None, None, None)
    assert refused.value.usage and "ssh -L 8470:127.0.0.1:8470" in refused.value.help
    with pytest.raises(AccessRefused, match="; --token missing"):
        access(bind, 8470, *certificate, None)


def test_a_token_is_made_for_its_owner_alone_and_read_again(tmp_path: Path) -> None:
    path = tmp_path / "token"
    token = read_token(path)
    assert read_token(path) == token and len(token) >= 32 and path.stat().st_mode & 0o777 == 0o600
    path.chmod(0o640)
    with pytest.raises(AccessRefused, match="mode 0640"):
        read_token(path)
    for text in ("short", "", "with a space in it, but otherwise long enough", "\x01" * 50, "ä" * 40):
        path.unlink()
        path.write_text(text)
        path.chmod(0o600)
        with pytest.raises(AccessRefused, match="holds no token"):
            read_token(path)
    with pytest.raises(AccessRefused):
        read_token(tmp_path)
    with pytest.raises(AccessRefused):
        read_token(tmp_path / "no" / "token")


def test_wrong_options_start_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fleet = StandIns(tmp_path, 1)
    for robot in fleet.robots:
        robot.control.close()
    line = ["dashboard", str(fleet.fleet), "--no-browser"]
    assert main([*line, "--bind", "0.0.0.0"]) == 2 and "ssh -L" in capsys.readouterr().err
    assert main([*line, "--tls-cert", "x"]) == 2
    assert main([*line, "--tls-cert", "x", "--tls-key", "y"]) == 5
    assert main([*line, "--token", str(tmp_path)]) == 5
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert main([*line, "--port", str(port)]) == 5 and "--port" in capsys.readouterr().err


@pytest.mark.parametrize("under", ["", "robots"], ids=["build", "run"])
def test_a_folder_gives_the_robots_in_the_order_of_their_pids(tmp_path: Path, under: str) -> None:
    peers = [
        {"name": name, "host": "127.0.0.1", "port": 47100 + pid} for pid, name in enumerate(("zoe", "adam", "bob"))
    ]
    for pid in (0, 1):
        folder = tmp_path / under / str(peers[pid]["name"])
        folder.mkdir(parents=True)
        settings = {
            "robot": peers[pid]["name"], "pid": pid, "peers": peers, "control": 48100 + pid, "application_id": 0,
            "insecure": True, "key_file": None, "obstacles": [{"shape": "sphere", "centre": [0, 0, 1], "radius": 1}],
        }  # fmt: skip
        (folder / "settings.json").write_text(json.dumps(settings))
    facts = built_facts(find_fleet(tmp_path, pytest.fail), tmp_path)
    assert [(p.name, p.port) for p in facts.fleet.places] == [("zoe", 48100), ("adam", 48101), ("bob", 0)]
    assert len(first_header([(p.name, "") for p in facts.fleet.places], facts.plain).obstacles) == 1


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
def test_a_simulated_fleet_is_seen_and_stopped(tmp_path: Path) -> None:
    """A run in real time, whose agents are those of real robots, with the dashboard beside it."""
    run, example = tmp_path / "run", ROOT / "examples/lineform"
    line = [sys.executable, "-m", "koordgen", "sim", str(example / "lineform.koord")]
    line += ["--fleet", str(example / "fleet.yaml"), "--no-report", "--quiet", "--duration", "600", "--out", str(run)]
    simulated = subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        until(lambda: len(list(run.glob("robots/*/settings.json"))) == 5)
        with Browser(tmp_path / "profile") as browser, command(run, "--control") as url:
            opened(browser, url)
            running = "fleet && fleet.robots.every((robot) => robot.phase === 'running' && robot.round > 20)"
            browser.wait(running, bool)
            browser.wait("model.events", lambda names: "TargetUpdate" in names)
            assert browser.value("model.robots.map((robot) => robot.name)") == ["alice", "bert", "cleo", "dora", "emil"]
            flown = "model.robots.every((robot) => robot.t.length > 5 && Math.abs(robot.x[0]) < 6)"
            assert browser.value(flown) and browser.value("model.header.geofence[0][0]") == -6
            assert browser.value("fleet.robots.map((robot) => robot.battery !== null)") == [
                True,
                False,
                True,
                False,
                True,
            ]
            assert browser.value("model.shared.map(({ name, kind }) => `${name} ${kind}`)") == ["x allread"]
            assert browser.value("fleet.robots.every((robot) => robot.release && !robot.odd)")
            press(browser, release=False)
            answers = browser.wait(STOPPED, bool)
            assert len(answers) == 5 and all("is stopping" in answer for answer in answers)
            browser.wait(
                "model.robots.flatMap((robot) => robot.logs.map((row) => row[3]))",
                lambda lines: "emergency stop" in lines,
            )
            assert not browser.complaints
        simulated.wait(timeout=120)
    finally:
        simulated.kill()
        simulated.wait()
