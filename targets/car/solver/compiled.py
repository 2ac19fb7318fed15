"""The solver as C: compiled once on the robot, kept in a cache, called by ctypes.

A library is loaded from a folder and a file of our own only, which nobody else may write, and when its content has the
digest that its name tells: what is truncated or was changed is compiled anew.
"""

from __future__ import annotations

import ctypes
import os
import platform
import shutil
import stat
import subprocess
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from hashlib import sha256
from pathlib import Path

from targets.car.solver.model import INPUTS, STATES, STEPS
from targets.car.solver.problem import INPUT_WEIGHTS, STATE_WEIGHTS, Limits

SOURCE = Path(__file__).with_name("mpc.c")
COMPILERS = ("cc", "gcc", "clang")
FLAGS = ("-std=c99", "-O1", "-shared", "-fPIC")  # -O3 takes three times as long, for 8 % of the solver's time
DIGITS = 32  # of a digest in a file's name
PATIENCE = 60.0  # seconds that a compiler may take
# A problem with a known answer: a full stop 0.2 m ahead, from 0.8 m/s and 0.1 rad off. First acceleration and steering
# rate as CasADi with IPOPT finds them.
PROBE_LIMITS = Limits(wheelbase=0.33, speed=1.0, acceleration=1.5, steering=0.4, steering_rate=3.0)
PROBE_STATE = (0.0, 0.0, 0.1, 0.8, 0.0)
PROBE_WISHED = (0.2, 0.0, 0.0, 0.0, 0.0)
PROBE_ANSWER = (-1.5, -2.2148)
PROBE_TOLERANCE = 0.01


class NotCompiled(Exception):
    """There is no compiled solver: says why."""


class CompiledSolver:
    """`problem.Solver` by a library made of mpc.c. Raises NotCompiled when it cannot be loaded or answers wrongly."""

    def __init__(self, library: Path, limits: Limits) -> None:
        try:
            self._solve = ctypes.CDLL(str(library)).mpc_solve
        except (OSError, AttributeError) as error:
            raise NotCompiled(f"the compiled solver cannot be loaded: {error}") from None
        self._solve.restype = ctypes.c_double
        self._head = [
            limits.wheelbase, limits.acceleration, limits.steering_rate, limits.speed, limits.steering,
            *STATE_WEIGHTS, *INPUT_WEIGHTS,
        ]  # fmt: skip
        self._problem = (ctypes.c_double * (len(self._head) + STATES * (1 + STEPS)))()
        self._inputs = (ctypes.c_double * (INPUTS * STEPS))()
        self._states = (ctypes.c_double * (STATES * STEPS))()
        self.effort = (ctypes.c_int * 2)()

    def __call__(
        self, present: Sequence[float], wished: Sequence[float], inputs: Sequence[float]
    ) -> list[float] | None:
        """See `problem.Solver`."""
        self._problem[:] = [*self._head, *present, *wished]
        self._inputs[:] = [*inputs]
        cost = self._solve(self._problem, self._inputs, self._states, self.effort)
        return self._inputs[:] if cost >= 0 else None


def load(limits: Limits, cache: Path | None = None) -> CompiledSolver:
    """The solver out of the cache (by default `cache_folder()`), compiled if need be: that takes a second or a few,
    once. Where no cache can be kept, it is compiled at each start. Raises NotCompiled."""
    cache = cache if cache is not None else cache_folder()
    source = SOURCE.read_bytes()
    key = sha256(b"\0".join([source, *(flag.encode() for flag in FLAGS), platform.machine().encode()])).hexdigest()[:16]
    places: list[Path | None] = [None]  # the system's own folder for temporary files
    if cache is not None and _private(cache):
        for path in sorted(cache.glob(f"mpc-{key}-*.so")):
            with suppress(NotCompiled, OSError):
                if _sound(path):
                    return _proven(path, limits)
            with suppress(OSError):
                path.unlink()
        places.insert(0, cache)
    why = ""
    for place in places:
        try:
            return _make(source, place, key, limits)
        except OSError as error:  # read-only, full
            why = f"{error.filename or place}: {error.strerror or error}"
    raise NotCompiled(f"the C solver cannot be compiled: {why}")


def _make(source: bytes, place: Path | None, key: str, limits: Limits) -> CompiledSolver:
    """Compile in a new folder in `place`, and leave the library there for the next time."""
    folder = Path(tempfile.mkdtemp(prefix="compiling-", dir=place))
    try:
        library = _compile(source, folder)
        solver = _proven(library, limits)  # a library stays in memory when its file goes
        if place is not None:
            digest = sha256(library.read_bytes()).hexdigest()[:DIGITS]
            with suppress(OSError):
                library.chmod(0o700)
                library.replace(place / f"mpc-{key}-{digest}.so")
        return solver
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def cache_folder() -> Path | None:
    """Where libraries are kept: koordgen in the user's cache folder, like other programs' caches. None without one.

    Not beside the bundle: in the simulator that is a folder of a bundle, which must hold nothing but its own files.
    """
    given = os.environ.get("XDG_CACHE_HOME", "")
    try:
        return Path(given if os.path.isabs(given) else Path.home() / ".cache") / "koordgen"
    except RuntimeError:  # no home
        return None


def _private(folder: Path) -> bool:
    """Whether the folder is there or could be made, is ours, and cannot be written by others."""
    with suppress(OSError):  # there already, or cannot be made
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700)
    try:
        return _ours(folder)
    except OSError:
        return False


def _ours(path: Path) -> bool:
    """Whether it is ours, and nobody else may write it; a link never is, for all may write one."""
    found = path.lstat()
    return found.st_uid == os.geteuid() and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _sound(path: Path) -> bool:
    """Whether a library is ours, and the file that was written: loading a truncated one would end the process."""
    return _ours(path) and path.stem.endswith("-" + sha256(path.read_bytes()).hexdigest()[:DIGITS])


def _proven(library: Path, limits: Limits) -> CompiledSolver:
    probe = CompiledSolver(library, PROBE_LIMITS)
    answer = probe(PROBE_STATE, PROBE_WISHED * STEPS, [0.0] * INPUTS * STEPS)
    if answer is None or not all(abs(answer[i] - PROBE_ANSWER[i]) <= PROBE_TOLERANCE for i in range(INPUTS)):
        raise NotCompiled("the compiled solver gives a wrong answer to a known problem")
    return CompiledSolver(library, limits)


def _compile(source: bytes, folder: Path) -> Path:
    compiler = next((found for name in COMPILERS if (found := shutil.which(name))), None)
    if compiler is None:
        raise NotCompiled(f"there is no C compiler ({', '.join(COMPILERS)})")
    code, library = folder / "mpc.c", folder / "mpc.so"
    code.write_bytes(source)
    command = [compiler, *FLAGS, "-o", str(library), str(code), "-lm"]
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, timeout=PATIENCE, cwd=folder, check=False
        )
    except subprocess.TimeoutExpired:
        raise NotCompiled(f"{compiler} had not compiled the solver after {PATIENCE:.0f} s") from None
    if done.returncode or not library.is_file():
        told = done.stderr.decode(errors="replace").strip().splitlines() or ["no message"]
        raise NotCompiled(f"{compiler} failed with status {done.returncode}: {told[0][:200]}")
    return library
