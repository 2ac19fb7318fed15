"""Compiled modules of the shared memory: the same Python code, translated to C by mypyc.

The Python modules in MODULES are the only implementation. A robot whose rounds take too much CPU time can compile them
once by `python3 <bundle> --compile`. Each later start imports the modules from the library in the cache, if it was made
from the same sources for the same Python. Otherwise Python interprets the modules: slower, but with the same results.
The msgspec classes in `net.wire` and `replication.messages` stay interpreted, because mypyc cannot translate them."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import sysconfig
from collections.abc import Sequence
from functools import partial
from hashlib import sha256
from importlib import import_module
from importlib.machinery import ExtensionFileLoader, ModuleSpec
from importlib.util import find_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

from koordgen.runtime.native.loader import CompiledLibrary, NotCompiled, can_keep

ROOT = Path(__file__).resolve().parents[3]  # the folder that contains the package koordgen
MODULES = (
    *(f"koordgen.runtime.replication.{name}" for name in (
        "apply", "driver", "failure_detector", "log", "progress", "rejoin", "replica", "retransmission", "schedule",
        "state_machine", "views",
    )),
    *(f"koordgen.runtime.net.{name}" for name in (
        "assembly", "codec", "fragments", "layout", "link", "metrics", "patch", "seal", "sender", "sessions",
        "udp",
    )),
    *(f"koordgen.runtime.agent.{name}" for name in ("persistence", "rounds", "checkpoint")),
    "koordgen.runtime.values.clock",
)  # fmt: skip
GROUP = "koordgen_protocol"  # name of the library for mypyc; every compiled module imports the module GROUP__mypyc
TIMEOUT = 900.0  # seconds for a compilation, which takes minutes on a small computer
FLAGS = ("-O1", "-shared", "-fPIC", "-fwrapv", "-w", "-DNDEBUG", "-fvisibility=hidden", "-fno-semantic-interposition")
INSTALL_MYPYC = "install mypyc for this Python: `pip install 'mypy[mypyc]'`"
# The first entry of the child process's import path is the bundle. It may contain files of any name, so it is removed.
_TRANSLATE = f"""
import sys
sys.path.pop(0)
from mypyc.build import mypycify
mypycify(sys.argv[2:], target_dir=sys.argv[1], group_name={GROUP!r})
"""
_OPTIONS = ("--config-file=", f"--cache-dir={os.devnull}", "--follow-imports=silent", "--ignore-missing-imports")
_IMPORT = """
import sys
from importlib import import_module
sys.path.insert(0, sys.argv[1])
from koordgen.runtime.native import protocol
assert protocol.use(sys.argv[2:])
for name in sys.argv[2:]:
    import_module(name)
"""


def use(modules: Sequence[str] = MODULES) -> bool:
    """Make Python import the compiled modules if they are in the cache. Return whether they are.

    Call this function before any of the modules is imported."""
    try:
        found = _library(modules).find()
    except OSError:  # a source cannot be read; the later import raises an error with its name
        return False
    if found is None:
        return False
    sys.meta_path.insert(0, _Finder(found._name, modules))
    return True


def is_used() -> bool:
    """Return whether `use` has found the compiled modules in this process."""
    return any(isinstance(finder, _Finder) for finder in sys.meta_path)


def compile_modules(modules: Sequence[str] = MODULES) -> Path:
    """Compile the modules unless they are in the cache. Return the path of the library.

    This takes a minute, or several on a small computer, and half a gigabyte of memory. Raises NotCompiled."""
    library = _library(modules)
    if not can_keep():
        raise library.fails("there is no cache folder; allow this user to write to ~/.cache")
    library.load()
    found = library.find()
    if found is None:
        raise library.fails("the library cannot be written to the cache; free space in ~/.cache")
    path = Path(found._name)
    command = [sys.executable, "-c", _IMPORT, str(ROOT), *modules]
    tried = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    if tried.returncode:
        path.unlink(missing_ok=True)
        raise NotCompiled(f"the modules are compiled, but cannot be imported: {_last_line(tried.stderr)}")
    return path


class _Finder:
    """Finder of compiled modules for `sys.meta_path`. All compiled modules are in one library."""

    def __init__(self, library: str, modules: Sequence[str]) -> None:
        self._library, self._modules = library, frozenset(modules)

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        group = f"{GROUP}__mypyc"
        if name in self._modules:
            import_module(group)
        elif name != group:
            return None
        return spec_from_file_location(name, self._library, loader=ExtensionFileLoader(name, self._library))


def _library(modules: Sequence[str]) -> CompiledLibrary:
    return CompiledLibrary(
        "protocol", _identity(modules), partial(_translate, modules), partial(_prove, modules), TIMEOUT
    )


def _identity(modules: Sequence[str]) -> bytes:
    """Return a digest of everything that the library depends on.

    The library depends on all modules of the runtime, because mypyc copies constants and types of other modules."""
    paths = sorted({*ROOT.joinpath("koordgen/runtime").rglob("*.py"), *(ROOT / _path(name) for name in modules)})
    digest = sha256(" ".join([sysconfig.get_config_var("SOABI") or sys.version, *modules, *FLAGS]).encode())
    for path in paths:
        digest.update(sha256(path.read_bytes()).digest())
    return digest.digest()


def _path(name: str) -> str:
    return name.replace(".", "/") + ".py"


def _translate(modules: Sequence[str], folder: Path) -> tuple[Path, Sequence[str]]:
    """Translate the modules to C in `folder`. Return the file to compile and the flags of the compiler."""
    fails = _library(modules).fails
    mypyc = find_spec("mypyc")
    if mypyc is None or mypyc.origin is None:
        raise fails(f"the Python package mypyc is missing; {INSTALL_MYPYC}")
    headers = Path(sysconfig.get_path("include"))
    if not (headers / "Python.h").is_file():
        raise fails(f"{headers}/Python.h is missing; install it: `apt install python3-dev`")
    command = [sys.executable, "-c", _TRANSLATE, str(folder), *_OPTIONS, *map(_path, modules)]
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=TIMEOUT, cwd=ROOT, check=False
        )
    except subprocess.TimeoutExpired:
        raise fails(f"mypyc did not finish within {TIMEOUT:.0f} s") from None
    if done.returncode:
        raise fails(f"mypyc failed with status {done.returncode}: {_last_line(done.stdout + done.stderr)}")
    source = folder / "all.c"
    starts = [
        f"PyMODINIT_FUNC PyInit_{_short(m)}(void) {{ return CPyInit_{m.replace('.', '___')}(); }}" for m in modules
    ]
    source.write_text("\n".join([f'#include "__native_{GROUP}.c"', *starts, ""]))
    return source, [*FLAGS, f"-I{folder}", f"-I{Path(mypyc.origin).parent / 'lib-rt'}", f"-I{headers}"]


def _prove(modules: Sequence[str], found: ctypes.CDLL) -> None:
    """Check that the library contains the modules. Raises AttributeError for a missing module."""
    for name in modules:
        getattr(found, f"PyInit_{_short(name)}")


def _short(name: str) -> str:
    return name.rpartition(".")[2]


def _last_line(output: str) -> str:
    return (output.strip().splitlines() or ["no message"])[-1][:300]
