"""Programs of several applications: they can be checked, and every other command refuses them with their places."""

from __future__ import annotations

from pathlib import Path

import pytest

from koordgen.cli import main

EVENT = "local: int seen\nGo:\n  pre: found > seen\n  eff: seen = found\n"
IMPORTER = f"import Mapping:\n  int found\n{EVENT}"
EXPORTER = f"export:\n  int found\n    guarantee Low: found < 9\nallwrite: int found\n{EVENT}"
COMMANDS = (["prove"], ["explore"], ["build", "--target", "quad"], ["prove", "--attack", "0"])


@pytest.mark.parametrize("text", [IMPORTER, EXPORTER])
def test_such_a_program_can_be_checked(text: str, tmp_path: Path) -> None:
    (path := tmp_path / "a.koord").write_text(text)
    assert main(["check", str(path)]) == 0 and main(["dump", str(path), "--after", "check"]) == 0


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
@pytest.mark.parametrize(("text", "place"), [(IMPORTER, "1:8"), (EXPORTER, "3:15")])
def test_nothing_else_takes_it(
    command: list[str], text: str, place: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (path := tmp_path / "a.koord").write_text(text)
    assert main([*command, str(path)]) == 1
    assert f"a.koord:{place}: error[B011]" in capsys.readouterr().err


def test_an_export_without_a_guarantee_changes_nothing(tmp_path: Path) -> None:
    alone = EXPORTER.replace("    guarantee Low: found < 9\n", "")
    (path := tmp_path / "a.koord").write_text(alone + "invariant Seen: forall i in ID: seen[i] <= found or found < 0\n")
    assert main(["build", "--target", "quad", str(path), "--out", str(tmp_path / "out")]) == 0
