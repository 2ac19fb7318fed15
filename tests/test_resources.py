"""Generated files: written if they differ, and only reported with --check."""

from __future__ import annotations

from pathlib import Path

import pytest

from koordgen.lang.resources import freshen


def test_generated_files_become_what_is_wanted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    same, changed, new, gone = (tmp_path / name for name in ("same", "changed", "deep/new", "gone"))
    for path in (same, changed, gone):
        path.write_text("old", encoding="utf-8")
    wanted = {same: "old", changed: "new", new: "new", gone: None}
    assert freshen(wanted, ["--check"]) == 1
    told = capsys.readouterr().err.splitlines()
    assert told == [f"{path}: stale; run `make generated`" for path in (changed, new, gone)]
    assert changed.read_text(encoding="utf-8") == "old" and gone.exists() and not new.exists()
    before = same.stat().st_mtime_ns
    assert freshen(wanted, []) == 0
    assert changed.read_text(encoding="utf-8") == new.read_text(encoding="utf-8") == "new" and not gone.exists()
    assert same.stat().st_mtime_ns == before, "what is fresh is left alone"
    assert freshen(wanted, ["--check"]) == 0
