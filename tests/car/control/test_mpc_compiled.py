"""The solver in C on a robot: how a library is loaded is shown by tests/runtime/native/test_native.py."""

from __future__ import annotations

import subprocess
import tempfile
from hashlib import sha256
from pathlib import Path

import pytest

from koordgen.runtime.native.loader import NotCompiled
from targets.car.control.mpc import STEPS, choose
from targets.car.control.solver.compiled import CompiledSolver, load
from targets.car.control.solver.fallback import CasadiSolver
from targets.car.control.solver.problem import ControlLimits
from tests.car.platform.world import World

LIMITS = ControlLimits(wheelbase=0.33, speed=1.0, acceleration=1.5, steering=0.387, steering_rate=3.0)
SLOWER = "the controller runs in CasADi, which takes several times longer: "
FAILS = SLOWER + "the C code of mpc cannot be compiled: "


def works(solver: CompiledSolver) -> bool:
    plan = solver((0.0, 0.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.5, 0.0) * STEPS, [0.0] * 2 * STEPS)
    return plan is not None and plan[0] == pytest.approx(LIMITS.acceleration, abs=1e-3)


@pytest.fixture
def cache(tmp_path: Path) -> Path:
    return tmp_path / "robot/cache/koordgen"


def test_it_is_compiled_once(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert works(load(LIMITS, cache))
    (library,) = cache.iterdir()
    assert library.name.startswith("mpc-")
    monkeypatch.setenv("PATH", "")
    assert works(load(LIMITS, cache)), "no compiler is needed any more"


def test_a_library_that_answers_wrongly_is_never_used_and_compiled_anew(cache: Path, tmp_path: Path) -> None:
    load(LIMITS, cache)
    (library,) = cache.iterdir()
    good = library.read_bytes()
    wrong = tmp_path / "wrong.c"
    wrong.write_text("double mpc_solve(void *p, double *u, double *x, int *e) { u[0] = 1; return 0; }\n")
    subprocess.run(["cc", "-shared", "-fPIC", "-o", tmp_path / "wrong.so", wrong], check=True)
    spoilt = (tmp_path / "wrong.so").read_bytes()
    library.unlink()
    planted = library.with_name(f"{library.stem.rpartition('-')[0]}-{sha256(spoilt).hexdigest()[:32]}.so")
    planted.write_bytes(spoilt)
    planted.chmod(0o700)
    assert works(load(LIMITS, cache))
    (library,) = cache.iterdir()
    assert library.read_bytes() == good


def test_on_a_disk_that_takes_nothing_casadi_drives(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(prefix: str, dir: Path | None) -> str:
        raise OSError(30, "Read-only file system", str(dir or "/tmp"))

    monkeypatch.setattr(tempfile, "mkdtemp", refused)
    solver, note = choose(LIMITS, cache)
    assert isinstance(solver, CasadiSolver)
    assert note == FAILS + "/tmp: Read-only file system"


def test_without_a_compiler_casadi_drives_and_it_is_said(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    solver, note = choose(LIMITS, cache)
    assert isinstance(solver, CasadiSolver)
    assert note == FAILS + "there is no C compiler (cc, gcc, clang)"


def test_with_code_that_answers_wrongly_casadi_drives(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("targets.car.control.solver.compiled.PROBE_ANSWER", (1.5, 0.0))
    with pytest.raises(NotCompiled, match="the compiled solver gives a wrong answer to a known problem"):
        load(LIMITS, cache)
    assert isinstance(choose(LIMITS, cache)[0], CasadiSolver)
    assert list(cache.iterdir()) == []


def test_a_robot_without_a_compiler_drives_says_so_and_its_diagnosis_warns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("PATH", "")
    world = World().begin()
    why = FAILS + "there is no C compiler (cc, gcc, clang)"
    assert world.car.log_lines() == [why] and world.car.log_lines() == []
    world.go(1.5, 0.0)
    world.run(5.0)
    assert world.value("reached") is True
    (found,) = (f for f in World().car.diagnose() if f.name == "controller")
    assert (found.state, found.found) == ("warn", why)
    assert found.why == "install a C compiler: apt install gcc"
