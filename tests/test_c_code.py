"""The C code that robots compile: without a warning, and without what gcc's analyzer finds on its paths."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

from koordgen.runtime import courier
from targets.car.solver import compiled

ROOT = Path(__file__).parents[1]
FLAGS = {courier.SOURCE: courier.FLAGS, compiled.SOURCE: compiled.FLAGS}
WARNINGS = ("-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion", "-Werror")


def gcc(source: Path, flags: Sequence[str]) -> str:
    """What it has to say."""
    command = ["gcc", *flags, "-c", str(source), "-o", "/dev/null"]
    return subprocess.run(command, capture_output=True, text=True).stderr


def test_no_file_is_left_out() -> None:
    found = {path for folder in ("koordgen", "targets") for path in (ROOT / folder).rglob("*.c")}
    assert found == set(FLAGS)
    assert all("-std=c99" in flags for flags in FLAGS.values())


@pytest.mark.parametrize("source", FLAGS, ids=lambda path: path.name)
@pytest.mark.parametrize("analysis", ["", "-fanalyzer"])
def test_gcc_finds_nothing(source: Path, analysis: str, tmp_path: Path) -> None:
    empty = tmp_path / "empty.c"
    empty.touch()
    if analysis and gcc(empty, [analysis]):
        pytest.skip("this gcc has no analyzer")
    assert gcc(source, [*FLAGS[source], *WARNINGS, *filter(None, [analysis])]) == ""
