"""`koordgen new NAME`: its folder can be checked, proved, built and simulated without changes."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from koordgen import cli
from koordgen.build.pipeline import check_file
from koordgen.lang.format.files import format_file


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def files(folder: Path) -> dict[str, str]:
    return {p.relative_to(folder).as_posix(): p.read_text() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_it_writes_a_program_and_a_fleet_file(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["new", "hello"]) == 0
    assert set(files(here)) == {"hello/hello.koord", "hello/fleet.yaml"}
    assert check_file("hello/hello.koord").diagnostics == ()
    result = format_file("hello/hello.koord", None, write=False)
    assert result.after == result.before
    out = capsys.readouterr().out
    assert re.findall(r"^  koordgen (\w+) hello/hello.koord", out, re.MULTILINE) == ["check", "prove", "build", "sim"]


def named(capsys: pytest.CaptureFixture[str]) -> dict[str, list[str]]:
    """Return the arguments of each command that `new` prints, by the command."""
    commands = re.findall(r"^  koordgen (.+?)(?:  +#.*)?$", capsys.readouterr().out, re.MULTILINE)
    return {command.split()[0]: command.split() for command in commands}


def test_it_is_checked_proved_and_built_as_it_is(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cli.main(["new", "hello"])
    commands = named(capsys)
    for name in ("check", "prove", "build"):
        assert cli.main(commands[name]) == 0
        told = capsys.readouterr()
        assert told.err == "", name
        if name == "prove":
            assert re.findall(r"^[A-Z]{4,}", told.out, re.MULTILINE) == ["PROVED"] * 3
    assert {p.name for p in (here / "build/hello").iterdir()} >= {"alice", "bert", "cleo"}


@pytest.mark.slow
def test_it_is_simulated_as_it_is(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every robot gets its turn, and all robots stop."""
    cli.main(["new", "hello"])
    command = [sys.executable, "-m", "koordgen", *named(capsys)["sim"]]
    done = subprocess.run(command, cwd=here, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "hello: HELD: all robots ended by themselves" in done.stdout
    assert (here / "hello/run/report.html").exists()
    logs = sorted((here / "hello/run/robots").glob("*/log.txt"))
    assert [f"robot {pid} is back" in log.read_text() for pid, log in enumerate(logs)] == [True] * 3


def test_it_never_writes_into_a_folder_that_holds_something(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "empty").mkdir()
    assert cli.main(["new", "empty"]) == 0
    before = files(here)
    capsys.readouterr()
    assert cli.main(["new", "empty"]) == 5
    assert files(here) == before
    told = capsys.readouterr().err
    assert "empty" in told and "not empty" in told and "help:" in told
    (here / "file").write_text("")
    assert cli.main(["new", "file"]) == 5
    assert "file" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "proposed"),
    [("my-robots", "my_robots"), ("2nd", "app_2nd"), ("a/b", "b"), ("Überflug", "berflug"), ("..", ""), ("x" * 99, "")],
)
def test_a_name_that_does_not_fit(here: Path, capsys: pytest.CaptureFixture[str], name: str, proposed: str) -> None:
    assert cli.main(["new", name]) == 2
    assert not files(here)
    told = capsys.readouterr().err
    assert name in told and "letters, digits and _" in told
    assert (f"`koordgen new {proposed}`" in told) if proposed else ("`koordgen new" not in told)
