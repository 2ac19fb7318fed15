"""The shared memory's modules, compiled: the same tests pass, and a library is used for its own sources only."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Sequence
from pathlib import Path

import pytest

from koordgen.runtime.native import protocol
from tests.runtime.net.transports import COMPILER

HEADERS = Path(sysconfig.get_path("include"), "Python.h").is_file()
needs_compiler = pytest.mark.skipif(not (COMPILER and HEADERS), reason="there is no C compiler, or no Python.h")
ROOT = Path(__file__).resolve().parents[3]
ONE = ("koordgen.runtime.net.seal",)  # compiles in seconds
NET = "tests/runtime/net"
REPLICATION = "tests/runtime/replication"
TESTS = (f"{NET}/test_layout.py", f"{REPLICATION}/test_driver.py", f"{REPLICATION}/test_large.py")
COMPOSED = ("tests/composed/test_agent.py", "tests/composed/test_store.py")
MORE_TESTS = (NET, REPLICATION, "tests/model", "tests/runtime/agent", *COMPOSED)
SCRIPT = """
import sys
from koordgen.runtime.native import protocol
from koordgen.runtime.native.loader import NotCompiled
if sys.argv[1] == "compile":
    try:
        protocol.compile_modules(sys.argv[2:])
    except NotCompiled as error:
        print(error)
elif protocol.use(sys.argv[2:]):
    from koordgen.runtime.net import seal
    key = bytes(32)
    assert seal.unseal(key, b"test", seal.seal(key, b"test", b"payload")) == b"payload"
    assert seal.__file__.endswith(".so") and protocol.is_used()
    print("used")
"""


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    """A folder with the runtime, as in a bundle."""
    shutil.copytree(ROOT / "koordgen/runtime", tmp_path / "koordgen/runtime", ignore=shutil.ignore_patterns("*.pyc"))
    shutil.copy(ROOT / "koordgen/__init__.py", tmp_path / "koordgen")
    return tmp_path


def run(robot: Path, what: str, **environment: str) -> str:
    """Return what a new process of the robot prints."""
    known = {**os.environ, "PYTHONPATH": str(robot), "XDG_CACHE_HOME": str(robot / "cache"), **environment}
    command = [sys.executable, "-c", SCRIPT, what, *ONE]
    done = subprocess.run(command, cwd=robot, env=known, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def passes(tests: Sequence[str]) -> None:
    command = [sys.executable, "-m", "pytest", "-p", "tests.compiled", "-p", "no:cacheprovider", "-m", "not slow"]
    done = subprocess.run([*command, *tests], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
@needs_compiler
def test_the_compiled_modules_pass_the_same_tests() -> None:
    passes(TESTS)


def test_a_missing_cache_folder_is_reported_before_anything_is_compiled(robot: Path) -> None:
    told = run(robot, "compile", XDG_CACHE_HOME="/proc/none", PATH="")
    assert "no cache folder" in told


@needs_compiler
@pytest.mark.slow
def test_the_compiled_modules_pass_the_tests_of_whole_fleets() -> None:
    passes(MORE_TESTS)


@pytest.mark.slow
@needs_compiler
def test_a_library_is_used_for_exactly_its_sources(robot: Path) -> None:
    assert run(robot, "use") == "", "nothing was compiled yet"
    assert run(robot, "compile") == ""
    assert run(robot, "use") == "used"
    other = robot / "koordgen/runtime/net/wire.py"
    text = other.read_text()
    other.write_text(text + "# changed on the robot\n")
    assert run(robot, "use") == "", "the code may contain what another module said"
    other.write_text(text)
    assert run(robot, "use") == "used"
    assert {path.name for path in robot.iterdir()} == {"koordgen", "cache"}, "the bundle has no new file"
    (library,) = (robot / "cache/koordgen").iterdir()
    library.write_bytes(library.read_bytes()[:-100])
    assert run(robot, "use") == "", "a damaged library is not loaded"
    assert not library.exists()


@pytest.mark.slow
@needs_compiler
def test_what_cannot_be_compiled_is_an_error_with_its_reason(robot: Path) -> None:
    seal = robot / "koordgen/runtime/net/seal.py"
    text = seal.read_text()
    seal.write_text(text + "wrong: int = 'text'\n")
    found = run(robot, "compile")
    assert "mypyc failed with status 1: " in found and "seal.py" in found and "Incompatible types" in found
    seal.write_text(text + "raise ValueError('not on this robot')\n")
    found = run(robot, "compile")
    assert found == "the modules are compiled, but cannot be imported: ValueError: not on this robot"
    assert run(robot, "use") == "", "it is not kept"
    assert "there is no C compiler" in run(robot, "compile", PATH="")


def test_no_compiled_module_has_a_class_with_options() -> None:
    """mypyc ignores class options such as `frozen` and `tag`, and gives no warning."""
    for name in protocol.MODULES:
        path = ROOT / (name.replace(".", "/") + ".py")
        for node in ast.walk(ast.parse(path.read_text())):
            assert not (isinstance(node, ast.ClassDef) and node.keywords), f"{path}:{node.lineno}"
            bases = [ast.unparse(base) for base in node.bases] if isinstance(node, ast.ClassDef) else []
            assert "msgspec.Struct" not in bases, path
