"""C code for robots: gcc and clang report no warning, and gcc's analyzer finds no fault."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

from koordgen.runtime.net import socket_batch
from targets.car.control.solver import compiled

ROOT = Path(__file__).parents[1]
FLAGS = {socket_batch.SOURCE: socket_batch.FLAGS, compiled.SOURCE: compiled.FLAGS}
WARNINGS = ("-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion", "-Werror")


def told(compiler: str, source: Path, flags: Sequence[str]) -> str:
    """Return the compiler's messages."""
    compiling = [flag for flag in flags if not flag.startswith(("-l", "-shared"))]
    command = [compiler, *compiling, "-c", str(source), "-o", "/dev/null"]
    return subprocess.run(command, capture_output=True, text=True).stderr


def test_no_file_is_left_out() -> None:
    found = {path for folder in ("koordgen", "targets") for path in (ROOT / folder).rglob("*.c")}
    assert found == set(FLAGS)
    assert all("-std=c99" in flags for flags in FLAGS.values())


@pytest.mark.parametrize("source", FLAGS, ids=lambda path: path.name)
@pytest.mark.parametrize(("compiler", "analysis"), [("gcc", []), ("gcc", ["-fanalyzer"]), ("clang", [])])
def test_compilers_find_nothing(source: Path, compiler: str, analysis: list[str], tmp_path: Path) -> None:
    if shutil.which(compiler) is None:
        pytest.skip(f"there is no {compiler}")
    empty = tmp_path / "empty.c"
    empty.touch()
    if analysis and told(compiler, empty, analysis):
        pytest.skip("this gcc has no analyzer")
    assert told(compiler, source, [*FLAGS[source], *WARNINGS, *analysis]) == ""
