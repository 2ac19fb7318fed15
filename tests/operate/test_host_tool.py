"""The robot-side tool over its session protocol: two-phase releases, locks, damage, and processes that are killed."""

from __future__ import annotations

import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from threading import Timer
from typing import Any

import pytest

from koordgen.operate.host_tool_archive import archive
from tests.operate.fake_host import KEY, KEY_ID, FakeHost, FakeRelease, digest, refused, send, wait
from tests.runtime.net.transports import free_ports


@pytest.fixture
def host(tmp_path: Path) -> FakeHost:
    return FakeHost(tmp_path)


@pytest.fixture
def ports() -> dict[str, int]:
    return dict(zip(("alice", "bert"), free_ports(2), strict=True))


def test_a_first_release_is_confirmed_and_a_second_one_replaces_it(host: FakeHost, ports: dict[str, int]) -> None:
    first, second = FakeRelease("one", ports), FakeRelease("two", ports)
    with host.session() as session:
        facts = session.call("inspect")
        assert facts["python"] == list(sys.version_info[:3]) and facts["writable"] and facts["free"] > 0
        assert (facts["current"], facts["releases"], facts["locked"], facts["boot"]) == (None, [], None, "boot-1")
        first.put(session)
        assert host.current == first.id
        assert host.deployment == {"confirmed": first.id, "history": [first.id], "pending": None}
        assert second.store(session) == 1  # the other files are here already
        second.put(session)
        facts = session.call("inspect")
        assert facts["current"] == second.id and set(facts["releases"]) == {first.id, second.id}
        assert facts["robots"]["bert"] == {"running": False, "phase": None, "pid": None}
        assert facts["locked"]["owner"] == "anna@laptop" and facts["locked"]["what"] == "deploy"
    assert session.close() == 0
    overlay = json.loads((host.folder / "settings" / second.id / "alice.json").read_text())
    key = host.folder / "keys" / f"{KEY_ID}.key"
    assert key.read_bytes() == KEY and key.stat().st_mode & 0o777 == 0o600
    assert (host.folder / "keys").stat().st_mode & 0o777 == 0o700
    assert overlay == {
        "state": str(host.folder / "state"),
        "trace": str(host.folder / "traces" / "alice" / "trace.jsonl"),
        "key_file": str(key),
    }


def test_the_last_three_releases_stay_and_nothing_that_only_older_ones_used(
    host: FakeHost, ports: dict[str, int]
) -> None:
    made = [FakeRelease(text, ports) for text in "abcd"]
    with host.session() as session:
        for release in made:
            release.put(session)
        kept = [release.id for release in made[1:]]
        assert host.deployment["history"] == kept and session.call("inspect")["releases"] == sorted(kept)
        old = digest(b"TEXT = 'a'\n")
        assert session.call("missing", objects=[*made[3].contents, old])["objects"] == [old]
        assert not (host.folder / "settings" / made[0].id).exists()
        session.call("switch", id=made[1].id, seconds=60)  # a rollback sends nothing
        session.call("prepare", id=made[1].id)
        session.call("confirm", id=made[1].id)
        session.call("confirm", id=made[1].id)
        assert host.deployment["history"] == [*kept[1:], kept[0]] and host.current == kept[0]


def test_an_unconfirmed_release_never_starts_an_agent_and_goes_by_itself(host: FakeHost, ports: dict[str, int]) -> None:
    first, second = FakeRelease("one", ports), FakeRelease("two", ports)
    with host.session() as session:
        first.put(session, "prepare")
        agent = host.launch("alice")
        _, said = agent.communicate()
        assert agent.returncode == 1 and b"waits for its confirmation" in said
        session.call("confirm", id=first.id)
        second.put(session, "switch", seconds=2)
        assert host.current == second.id and host.deployment["pending"]["from"] == first.id
        wait(lambda: host.current == first.id)  # the guardian's doing: the session does nothing
        wait(lambda: host.deployment == {"confirmed": first.id, "history": [first.id], "pending": None})
        for verb in ("prepare", "confirm"):
            assert refused(session.call, verb, id=second.id).code == "expired"
    assert host.runs == []


def test_what_waits_is_gone_after_a_reboot(host: FakeHost, ports: dict[str, int]) -> None:
    with host.session() as session:
        FakeRelease("one", ports).put(session, "prepare", seconds=3000)
    host.reboot()
    agent = host.launch("alice")
    _, said = agent.communicate()
    assert agent.returncode == 1 and b"no release was confirmed" in said
    assert host.current is None and host.deployment["pending"] is None


def test_a_release_can_be_reverted_until_it_is_confirmed(host: FakeHost, ports: dict[str, int]) -> None:
    first, second = FakeRelease("one", ports), FakeRelease("two", ports)
    with host.session() as session:
        first.put(session)
        second.put(session, "prepare")
        assert session.call("revert", id=second.id) == {"changed": True}
        assert session.call("revert", id=second.id) == {"changed": False}
        assert host.current == first.id and host.deployment["pending"] is None
        assert refused(session.call, "confirm", id=second.id).code == "expired"
        assert refused(session.call, "revert", id=first.id).code == "confirmed"
        session.call("switch", id=second.id, seconds=60)
        assert refused(session.call, "confirm", id=second.id).code == "not prepared"


@pytest.fixture
def launched(host: FakeHost) -> Iterator[list[Any]]:
    agents: list[Any] = []
    yield agents
    for agent in agents:
        agent.kill()
        agent.communicate()


def test_a_switch_never_touches_a_running_agent(host: FakeHost, ports: dict[str, int], launched: list[Any]) -> None:
    first, second = FakeRelease("one", ports), FakeRelease("two", ports)
    with host.session() as session:
        first.put(session)
        launched.append(host.launch("bert"))
        wait(lambda: session.call("inspect")["robots"]["bert"]["phase"] == "running")
        robots = session.call("inspect")["robots"]
        assert robots["bert"]["pid"] == launched[0].pid and not robots["alice"]["running"]
        second.put(session, "verify")
        error = refused(session.call, "switch", id=second.id, seconds=60)
        assert error.code == "in flight" and "bert (running)" in error.message and "alice" not in error.message
        assert host.current == first.id and host.deployment["pending"] is None
        other = host.launch("bert")
        assert b"runs already" in other.communicate()[1] and other.returncode == 1
        launched[0].kill()
        launched[0].wait()
        session.call("switch", id=second.id, seconds=60)
    assert host.runs == [("bert", first.id)]


def test_an_agent_that_somebody_started_by_hand_is_found_by_its_port(
    host: FakeHost, ports: dict[str, int], launched: list[Any]
) -> None:
    release = FakeRelease("one", ports)
    with host.session() as session:
        release.put(session)
        bundle, overlay = host.folder / "current" / "alice", host.folder / "settings" / release.id / "alice.json"
        launched.append(
            subprocess.Popen([sys.executable, str(bundle), "--settings", str(overlay)], stderr=subprocess.PIPE)
        )
        wait(lambda: session.call("inspect")["robots"]["alice"]["running"])
        assert refused(session.call, "switch", id=release.id, seconds=9).code == "in flight"


def test_the_lock_names_its_owner_and_ends_with_its_process(host: FakeHost) -> None:
    with host.session() as one, host.session() as two:
        assert refused(one.call, "stage", release={}, files={}).code == "not locked"
        one.call("lock", owner="anna@laptop", what="deploy")
        error = refused(two.call, "lock", owner="ben@desk", what="rollback")
        assert error.code == "locked"
        assert re.match(r"anna@laptop works here since \d+ s \(deploy, process \d+\)", error.message)
        one.process.kill()
        one.process.wait()
        two.call("lock", owner="ben@desk", what="rollback")
        assert two.call("inspect")["locked"]["owner"] == "ben@desk"


def test_a_damaged_release_is_found_and_staged_again(host: FakeHost, ports: dict[str, int]) -> None:
    release = FakeRelease("one", ports)
    with host.session() as session:
        release.put(session, "verify")
        path = host.folder / "releases" / release.id / "bert" / "lib" / "program.py"
        path.chmod(0o644)
        path.write_text("TEXT = 'another'\n")
        assert "lib/program.py" in refused(session.call, "verify", id=release.id).message
        assert release.store(session) == 1  # the object is the same file on the disk
        release.stage(session)
        assert session.call("verify", id=release.id) == {"checked": 6}
        (path.parent / "json.py").write_text("raise SystemExit(7)")
        assert "bert: lib/json.py" in refused(session.call, "verify", id=release.id).message
        (host.folder / "keys" / f"{KEY_ID}.key").chmod(0o644)
        release.stage(session)
        assert refused(session.call, "verify", id=release.id).code == "no key"


def test_a_bundle_that_does_not_load_is_refused(host: FakeHost, ports: dict[str, int]) -> None:
    with host.session() as session:
        release = FakeRelease("one", ports, help=3)
        release.put(session, "stage")
        error = refused(session.call, "verify", id=release.id)
        assert error.code == "does not run" and "(status 3)" in error.message
        release.document["python"] = "python-that-is-not-there"
        release.stage(session)
        assert refused(session.call, "verify", id=release.id).code == "no python"


def test_a_refused_change_of_the_interpreter_leaves_the_confirmed_release_as_it_was(
    host: FakeHost, ports: dict[str, int]
) -> None:
    release = FakeRelease("one", ports)
    with host.session() as session:
        release.put(session)
        release.document["python"] = "python-that-is-not-there"
        release.stage(session)
        assert refused(session.call, "verify", id=release.id).code == "no python"
    with host.session() as session:
        session.call("lock", owner="anna@laptop", what="rollback")
        assert session.call("verify", id=release.id) == {"checked": 6}


def test_paths_stay_inside_a_bundle(host: FakeHost, ports: dict[str, int]) -> None:
    release = FakeRelease("one", ports)
    with host.session() as session:
        release.put(session, "store")
        some = next(iter(release.contents))
        for name in ("../out", "/etc/passwd", "", "a//b", "a/./b", "a\\b", "a\0b", "a\nb", ".", "a/", "a/../../b"):
            files = release.files
            files["alice"][name] = [some, 0o644]
            assert refused(session.call, "stage", release=release.document, files=files).code == "bad request"
        for entry in (None, some, [some], [None, 0o644], ["../x", 0o644], [some, "0644"]):
            bad: dict[str, Any] = release.files | {"alice": {"__main__.py": entry}}
            assert refused(session.call, "stage", release=release.document, files=bad).code == "bad request"
    assert sorted(p.name for p in host.root.iterdir()) == ["boot_id", "fleet", "tool.pyz"]
    assert not list((host.folder / "releases").glob("*")) and not list(host.folder.rglob("out"))


def test_names_in_requests_are_checked(host: FakeHost, ports: dict[str, int]) -> None:
    release = FakeRelease("one", ports)
    with host.session() as session:
        session.call("lock", owner="anna@laptop", what="deploy")
        for name in ("../x", "Alice", "", "state", "a" * 33, "a/b"):
            document = release.document | {"robots": {name: {}}}
            files = {name: release.files["alice"]}
            assert refused(session.call, "stage", release=document, files=files).code == "bad request"
        for bad in ("../../etc", "0123", "g" * 16, None, 5):
            for verb in ("verify", "prepare", "confirm"):
                assert refused(session.call, verb, id=bad).code in ("bad request", "expired")
            assert refused(session.call, "switch", id=bad, seconds=5).code == "bad request"
            assert refused(session.call, "key", KEY, id=bad).code == "bad request"
            assert refused(session.call, "missing", objects=[bad]).code == "bad request"
        entry = ["../evil.whl", digest(b"x"), 1]
        for kind in ("wheels", "objects", "other"):
            error = refused(session.call, "store", zlib.compress(b"x"), kind=kind, entries=[entry])
            assert error.code == "bad request"
        assert refused(session.call, "shell", command="id").code == "bad request"
        assert session.call("ping")["clock"] > 0  # the session goes on


def test_a_content_gets_its_name_only_when_its_digest_is_right(host: FakeHost) -> None:
    good, other = b"good" * 1000, b"other"
    with host.session() as session:
        session.call("lock", owner="anna@laptop", what="deploy")
        entries = [[digest(good), digest(good), len(good)], [digest(other), digest(other), len(other)]]
        for data in (
            zlib.compress(good + b"wrong"),
            zlib.compress(good),
            zlib.compress(good + other + b"more"),
            zlib.compress(good + other)[:-9],
            b"not compressed",
        ):
            assert refused(session.call, "store", data, kind="objects", entries=entries).code == "damaged"
        assert refused(session.call, "key", KEY, id="0" * 16).code == "damaged"
        send(session, "objects", {digest(good): good})
        send(session, "wheels", {"some-1.0-py3-none-any.whl": other})
        assert session.call("missing", wheels=[["some-1.0-py3-none-any.whl", digest(other)]])["wheels"] == []
        (host.folder / "objects" / digest(good)).chmod(0o644)
        (host.folder / "objects" / digest(good)).write_bytes(b"gone bad")
        assert session.call("missing", objects=[digest(good)])["objects"] == [digest(good)]


def test_without_space_nothing_is_written(host: FakeHost) -> None:
    free = shutil.disk_usage(host.root).free
    with host.session() as session:
        session.call("lock", owner="anna@laptop", what="deploy")
        entries = [[digest(b"x"), digest(b"x"), free]]
        error = refused(session.call, "store", zlib.compress(b"x"), kind="objects", entries=entries)
        assert error.code == "no space" and f"{free + 64 * 1024 * 1024} bytes are needed and" in error.message
        assert not (host.folder / "objects").exists()


def test_a_session_without_requests_ends(host: FakeHost) -> None:
    session = host.session("--idle", "0.3")
    assert session.call("ping")["clock"] > 0
    assert session.process.wait() == 0
    session.close()


@pytest.mark.slow
def test_a_session_killed_at_any_moment_leaves_a_runnable_release(host: FakeHost, ports: dict[str, int]) -> None:
    """Deploy again and again, and kill the session at random; each time the release that may run is a whole one."""
    chance = random.Random(28)
    releases = [FakeRelease(str(i), ports) for i in range(6)]
    with host.session() as session:
        releases[0].put(session)
    confirmed = {releases[0].id}
    for release in releases[1:]:
        session = host.session()
        timer = _kill_after(session.process.pid, chance.uniform(0.0, 0.8))
        with suppress(EOFError):
            release.put(session, seconds=3000)
            confirmed.add(release.id)
        timer()
        session.process.wait()
        session.close()
        state = host.deployment
        if state["confirmed"] == release.id:  # killed between the decision and its answer
            confirmed.add(release.id)
        assert state["confirmed"] in confirmed
        if chance.random() < 0.5:
            host.reboot()
        with host.session() as after:
            facts = after.call("inspect")
            after.call("lock", owner="anna@laptop", what="test")
            assert after.call("verify", id=facts["deployment"]["confirmed"])["checked"] == 6
            if facts["deployment"]["pending"] is None:
                assert facts["current"] == state["confirmed"]
    with host.session() as session:  # the next deployment ends well
        releases[-1].put(session)
    assert host.current == host.deployment["confirmed"] == releases[-1].id
    assert not [p for p in host.folder.rglob(".*") if ".staging" in p.name]


def _kill_after(pid: int, seconds: float) -> Callable[[], None]:
    def kill() -> None:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)

    timer = Timer(seconds, kill)
    timer.start()
    return timer.join


def test_the_archive_is_the_same_each_time() -> None:
    assert archive() == archive() and len(archive()) < 200_000
