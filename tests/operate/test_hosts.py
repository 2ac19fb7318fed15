"""Sessions with hosts over real SSH servers: who is reached, and one clear message for each way to fail."""

from __future__ import annotations

import asyncio
import io
import socket
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks.fixtures.ssh_hosts import SshFleet, make_key, ssh_fleet
from koordgen.lang.node import replace
from koordgen.operate import hosts
from koordgen.operate.hosts import Host, HostError, Options, Sessions, sessions

# Answers each request with itself, and sends data back; `die` ends it.
ECHO = """
import json, os, sys
for line in sys.stdin.buffer:
    request = json.loads(line)
    data = sys.stdin.buffer.read(request.get("length", 0))
    if request["verb"] == "die":
        sys.exit("a reason")
    if request["verb"] == "refuse":
        answer = {"ok": False, "error": "locked", "message": "it is locked", "help": "wait"}
    else:
        answer = {"ok": True, "asked": request, "argv": sys.argv[1:], "cwd": os.getcwd(), "length": len(data)}
    sys.stdout.buffer.write(json.dumps(answer).encode() + b"\\n" + data)
    sys.stdout.buffer.flush()
"""


def tool(text: str = ECHO) -> bytes:
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr(zipfile.ZipInfo("__main__.py"), text)
    return archive.getvalue()


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SshFleet]:
    with ssh_fleet(tmp_path_factory.mktemp("ssh"), ["alice", "bert"]) as running:
        yield running


def reach(asked: list[Host], options: Options, ask: str = "inspect") -> Sessions:
    async def run() -> Sessions:
        async with sessions(asked, options, tool()) as opened:
            for session in opened.reached:
                await session.call(ask)
            return opened

    return asyncio.run(run())


def failure(host: Host, options: Options) -> HostError:
    reached = reach([host], options)
    assert not reached.reached
    return reached.failed[0]


def test_data_goes_there_and_back(fleet: SshFleet) -> None:
    async def run() -> None:
        alice, bert = (fleet.hosts[name].host() for name in ("alice", "bert"))
        async with sessions([alice, bert], fleet.options, tool()) as opened:
            assert [session.host for session in opened.reached] == [alice, bert] and not opened.failed
            session = opened.reached[0]
            answer = await session.call("store", b"\x00\n" * 100000, kind="objects")
            assert answer.data == b"\x00\n" * 100000
            assert answer["asked"] == {"verb": "store", "kind": "objects", "length": 200000}
            assert answer["argv"] == ["--folder", "koordgen/fleet", "session"]
            assert answer["cwd"] == str(fleet.hosts["alice"].home)
            answers, failed = await opened.call("inspect", robot="x")
            assert list(answers) == [alice, bert] and not failed
            with pytest.raises(HostError) as refused:
                await session.call("refuse")
            assert (refused.value.code, refused.value.help) == ("locked", "wait")
            assert str(refused.value) == f"alice ({fleet.hosts['alice'].login}): it is locked"
            await session.call("inspect")  # a refusal ends nothing

    asyncio.run(run())


def test_the_tool_travels_once(fleet: SshFleet) -> None:
    host = fleet.hosts["alice"].host(folder="once")
    assert [session.sent > len(tool()) for session in reach([host], fleet.options).reached] == [True]
    assert [session.sent < 1000 for session in reach([host], fleet.options).reached] == [True]
    (stored,) = (fleet.hosts["alice"].home / "once/tool").iterdir()
    stored.write_bytes(b"damaged")
    assert reach([host], fleet.options).reached and stored.read_bytes() == tool()


def test_a_greeting_of_the_login_shell_is_skipped(fleet: SshFleet) -> None:
    rc = fleet.hosts["bert"].home / ".bashrc"
    rc.write_text("echo welcome\n")
    try:
        assert reach([fleet.hosts["bert"].host()], fleet.options).reached
    finally:
        rc.unlink()


def test_an_unknown_host_key(fleet: SshFleet, tmp_path: Path) -> None:
    empty = tmp_path / "known_hosts"
    empty.write_text("")
    error = failure(fleet.hosts["alice"].host(), replace(fleet.options, known_hosts=str(empty)))
    assert error.code == "unknown key" and "alice" in str(error) and "SHA256:" in error.message
    assert f"ssh-keyscan -p {fleet.hosts['alice'].port} 127.0.0.1 >> {empty}" in error.help
    assert "ssh-keygen -lf" in error.help
    assert empty.read_text() == ""


@pytest.mark.parametrize("setting", ["StrictHostKeyChecking no", "UserKnownHostsFile none"])
def test_no_setting_accepts_an_unknown_key(fleet: SshFleet, tmp_path: Path, setting: str) -> None:
    config = tmp_path / "config"
    config.write_text(f"UserKnownHostsFile {tmp_path}/none\n" if "Strict" in setting else "")
    config.write_text(f"{setting}\n{config.read_text()}")
    options = replace(fleet.options, known_hosts=None, ssh_config=str(config))
    assert failure(fleet.hosts["alice"].host(), options).code == "unknown key"


def test_known_hosts_of_the_ssh_configuration(fleet: SshFleet) -> None:
    assert reach([fleet.hosts["alice"].host()], replace(fleet.options, known_hosts=None, identity=None)).reached


def test_a_changed_host_key(fleet: SshFleet, tmp_path: Path) -> None:
    make_key(tmp_path / "other")
    known = tmp_path / "known_hosts"
    known.write_text(f"[127.0.0.1]:{fleet.hosts['alice'].port} {(tmp_path / 'other.pub').read_text()}")
    error = failure(fleet.hosts["alice"].host(), replace(fleet.options, known_hosts=str(known)))
    assert error.code == "changed key" and "differs from the key in known_hosts" in error.message
    assert "ssh-keygen -R" in error.help and "do not connect" in error.help


def test_known_hosts_that_is_damaged(fleet: SshFleet, tmp_path: Path) -> None:
    damaged = tmp_path / "known_hosts"
    damaged.write_text("nonsense\n")
    error = failure(fleet.hosts["alice"].host(), replace(fleet.options, known_hosts=str(damaged)))
    assert error.code == "settings" and "nonsense" in error.message


def test_a_key_with_a_passphrase(fleet: SshFleet, tmp_path: Path) -> None:
    key = tmp_path / "secret"
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "secret", "-f", str(key)], check=True)
    error = failure(fleet.hosts["alice"].host(), replace(fleet.options, identity=str(key)))
    assert error.code == "settings" and "ssh-add" in error.help


def test_a_login_shell_that_hangs(fleet: SshFleet, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hosts, "START_TIMEOUT", 0.5)
    rc = fleet.hosts["bert"].home / ".bashrc"
    rc.write_text("sleep 60\n")
    try:
        error = failure(fleet.hosts["bert"].host(), fleet.options)
    finally:
        rc.unlink()
    assert error.code == "tool" and "within 0.5 s" in error.message


def test_a_refused_key(fleet: SshFleet, tmp_path: Path) -> None:
    make_key(tmp_path / "other")
    error = failure(fleet.hosts["alice"].host(), replace(fleet.options, identity=str(tmp_path / "other")))
    assert error.code == "refused key" and "ssh-copy-id" in error.help


def test_no_server(fleet: SshFleet) -> None:
    host = fleet.hosts["alice"].host()
    nobody = replace(host, login=replace(host.login, port=1))
    error = failure(nobody, fleet.options)
    assert error.code == "unreachable" and "refuses connections" in error.message


def test_no_name(fleet: SshFleet) -> None:
    host = fleet.hosts["alice"].host()
    error = failure(replace(host, login=replace(host.login, name="no-such-host.invalid")), fleet.options)
    assert error.code == "unreachable" and "no-such-host.invalid" in error.message


def test_a_host_that_does_not_answer(fleet: SshFleet) -> None:
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        host = fleet.hosts["alice"].host()
        mute = replace(host, login=replace(host.login, port=silent.getsockname()[1]))
        error = failure(mute, replace(fleet.options, timeout=0.5))
    assert error.code == "unreachable" and "within 0.5 s" in error.message


def test_no_python(fleet: SshFleet) -> None:
    error = failure(fleet.hosts["alice"].host(python="python9"), fleet.options)
    assert error.code == "python" and "no command python9" in error.message


def test_an_old_python(fleet: SshFleet) -> None:
    old = fleet.hosts["alice"].home / "old-python"
    old.write_text(f"#!/bin/sh\nshift 2; code=$1; shift\nexec {sys.executable} -c "
                   '"import sys; sys.version_info = (3, 7, 3)\n$code" "$@"\n')  # fmt: skip
    old.chmod(0o755)
    error = failure(fleet.hosts["alice"].host(python="./old-python", folder="old"), fleet.options)
    assert error.code == "python" and "3.7" in error.message and "3.10" in error.message
    assert not (fleet.hosts["alice"].home / "old").exists()


def test_a_folder_that_cannot_be_written(fleet: SshFleet) -> None:
    (fleet.hosts["alice"].home / "file").write_text("")
    error = failure(fleet.hosts["alice"].host(folder="file/koordgen"), fleet.options)
    assert error.code == "folder" and "file/koordgen" in error.message


def test_a_tool_that_dies(fleet: SshFleet) -> None:
    with pytest.raises(HostError) as died:
        reach([fleet.hosts["alice"].host()], fleet.options, "die")
    assert died.value.code == "tool" and "a reason" in died.value.message


def test_a_link_that_is_cut(fleet: SshFleet) -> None:
    async def run() -> None:
        both = [fleet.hosts[name].host() for name in ("alice", "bert")]
        async with sessions(both, fleet.options, tool()) as opened:
            fleet.hosts["alice"].cut()
            answers, failed = await opened.call("inspect")
            assert list(answers) == [both[1]]
            assert [error.code for error in failed] == ["link"] and "during `inspect`" in failed[0].message
            answers, failed = await opened.call("inspect")  # it stays cut
            assert list(answers) == [both[1]] and [error.code for error in failed] == ["link"]

    asyncio.run(run())
