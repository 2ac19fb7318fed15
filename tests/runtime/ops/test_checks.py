"""How findings are told: in a narrow table, as JSON, in short; and which exit status they come to."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from koordgen.runtime.ops.checks import print_briefly, print_checks, report_unloadable, row, status
from koordgen.runtime.vehicle.platform import Finding, Unready

OK = Finding("link", "ok", "autopilot on udpin:0.0.0.0:14550, system 1")
WARN = Finding("streams", "warn", "GLOBAL_POSITION_INT 7 of 20 Hz", "what was asked for", "raise the link's baud rate")
FAIL = Finding("FS_GCS_ENABLE", "fail", "0", "5", "else it does not land when the agent dies")


@pytest.mark.parametrize(
    ("failed", "wanted"),
    [([], 0), (["link"], 5), (["files"], 1), (["settings", "link"], 1), (["program"], 1), (["key"], 1), (["body"], 1)],
)
def test_statuses(failed: list[str], wanted: int) -> None:
    assert status([WARN, OK, *(Finding(name, "fail", "") for name in failed)]) == wanted


@pytest.mark.parametrize("width", [40, 60, 100])
def test_rows_are_as_narrow_as_a_phone(width: int) -> None:
    for finding in (OK, WARN, FAIL):
        lines = row(finding, width).splitlines()
        assert max(map(len, lines)) <= width, lines
        assert all(line.startswith(" " * 17) for line in lines[1:]), lines
        assert " ".join(finding.found.split()) in " ".join(" ".join(lines).split())


def test_a_row_word_by_word() -> None:
    assert row(WARN, 100).splitlines() == [
        "warn  streams    GLOBAL_POSITION_INT 7 of 20 Hz",
        "                 wanted: what was asked for",
        "                 raise the link's baud rate",
    ]
    assert row(FAIL, 100).splitlines()[0] == "FAIL  FS_GCS_ENABLE 0"
    assert row(OK, 100) == "ok    link       autopilot on udpin:0.0.0.0:14550, system 1"


def test_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert print_checks("app", iter([OK, WARN, FAIL]), "text") == 5
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("ok    link") and lines[-1] == "3 checks: 1 failed, 1 warnings"


def test_the_document(capsys: pytest.CaptureFixture[str]) -> None:
    assert print_checks("app", [OK, WARN], "json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["app"] == "app" and told["status"] == 0
    assert told["checks"][1] == {
        "name": "streams", "state": "warn", "found": WARN.found, "wanted": WARN.wanted, "why": WARN.why,
    }  # fmt: skip


def test_in_short_it_ends_at_the_first_failure(capsys: pytest.CaptureFixture[str]) -> None:
    left = iter([OK, WARN, FAIL, OK])
    assert print_briefly(left) == 5 and list(left) == [OK]
    told = capsys.readouterr()
    assert told.out == "link       autopilot on udpin:0.0.0.0:14550, system 1\n"
    assert told.err.splitlines()[2:] == [
        "error: FS_GCS_ENABLE: 0; wanted: 5", "  help: else it does not land when the agent dies",
    ]  # fmt: skip


def test_an_unready_is_a_finding() -> None:
    assert Finding.of("link", Unready("silent", "plug it in")) == Finding("link", "fail", "silent", why="plug it in")


@pytest.mark.parametrize("options", [[], ["--doctor"]])
def test_a_missing_file_of_the_bundle_is_no_missing_package(
    options: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "requirements.txt").write_text("")
    (tmp_path / "SHA256SUMS").write_text(f"{'0' * 64}  program_task.py\n")
    error = ImportError("No module named 'program_task'", name="program_task")
    assert report_unloadable(tmp_path, options, error) == 1
    told = "".join(capsys.readouterr())
    assert "program_task.py is missing" in told and "copy all of it" in told and "pip" not in told


def test_a_bundle_that_cannot_be_imported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "requirements.txt").write_text("nobody-has-this==1.0\n")
    error = ImportError("No module named 'nobody'", name="nobody")
    assert report_unloadable(tmp_path, ["--doctor", "--format", "json"], error) == 5
    found = {f["name"]: f for f in json.loads(capsys.readouterr().out)["checks"]}
    assert found["packages"]["state"] == found["import"]["state"] == "fail"
    assert report_unloadable(tmp_path, [], error) == 5
    told = capsys.readouterr()
    assert told.out == "" and "the Python package 'nobody' is missing" in told.err and "pip install -r" in told.err
