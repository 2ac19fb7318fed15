"""`koordgen fmt` on real files: what is written, what is told, and that nothing is lost when the disk refuses."""

from __future__ import annotations

import errno
import io
import json
import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from koordgen.cli import main
from koordgen.cli.base.sarif import to_sarif
from koordgen.lang.diagnostics import Diagnostic, Edit, to_json
from koordgen.lang.source import Source, Span

UGLY = "param int a=1\nGo:\n   pre: a==1  \n   eff: pass"
NEAT = "param int a = 1\n\nGo:\n  pre: a == 1\n  eff: pass\n"
WRONG = "param int a=\nGo:\n   pre: a\n"

Output = pytest.CaptureFixture[str]


@pytest.fixture
def ugly(tmp_path: Path) -> Path:
    path = tmp_path / "ugly.koord"
    path.write_text(UGLY)
    return path


def test_files_are_formatted_in_place_once(ugly: Path, capsys: Output) -> None:
    ugly.chmod(0o640)
    assert main(["fmt", str(ugly)]) == 0
    assert capsys.readouterr() == (f"{ugly}: formatted\n", "")
    assert ugly.read_bytes() == NEAT.encode()
    assert ugly.stat().st_mode & 0o777 == 0o640
    before = ugly.stat()
    assert main(["fmt", str(ugly)]) == 0
    assert capsys.readouterr() == ("", "")
    assert (ugly.stat().st_ino, ugly.stat().st_mtime_ns) == (before.st_ino, before.st_mtime_ns)
    assert os.listdir(ugly.parent) == ["ugly.koord"]


@pytest.mark.parametrize("raw", [b"\xef\xbb\xbf" + NEAT.encode(), NEAT.replace("\n", "\r\n").encode()])
def test_line_ends_and_marks_are_settled_too(raw: bytes, ugly: Path) -> None:
    ugly.write_bytes(raw)
    assert main(["fmt", "--check", str(ugly)]) == 1
    assert main(["fmt", str(ugly)]) == 0
    assert ugly.read_bytes() == NEAT.encode()


def test_check_writes_nothing(ugly: Path, capsys: Output) -> None:
    neat = ugly.with_name("neat.koord")
    neat.write_text(NEAT)
    assert main(["fmt", "--check", str(ugly), str(neat)]) == 1
    assert capsys.readouterr() == (f"{ugly}: would be formatted\n", "")
    assert ugly.read_text() == UGLY
    assert main(["fmt", "--check", str(neat)]) == 0


def test_diff_writes_nothing(ugly: Path, capsys: Output) -> None:
    assert main(["fmt", "--diff", str(ugly)]) == 1
    told = capsys.readouterr().out.splitlines()
    assert told[:2] == [f"--- {ugly}", f"+++ {ugly} (formatted)"]
    assert "-param int a=1" in told and "+param int a = 1" in told
    assert "\\ No newline at end of file" in told
    assert ugly.read_text() == UGLY


def test_a_file_with_mistakes_is_not_touched_and_does_not_stop_others(ugly: Path, capsys: Output) -> None:
    wrong = ugly.with_name("wrong.koord")
    wrong.write_text(WRONG)
    missing = ugly.with_name("missing.koord")
    assert main(["fmt", str(wrong), str(missing), str(ugly)]) == 1
    out, err = capsys.readouterr()
    assert out == f"{ugly}: formatted\n"
    assert f"{wrong}:1:" in err and f"{missing}:1:1: error[F100]" in err
    assert "2 errors" in err
    assert wrong.read_text() == WRONG
    assert ugly.read_text() == NEAT


def test_no_utf8(ugly: Path, capsys: Output) -> None:
    ugly.write_bytes(b"# a\n# \xff\n")
    assert main(["fmt", str(ugly)]) == 1
    assert f"{ugly}:2:1: error[F101]" in capsys.readouterr().err


def test_json(ugly: Path, capsys: Output) -> None:
    wrong = ugly.with_name("wrong.koord")
    wrong.write_text(WRONG)
    assert main(["fmt", "--format", "json", str(ugly), str(wrong), str(ugly)]) == 1
    out, err = capsys.readouterr()
    document = json.loads(out)
    assert document["files"] == [
        {"file": str(ugly), "changed": True},
        {"file": str(wrong), "changed": False},
        {"file": str(ugly), "changed": False},
    ]
    assert [d["file"] for d in document["diagnostics"]] == [str(wrong)]
    assert err == ""


def given(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(text.encode())))


def test_standard_input(monkeypatch: pytest.MonkeyPatch, capsys: Output) -> None:
    given(UGLY, monkeypatch)
    assert main(["fmt", "-"]) == 0
    assert capsys.readouterr() == (NEAT, "")
    given(NEAT, monkeypatch)
    assert main(["fmt", "-"]) == 0
    assert capsys.readouterr().out == NEAT
    given(WRONG, monkeypatch)
    assert main(["fmt", "-"]) == 1
    out, err = capsys.readouterr()
    assert out == "" and "error[" in err
    given(UGLY, monkeypatch)
    assert main(["fmt", "--check", "-"]) == 1
    assert capsys.readouterr().out == "-: would be formatted\n"
    given(UGLY, monkeypatch)
    assert main(["fmt", "--format", "json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["files"] == [{"file": "-", "changed": True, "text": NEAT}]


def test_a_link_stays_a_link(ugly: Path) -> None:
    folder = ugly.parent / "elsewhere"
    folder.mkdir()
    link = folder / "link.koord"
    link.symlink_to("../ugly.koord")
    assert main(["fmt", str(link)]) == 0
    assert link.is_symlink()
    assert ugly.read_text() == NEAT
    assert os.listdir(folder) == ["link.koord"]


def refused(path: Path, capsys: Output) -> str:
    """Formats a file that cannot be written; nothing may change."""
    before = sorted(os.listdir(path.parent))
    other = path.parent / "zz.koord"
    other.write_text(UGLY)
    assert main(["fmt", str(path), str(other)]) == 5
    assert path.read_text() == UGLY
    assert sorted(os.listdir(path.parent)) == sorted([*before, "zz.koord"])
    return capsys.readouterr().err


def test_a_read_only_file_is_refused(ugly: Path, capsys: Output) -> None:
    ugly.chmod(0o444)
    assert f"error: {ugly}: is read-only\n" in refused(ugly, capsys)
    assert ugly.with_name("zz.koord").read_text() == NEAT, "other files are formatted all the same"


@pytest.mark.parametrize("call", ["fchmod", "replace"])
def test_a_disk_that_refuses_loses_nothing(
    call: str, ugly: Path, capsys: Output, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, call, full)
    assert f"{ugly}: No space left on device" in refused(ugly, capsys)


def test_a_disk_that_is_full_while_writing_loses_nothing(
    ugly: Path, capsys: Output, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = os.fdopen

    def full(descriptor: int, mode: str) -> object:
        os.close(descriptor)
        return real(os.open("/dev/full", os.O_WRONLY), mode)

    monkeypatch.setattr(os, "fdopen", full)
    assert f"{ugly}: No space left on device" in refused(ugly, capsys)


def test_what_is_no_file_is_not_replaced(tmp_path: Path, capsys: Output) -> None:
    reader, writer = os.pipe()
    os.write(writer, UGLY.encode())
    os.close(writer)
    assert main(["fmt", f"/dev/fd/{reader}"]) == 5
    assert "is not a regular file" in capsys.readouterr().err
    os.close(reader)


def test_edits_are_told_to_machines() -> None:
    source = Source("/work/a.koord", "local: bool b = true\n")
    span = Span(1, 17, 1, 21)
    told = Diagnostic("K001", "note", "old", span, help="write {True}", edits=(Edit(span, "{True}"),))
    place = {"line": 1, "column": 17, "end_line": 1, "end_column": 21}
    (as_json,) = json.loads(to_json([(source, told)]))["diagnostics"]
    assert as_json["edits"] == [{**place, "text": "{True}"}]
    (result,) = json.loads(to_sarif([(source, told)], Path("/work")))["runs"][0]["results"]
    region = {"startLine": 1, "startColumn": 17, "endLine": 1, "endColumn": 21}
    change = {
        "artifactLocation": {"uri": "a.koord"},
        "replacements": [{"deletedRegion": region, "insertedContent": {"text": "{True}"}}],
    }
    assert result["fixes"] == [{"description": {"text": "write {{True}}"}, "artifactChanges": [change]}]
