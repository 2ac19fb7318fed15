"""`koordgen docs` and `koordgen examples` for a user who has only the wheel."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from koordgen import cli

ROOT = Path(__file__).parents[2]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_docs_lists_the_pages_and_where_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["docs"]) == 0
    out = capsys.readouterr().out
    listed = re.findall(r"^  ([a-z-]+)  +(\S.*)$", out, re.MULTILINE)
    files = [p for p in (ROOT / "docs").rglob("*.md") if p.parent.name != "adr" and p.name != "README.md"]
    names = [p.stem for p in files]
    assert len(set(names)) == len(names), "`koordgen docs PAGE` names no folder"
    assert [name for name, _ in listed if name in ("readme", "map")] == ["readme", "map"]
    assert sorted(name for name, _ in listed) == sorted(["readme", "map", *names])
    assert dict(listed)["fleet"] == "The fleet file"
    assert str(ROOT / "docs") in out


@pytest.mark.parametrize(
    ("page", "file"),
    [
        ("fleet", "docs/reference/fleet.md"),
        ("readme", "README.md"),
        ("adr/0001-order-of-events", "docs/adr/0001-order-of-events.md"),
    ],
)
def test_docs_prints_a_page(page: str, file: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["docs", page]) == 0
    assert capsys.readouterr().out == (ROOT / file).read_text(encoding="utf-8")


def test_docs_prints_a_section_with_its_subsections(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["docs", "cli#a-robots-bundle"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("## A robot's bundle\n")
    assert "\n### status\n" in out and "\n## " not in out and out.endswith("\n")


@pytest.mark.parametrize(
    ("page", "near"),
    [("fleets", "fleet"), ("docs/reference/fleet.md", "fleet"), ("cli#fmtt", "cli#fmt"), ("../LICENSE", "")],
)
def test_docs_of_a_page_that_is_not_there(page: str, near: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["docs", page]) == 2
    told = capsys.readouterr().err
    assert page in told and (f"`koordgen docs {near}`" in told if near else "`koordgen docs`" in told)


def test_examples_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["examples"]) == 0
    out = capsys.readouterr().out
    listed = re.findall(r"^  ([a-z]+)  +(\S.*)$", out, re.MULTILINE)
    assert [name for name, _ in listed] == sorted(p.name for p in (ROOT / "examples").iterdir())
    assert "robots line up" in dict(listed)["lineform"]
    assert "koordgen examples copy" in out


def test_an_example_is_copied_so_that_its_commands_work(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["examples", "copy", "lineform"]) == 0
    assert "examples/lineform/README.md" in capsys.readouterr().out
    there = {p.name: p.read_bytes() for p in (here / "examples/lineform").iterdir()}
    wanted = {p.name: p.read_bytes() for p in (ROOT / "examples/lineform").iterdir() if p.is_file()}
    assert there == wanted
    assert cli.main(["check", "examples/lineform/lineform.koord"]) == 0


def test_a_copy_elsewhere_says_its_own_place(here: Path) -> None:
    assert cli.main(["examples", "copy", "lineform", "my/line"]) == 0
    readme = (here / "my/line/README.md").read_text()
    assert "koordgen build my/line/lineform.koord" in readme and "examples/lineform" not in readme
    assert not (here / "examples").exists()


def test_a_copy_never_overwrites(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "mine").mkdir()
    (here / "mine/notes.txt").write_text("mine")
    assert cli.main(["examples", "copy", "election", "mine"]) == 0, "other files may be there"
    (here / "mine/election.koord").write_text("changed")
    (here / "mine/fleet.yaml").unlink()
    capsys.readouterr()
    assert cli.main(["examples", "copy", "election", "mine"]) == 5
    assert "mine/election.koord" in capsys.readouterr().err
    assert (here / "mine/election.koord").read_text() == "changed"
    assert not (here / "mine/fleet.yaml").exists(), "nothing is written when something is in the way"


@pytest.mark.parametrize("arguments", [["linefrom"], ["../lineform"], []])
def test_a_copy_of_what_is_not_there(here: Path, capsys: pytest.CaptureFixture[str], arguments: list[str]) -> None:
    assert cli.main(["examples", "copy", *arguments]) == 2
    told = capsys.readouterr().err
    assert "lineform" in told and "`koordgen examples`" in told
    assert not list(here.iterdir())


def test_a_folder_that_cannot_be_written(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "file").write_text("")
    assert cli.main(["examples", "copy", "election", "file/x"]) == 5
    assert "file/x" in capsys.readouterr().err
