"""SARIF: structure of version 2.1.0, right places, and file names in the form that code hosts need."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import pytest
from hypothesis import given
from hypothesis import strategies as st

from koordgen import __version__
from koordgen.cli import main
from koordgen.cli.base.sarif import to_sarif
from koordgen.lang.diagnostics import CATALOGUE, Diagnostic, Label
from koordgen.lang.source import Source, Span

FOLDER = Path("/work")


def validate(log: Any) -> None:
    """Check the properties that we write against the standard (its section 3), and that there are no others."""
    assert set(log) == {"$schema", "version", "runs"}
    assert log["version"] == "2.1.0"
    assert urlsplit(log["$schema"]).scheme == "https"
    (run,) = log["runs"]
    assert set(run) == {"tool", "columnKind", "results"}
    assert run["columnKind"] in ("utf16CodeUnits", "unicodeCodePoints")
    assert set(run["tool"]) == {"driver"}
    driver = run["tool"]["driver"]
    assert set(driver) == {"name", "version", "rules"}
    assert driver["name"] and driver["version"]
    ids = [rule["id"] for rule in driver["rules"]]
    assert len(set(ids)) == len(ids)
    for rule in driver["rules"]:
        assert set(rule) == {"id", "shortDescription", "help"}
        message(rule["shortDescription"], set())
        message(rule["help"], {"markdown"})
    for result in run["results"]:
        assert set(result) - {"relatedLocations"} == {"ruleId", "ruleIndex", "level", "message", "locations"}
        assert ids[result["ruleIndex"]] == result["ruleId"]
        assert result["level"] in ("none", "note", "warning", "error")
        message(result["message"], set())
        assert len(result["locations"]) == 1
        for place in result["locations"]:
            assert set(place) == {"physicalLocation"}
            physical(place["physicalLocation"])
        for place in result.get("relatedLocations", []):
            assert set(place) == {"physicalLocation", "message"}
            physical(place["physicalLocation"])
            message(place["message"], set())


def message(value: Any, more: set[str]) -> None:
    assert set(value) == {"text"} | more
    for text in value.values():
        assert isinstance(text, str)
        assert text
        left = text.replace("{{", "").replace("}}", "")
        assert "{" not in left and "}" not in left, "single braces are placeholders (3.11.5)"


def physical(value: Any) -> None:
    assert set(value) == {"artifactLocation", "region"}
    assert set(value["artifactLocation"]) == {"uri"}
    uri = value["artifactLocation"]["uri"]
    assert uri.isascii() and " " not in uri and "\\" not in uri
    assert urlsplit(uri).scheme in ("", "file")
    region = value["region"]
    assert set(region) == {"startLine", "startColumn", "endLine", "endColumn"}
    assert all(type(n) is int and n >= 1 for n in region.values())
    start, end = (region["startLine"], region["startColumn"]), (region["endLine"], region["endColumn"])
    assert start <= end


def logged(*found: tuple[Source, Diagnostic]) -> Any:
    log = json.loads(to_sarif(found, FOLDER))
    validate(log)
    return log["runs"][0]


def wrong(code: str = "K010", text: str = "y is not defined") -> Diagnostic:
    return Diagnostic(code, "error", text, Span(2, 3, 2, 4))


def test_a_run_without_findings() -> None:
    run = logged()
    assert run["results"] == []
    assert run["tool"]["driver"] == {"name": "koordgen", "version": __version__, "rules": []}


def test_a_finding() -> None:
    label = Label(Span(1, 1, 1, 6), "declared here first")
    found = Diagnostic("K011", "warning", "a is declared twice", Span(2, 3, 2, 8), (label,), "choose another name")
    run = logged((Source("a.koord", ""), found))
    (result,) = run["results"]
    assert (result["ruleId"], result["level"]) == ("K011", "warning")
    assert result["message"]["text"] == "a is declared twice\nhelp: choose another name"
    place = result["locations"][0]["physicalLocation"]
    assert place["artifactLocation"]["uri"] == "a.koord"
    assert place["region"] == {"startLine": 2, "startColumn": 3, "endLine": 2, "endColumn": 8}
    assert result["relatedLocations"][0]["message"]["text"] == "declared here first"
    assert result["relatedLocations"][0]["physicalLocation"]["region"]["startLine"] == 1
    (rule,) = run["tool"]["driver"]["rules"]
    assert rule["shortDescription"]["text"] == CATALOGUE["K011"]
    assert "On robots: " in rule["help"]["text"]
    assert "```koord" in rule["help"]["markdown"]


def test_several_sources_and_a_rule_for_each_code_once() -> None:
    program, fleet = Source("a.koord", ""), Source("fleet.yaml", "")
    run = logged((program, wrong("K012")), (fleet, wrong("F002")), (program, wrong("K010")), (program, wrong("K012")))
    assert [rule["id"] for rule in run["tool"]["driver"]["rules"]] == ["F002", "K010", "K012"]
    assert [r["ruleIndex"] for r in run["results"]] == [2, 0, 1, 2]
    uris = [r["locations"][0]["physicalLocation"]["artifactLocation"]["uri"] for r in run["results"]]
    assert uris == ["a.koord", "fleet.yaml", "a.koord", "a.koord"]


@pytest.mark.parametrize("code", CATALOGUE)
def test_every_code_can_be_a_rule(code: str) -> None:
    logged((Source("a.koord", ""), wrong(code)))


@pytest.mark.parametrize(
    ("path", "uri"),
    [
        ("apps/a.koord", "apps/a.koord"),
        ("./apps/../a.koord", "a.koord"),
        ("/work/apps/a.koord", "apps/a.koord"),
        ("/elsewhere/a.koord", "file:///elsewhere/a.koord"),
        ("../a.koord", "file:///a.koord"),
        ("/workshop/a.koord", "file:///workshop/a.koord"),
        ("line form#1?.koord", "line%20form%231%3F.koord"),
        ("c:a.koord", "c%3Aa.koord"),
        ("é.koord", "%C3%A9.koord"),
        ("\udcff.koord", "%FF.koord"),
    ],
)
def test_uris(path: str, uri: str) -> None:
    (result,) = logged((Source(path, ""), wrong()))["results"]
    assert result["locations"][0]["physicalLocation"]["artifactLocation"]["uri"] == uri


@given(st.text(min_size=1), st.text())
def test_messages_are_kept_whatever_they_hold(text: str, path: str) -> None:
    (result,) = json.loads(to_sarif([(Source(path.replace("\0", ""), ""), wrong(text=text))], FOLDER))["runs"][0][
        "results"
    ]
    assert result["message"]["text"].replace("{{", "{").replace("}}", "}") == text


PROGRAM = """\
using Motion:
  sensors: Point position
  actuators: Point target
    float altitude
local: int count
Go:
  pre: count < 3
  eff: count += 1
"""
FLEET = """\
dleta: 0.1
origin: {latitude: 47.4, longitude: 8.5, altitude: 488}
geofence: {lo: [-6, -5, -1], hi: [6, 5, 4]}
robots:
  - {name: alice, target: quad, address: "127.0.0.1:47100"}
"""


@pytest.mark.parametrize(
    ("command", "old", "new", "code", "line", "file"),
    [
        (["check", "a.koord"], "count < 3", "coun < 3", "K010", 7, "a.koord"),
        (["dump", "a.koord"], "count < 3", "coun < 3", "K010", 7, "a.koord"),
        (["check", "b.koord"], "", "", "F100", 1, "b.koord"),
        (["build", "a.koord", "--target", "quad"], "", "", "B002", 4, "a.koord"),
        (["build", "a.koord", "--target", "quad", "--fleet", "fleet.yaml"], "", "", "F002", 1, "fleet.yaml"),
        (["sim", "a.koord", "--fleet", "fleet.yaml"], "", "", "F002", 1, "fleet.yaml"),
    ],
)  # fmt: skip
def test_commands(
    command: list[str], old: str, new: str, code: str, line: int, file: str, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path("a.koord").write_text(PROGRAM.replace(old, new))
    Path("fleet.yaml").write_text(FLEET)
    assert main([*command, "--format", "sarif"]) == 1
    told = capsys.readouterr()
    assert told.err == ""
    log = json.loads(told.out)
    validate(log)
    (result,) = log["runs"][0]["results"]
    place = result["locations"][0]["physicalLocation"]
    assert (result["ruleId"], place["region"]["startLine"]) == (code, line)
    assert unquote(place["artifactLocation"]["uri"]) == file


def test_columns_count_characters(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.koord"
    path.write_text("local: bool on\nGo:\n  pre: on\n  eff: 𝕒\n", encoding="utf-8")
    assert main(["check", str(path), "--format", "sarif"]) == 1
    run = json.loads(capsys.readouterr().out)["runs"][0]
    assert run["columnKind"] == "unicodeCodePoints"
    region = run["results"][0]["locations"][0]["physicalLocation"]["region"]
    assert (region["startColumn"], region["endColumn"]) == (8, 9)
