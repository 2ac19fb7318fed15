"""How C code gets onto a robot: compiled, kept, and what is done about whatever goes wrong with it."""

from __future__ import annotations

import ctypes
import fcntl
import os
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path

import pytest

from koordgen.runtime.native import loader as native
from koordgen.runtime.native.loader import NotCompiled, cache_folder, load

FLAGS = ("-std=c99", "-O1", "-shared", "-fPIC", "-lm")
CODE = "#include <math.h>\nint answer(int of) { return (int) sqrt(of); }\n"
FAILS = "the C code of tiny cannot be compiled: "
PROCESS = """
import sys
from pathlib import Path
from tests.runtime.native.test_native import FLAGS, load, prove
print("ready", flush=True)
sys.stdin.readline()
print(load(Path(sys.argv[1]), FLAGS, prove, Path(sys.argv[2])).answer(49))
"""


def prove(library: ctypes.CDLL) -> None:
    if library.answer(1764) != 42:
        raise NotCompiled("tiny gives a wrong answer")


@pytest.fixture
def source(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.c"
    path.write_text(CODE)
    return path


@pytest.fixture
def cache(tmp_path: Path) -> Path:
    return tmp_path / "robot/cache/koordgen"


@pytest.fixture
def compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What is found as `cc`: a script that the test writes."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))
    return folder / "cc"


def script(path: Path, text: str) -> None:
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)


def kept(cache: Path) -> list[Path]:
    return sorted(cache.iterdir())


def compiled(text: str, folder: Path) -> bytes:
    (folder / "other.c").write_text(text)
    subprocess.run(["cc", "-shared", "-fPIC", "-o", folder / "other.so", folder / "other.c"], check=True)
    return (folder / "other.so").read_bytes()


def test_it_is_compiled_once_and_kept_for_nobody_else(
    source: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert load(source, FLAGS, prove, cache).answer(49) == 7
    (library,) = kept(cache)
    assert library.name.startswith("tiny-")
    assert stat.S_IMODE(cache.stat().st_mode) == stat.S_IMODE(library.stat().st_mode) == 0o700
    monkeypatch.setenv("PATH", "")
    assert load(source, FLAGS, prove, cache).answer(49) == 7, "no compiler is needed any more"
    assert kept(cache) == [library]


def test_another_source_and_other_flags_are_compiled_anew(source: Path, cache: Path) -> None:
    load(source, FLAGS, prove, cache)
    load(source, (*FLAGS, "-O2"), prove, cache)
    assert len(kept(cache)) == 2
    source.write_text(CODE + "/* newer */\n")
    load(source, FLAGS, prove, cache)
    assert len(kept(cache)) == 3


def test_libraries_of_several_files_are_kept_side_by_side(source: Path, cache: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.c"
    other.write_text(CODE)
    load(source, FLAGS, prove, cache)
    load(other, FLAGS, prove, cache)
    assert [path.name.split("-")[0] for path in kept(cache)] == ["other", "tiny"]


DAMAGES = ["truncated", "changed", "empty", "other machine", "no library", "wrong answers", "other functions"]


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_spoilt_library_is_never_used_and_compiled_anew(
    source: Path, cache: Path, damage: str, tmp_path: Path
) -> None:
    load(source, FLAGS, prove, cache)
    (library,) = kept(cache)
    good = library.read_bytes()
    foreign = bytearray(good)
    foreign[18:20] = b"\xf3\x00"  # e_machine: RISC-V
    planted = library
    if damage in ("truncated", "changed", "empty"):
        spoilt = {"truncated": good[: len(good) // 2], "changed": good[:-9] + b"x" + good[-8:], "empty": b""}[damage]
    else:  # these have the right digest: they are refused when they are loaded, or asked
        spoilt = {
            "other machine": bytes(foreign),
            "no library": b"\x7fELF",
            "wrong answers": compiled("int answer(int of) { return of; }", tmp_path),
            "other functions": compiled("int question(int of) { return of; }", tmp_path),
        }[damage]
        planted = library.with_name(f"{library.stem.rpartition('-')[0]}-{sha256(spoilt).hexdigest()[:32]}.so")
    library.unlink()
    planted.write_bytes(spoilt)
    planted.chmod(0o700)
    assert load(source, FLAGS, prove, cache).answer(49) == 7
    (library,) = kept(cache)
    assert library.read_bytes() == good


def test_nothing_is_loaded_from_a_folder_that_others_may_write(source: Path, cache: Path, compiler: Path) -> None:
    script(compiler, "exit 1")
    cache.mkdir(parents=True)
    cache.chmod(0o777)
    with pytest.raises(NotCompiled):
        load(source, FLAGS, prove, cache)
    assert kept(cache) == []


@pytest.mark.parametrize("mode", [0o720, 0o702, 0o777])
def test_no_file_is_loaded_that_others_may_write(
    source: Path, cache: Path, mode: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    load(source, FLAGS, prove, cache)
    (library,) = kept(cache)
    library.chmod(mode)
    monkeypatch.setenv("PATH", "")
    with pytest.raises(NotCompiled):
        load(source, FLAGS, prove, cache)
    assert kept(cache) == []


@pytest.mark.parametrize("linked", ["library", "folder"])
def test_nothing_is_loaded_through_a_link(
    source: Path, cache: Path, linked: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    load(source, FLAGS, prove, cache)
    path = kept(cache)[0] if linked == "library" else cache
    path.rename(tmp_path / "aside")
    path.symlink_to(tmp_path / "aside")
    monkeypatch.setenv("PATH", "")
    with pytest.raises(NotCompiled):
        load(source, FLAGS, prove, cache)


def unwritable(monkeypatch: pytest.MonkeyPatch, number: int, *, also_temporary: bool) -> None:
    real = tempfile.mkdtemp

    def refused(prefix: str, dir: Path | None) -> str:
        if dir is not None or also_temporary:
            raise OSError(number, os.strerror(number), str(dir or "/tmp"))
        return real(prefix=prefix)

    monkeypatch.setattr(tempfile, "mkdtemp", refused)


@pytest.mark.parametrize("obstacle", ["file in the way", "no room", "unwritable"])
def test_where_nothing_can_be_kept_it_is_compiled_at_each_start(
    source: Path, cache: Path, obstacle: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if obstacle == "file in the way":
        cache.parent.mkdir(parents=True)
        cache.write_text("")
    else:
        unwritable(monkeypatch, {"no room": 28, "unwritable": 30}[obstacle], also_temporary=False)
    assert load(source, FLAGS, prove, cache).answer(49) == 7


def refusal(source: Path, cache: Path) -> str:
    with pytest.raises(NotCompiled) as refused:
        load(source, FLAGS, prove, cache)
    return str(refused.value)


def test_a_disk_that_takes_nothing_is_told(source: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    unwritable(monkeypatch, 30, also_temporary=True)
    assert refusal(source, cache) == FAILS + "/tmp: Read-only file system"


def test_that_there_is_no_compiler_is_told(source: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    assert refusal(source, cache) == FAILS + "there is no C compiler (cc, gcc, clang)"
    assert kept(cache) == []


def test_that_there_is_no_source_is_told(source: Path, cache: Path) -> None:
    source.unlink()
    assert refusal(source, cache) == f"the C code of tiny cannot be read: {source}: No such file or directory"


@pytest.mark.parametrize(
    ("does", "reason"),
    [
        ("echo 'tiny.c:3: internal error' >&2; exit 4", "failed with status 4: tiny.c:3: internal error"),
        ("exit 0", "failed with status 0: no message"),
        ("kill -9 $$", "failed with status -9: no message"),
        ("while true; do :; done", "did not finish within 0 s"),
    ],
)
def test_a_compiler_that_fails_is_told(
    source: Path, cache: Path, compiler: Path, does: str, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    script(compiler, does)
    monkeypatch.setattr(native, "TIMEOUT", 0.3)
    assert refusal(source, cache) == f"{FAILS}{compiler} {reason}"
    assert kept(cache) == [], "no half library is left"


def test_a_compiler_that_makes_no_library_is_told(source: Path, cache: Path, compiler: Path) -> None:
    script(compiler, 'for a; do case $a in *.so) echo junk > "$a";; esac; done')
    assert refusal(source, cache).startswith("the C code of tiny is compiled, but cannot be loaded: ")
    assert kept(cache) == []


def test_code_that_answers_wrongly_is_not_kept(source: Path, cache: Path) -> None:
    source.write_text(CODE.replace("sqrt", ""))
    assert refusal(source, cache) == "tiny gives a wrong answer"
    assert kept(cache) == []


def test_the_cache_is_the_users(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "koordgen"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.setenv("HOME", "/home/robot")
    assert cache_folder() == Path("/home/robot/.cache/koordgen")


@contextmanager
def processes(count: int, source: Path, cache: Path) -> Iterator[list[subprocess.Popen[str]]]:
    """Agents, each a process, that stand ready to load when they are told a line."""
    command = [sys.executable, "-c", PROCESS, str(source), str(cache)]
    began = [
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True)
        for _ in range(count)
    ]
    try:
        for process in began:
            assert process.stdout is not None and process.stdout.readline() == "ready\n"
        yield began
    finally:
        for process in began:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            process.communicate()


def go(process: subprocess.Popen[str]) -> None:
    assert process.stdin is not None
    process.stdin.write("\n")
    process.stdin.flush()


def test_of_processes_that_start_at_once_the_first_compiles_for_all(source: Path, cache: Path, compiler: Path) -> None:
    real = shutil.which("cc", path=os.defpath)
    script(compiler, f'PATH={os.defpath}; echo >> "{compiler}.runs"; sleep 0.2; exec {real} "$@"')
    with processes(5, source, cache) as agents:
        for agent in agents:
            go(agent)
        assert [agent.communicate()[0] for agent in agents] == ["7\n"] * 5
    assert Path(f"{compiler}.runs").read_text() == "\n", "one compiled"
    assert len(kept(cache)) == 1


def test_a_process_that_dies_amid_compiling_keeps_nobody_waiting(source: Path, cache: Path, compiler: Path) -> None:
    real = shutil.which("cc", path=os.defpath)
    began = Path(f"{compiler}.began")
    os.mkfifo(began)
    text = f'PATH={os.defpath}; if mkdir "{compiler}.first"; then echo > "{began}"; exec sleep 60; fi; exec {real} "$@"'
    script(compiler, text)
    with processes(2, source, cache) as (first, second):
        go(first)
        began.read_text()  # until it compiles
        go(second)
        os.kill(first.pid, signal.SIGKILL)  # and the compiler that it began goes on
        try:
            assert second.communicate(timeout=20)[0] == "7\n"
        finally:
            os.killpg(first.pid, signal.SIGKILL)


@contextmanager
def another_compiles_into(cache: Path) -> Iterator[None]:
    handle = os.open(cache, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def test_nobody_waits_for_ever_for_another_process(source: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(native, "TIMEOUT", 0.5)
    cache.mkdir(parents=True, mode=0o700)
    with another_compiles_into(cache):
        assert load(source, FLAGS, prove, cache).answer(49) == 7


def test_what_another_process_made_meanwhile_is_used(
    source: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also while it has not let go: the library is there whole, or not at all."""
    load(source, FLAGS, prove, cache)
    (library,) = kept(cache)
    aside = library.rename(cache.parent / "aside")
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr("time.sleep", lambda seconds: aside.rename(library))
    with another_compiles_into(cache):
        assert load(source, FLAGS, prove, cache).answer(49) == 7


def test_a_file_system_without_locks_compiles_all_the_same(
    source: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unknown(handle: int, how: int) -> None:
        raise OSError(38, "Function not implemented")

    monkeypatch.setattr(fcntl, "flock", unknown)
    assert load(source, FLAGS, prove, cache).answer(49) == 7
