"""How the solver in C gets onto a robot: compiled, kept, and what is done about whatever goes wrong with it."""

from __future__ import annotations

import os
import stat
import subprocess
import tempfile
from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256
from pathlib import Path

import pytest

from targets.car.mpc import STEPS, choose
from targets.car.solver import compiled
from targets.car.solver.compiled import CompiledSolver, NotCompiled, load
from targets.car.solver.fallback import CasadiSolver
from targets.car.solver.problem import Limits
from tests.car.world import World

LIMITS = Limits(wheelbase=0.33, speed=1.0, acceleration=1.5, steering=0.387, steering_rate=3.0)
SLOWER = "the controller runs in CasADi, which takes several times longer: "


def works(solver: CompiledSolver) -> bool:
    plan = solver((0.0, 0.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.5, 0.0) * STEPS, [0.0] * 2 * STEPS)
    return plan is not None and plan[0] == pytest.approx(LIMITS.acceleration, abs=1e-3)


def kept(cache: Path) -> list[Path]:
    return sorted(cache.iterdir())


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


def test_it_is_compiled_once_and_kept_for_nobody_else(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert works(load(LIMITS, cache))
    (library,) = kept(cache)
    assert stat.S_IMODE(cache.stat().st_mode) == stat.S_IMODE(library.stat().st_mode) == 0o700
    monkeypatch.setenv("PATH", "")
    assert works(load(LIMITS, cache)), "no compiler is needed any more"
    assert kept(cache) == [library]


def test_another_source_is_compiled_anew(cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    load(LIMITS, cache)
    other = tmp_path / "other.c"
    other.write_bytes(compiled.SOURCE.read_bytes() + b"/* newer */\n")
    monkeypatch.setattr(compiled, "SOURCE", other)
    assert works(load(LIMITS, cache))
    assert len(kept(cache)) == 2


@pytest.mark.parametrize("damage", ["truncated", "changed", "empty", "other machine", "no library", "wrong answers"])
def test_a_spoilt_library_is_never_used_and_compiled_anew(cache: Path, damage: str, tmp_path: Path) -> None:
    load(LIMITS, cache)
    (library,) = kept(cache)
    good = library.read_bytes()
    key = library.name.split("-")[1]
    foreign = bytearray(good)
    foreign[18:20] = b"\xf3\x00"  # e_machine: RISC-V
    wrong = tmp_path / "wrong.c"
    wrong.write_text("double mpc_solve(void *p, double *u, double *x, int *e) { u[0] = 1; return 0; }\n")
    subprocess.run(["cc", "-shared", "-fPIC", "-o", tmp_path / "wrong.so", wrong], check=True)
    spoilt = {
        "truncated": good[: len(good) // 2],
        "changed": good[:-9] + b"x" + good[-8:],
        "empty": b"",
        "other machine": bytes(foreign),
        "no library": b"\x7fELF",
        "wrong answers": (tmp_path / "wrong.so").read_bytes(),
    }[damage]
    library.unlink()
    # The last three have the right digest: they are refused when they are loaded, or asked.
    digest = sha256(spoilt).hexdigest()[:32]
    planted = cache / (
        f"mpc-{key}-{digest}.so" if damage in ("other machine", "no library", "wrong answers") else library.name
    )
    planted.write_bytes(spoilt)
    planted.chmod(0o700)
    assert works(load(LIMITS, cache))
    (library,) = kept(cache)
    assert library.read_bytes() == good


def test_nothing_is_loaded_from_a_folder_that_others_may_write(cache: Path, compiler: Path) -> None:
    script(compiler, "exit 1")
    cache.mkdir(parents=True)
    cache.chmod(0o777)
    with pytest.raises(NotCompiled):
        load(LIMITS, cache)
    assert kept(cache) == []


@pytest.mark.parametrize("mode", [0o720, 0o702, 0o777])
def test_no_file_is_loaded_that_others_may_write(cache: Path, mode: int, monkeypatch: pytest.MonkeyPatch) -> None:
    load(LIMITS, cache)
    (library,) = kept(cache)
    library.chmod(mode)
    monkeypatch.setenv("PATH", "")
    with pytest.raises(NotCompiled):
        load(LIMITS, cache)
    assert kept(cache) == []


def test_no_library_is_loaded_through_a_link(cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    load(LIMITS, cache)
    (library,) = kept(cache)
    library.rename(tmp_path / "aside")
    library.symlink_to(tmp_path / "aside")
    monkeypatch.setenv("PATH", "")
    with pytest.raises(NotCompiled):
        load(LIMITS, cache)


def test_robots_that_start_at_once_do_not_disturb_each_other(cache: Path) -> None:
    with ThreadPoolExecutor() as pool:
        solvers = list(pool.map(lambda _: load(LIMITS, cache), range(4)))
    assert all(works(solver) for solver in solvers)
    assert all(path.suffix == ".so" for path in kept(cache))


def test_nothing_is_loaded_through_a_link(cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    load(LIMITS, cache)
    aside = tmp_path / "aside"
    cache.rename(aside)
    cache.symlink_to(aside)
    monkeypatch.setenv("PATH", "")
    with pytest.raises(NotCompiled):
        load(LIMITS, cache)


@pytest.mark.parametrize("obstacle", ["file in the way", "no room", "unwritable"])
def test_where_nothing_can_be_kept_it_is_compiled_at_each_start(
    cache: Path, obstacle: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if obstacle == "file in the way":
        cache.parent.mkdir(parents=True)
        cache.write_text("")
    else:
        number = {"no room": 28, "unwritable": 30}[obstacle]
        real = tempfile.mkdtemp

        def refused(prefix: str, dir: Path | None) -> str:
            if dir is not None:
                raise OSError(number, os.strerror(number), str(dir))
            return real(prefix=prefix)

        monkeypatch.setattr(tempfile, "mkdtemp", refused)
    assert works(load(LIMITS, cache))


def test_on_a_disk_that_takes_nothing_casadi_drives(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(prefix: str, dir: Path | None) -> str:
        raise OSError(30, "Read-only file system", str(dir or "/tmp"))

    monkeypatch.setattr(tempfile, "mkdtemp", refused)
    solver, note = choose(LIMITS, cache)
    assert isinstance(solver, CasadiSolver)
    assert note == SLOWER + "the C solver cannot be compiled: /tmp: Read-only file system"


def test_without_a_compiler_casadi_drives_and_it_is_said(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    solver, note = choose(LIMITS, cache)
    assert isinstance(solver, CasadiSolver)
    assert note == SLOWER + "there is no C compiler (cc, gcc, clang)"
    assert kept(cache) == []


@pytest.mark.parametrize(
    ("does", "reason"),
    [
        ("echo 'mpc.c:3: internal error' >&2; exit 4", "failed with status 4: mpc.c:3: internal error"),
        ("exit 0", "failed with status 0: no message"),
        ("kill -9 $$", "failed with status -9: no message"),
        ("while true; do :; done", "had not compiled the solver after 0 s"),
    ],
)
def test_a_compiler_that_fails_is_told(
    cache: Path, compiler: Path, does: str, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    script(compiler, does)
    monkeypatch.setattr(compiled, "PATIENCE", 0.3)
    solver, note = choose(LIMITS, cache)
    assert isinstance(solver, CasadiSolver)
    assert note == f"{SLOWER}{compiler} {reason}"
    assert kept(cache) == [], "no half library is left"


def test_a_compiler_that_makes_no_library_is_told(cache: Path, compiler: Path) -> None:
    script(compiler, 'for a; do case $a in *.so) echo junk > "$a";; esac; done')
    solver, note = choose(LIMITS, cache)
    assert isinstance(solver, CasadiSolver)
    assert note.startswith(SLOWER + "the compiled solver cannot be loaded: ")
    assert kept(cache) == []


def test_the_cache_is_the_users(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert compiled.cache_folder() == tmp_path / "koordgen"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.setenv("HOME", "/home/robot")
    assert compiled.cache_folder() == Path("/home/robot/.cache/koordgen")


def test_a_robot_without_a_compiler_drives_says_so_and_its_diagnosis_warns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("PATH", "")
    world = World().begin()
    why = SLOWER + "there is no C compiler (cc, gcc, clang)"
    assert world.car.news() == [why] and world.car.news() == []
    world.go(1.5, 0.0)
    world.run(5.0)
    assert world.value("reached") is True
    (found,) = (f for f in World().car.diagnose() if f.name == "controller")
    assert (found.state, found.found) == ("warn", why)
    assert found.why == "install a C compiler: apt install gcc"
