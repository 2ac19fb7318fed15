"""`--scenario FILE`: errors are reported at line and column, before anything runs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from koordgen.cli import main
from koordgen.cli.experiment import harness
from koordgen.fleet.scenario import read
from koordgen.lang.source import Source, Span
from targets.sim.base.schedule import read as check

LINEFORM = Path(__file__).parents[2] / "examples/lineform"
ROBOTS = ("ann", "bob", "cem")


def told(text: str) -> tuple[Any, list[tuple[str, int, int, str]]]:
    found: list[tuple[str, int, int, str]] = []

    def report(code: str, message: str, span: Span, help: str) -> None:
        found.append((code, span.line, span.column, f"{message} | {help}"))

    return read(Source("s.yaml", text), lambda plain: check(plain, ROBOTS, 30.0)[1], report), found


def test_a_right_one_is_plain_values() -> None:
    text = "network: {loss: 0.1}\nevents:\n  - {at: 2, for: 3, partition: [[ann, bob], [cem]]}\n"
    data = {"network": {"loss": 0.1}, "events": [{"at": 2, "for": 3, "partition": [["ann", "bob"], ["cem"]]}]}
    assert told(text) == (data, [])


@pytest.mark.parametrize(
    ("text", "code", "line", "column", "said"),
    [
        ("network: {loss: 2}", "F005", 1, 17, "network.loss (a part of 1) is 2"),
        ("network: {lss: 0}", "F002", 1, 11, "did you mean 'loss'"),
        ("netwrok: {loss: 0}", "F002", 1, 1, "did you mean 'network'"),
        ("network:\n  loss: 20%", "F004", 2, 9, "must be a finite number, not '20%'"),
        ("network: {loss: .nan}", "F004", 1, 17, "finite"),
        ("events:\n  - {at: 1, crash: ann}\n  - {at: 2, crash: zoe}", "F005", 3, 20, "no robot 'zoe'"),
        ("events:\n  - {at: 1, crash: ann}\n  - {at: 2, crash: ann}", "F006", 3, 10, "begins while event 0"),
        ("events:\n  - {at: 1, for: 1, restart: ann}", "F005", 2, 13, "a restart takes no time"),
        ("events:\n  - {at: 1, partition: [[ann]]}", "F003", 2, 5, "lacks 'for'"),
        ("events:\n  - at: 1\n    partition: [[ann], [ann]]\n    for: 1", "F006", 3, 25, "in two groups"),
        (
            "events:\n  - {at: 30, crash: ann}",
            "F005",
            2,
            10,
            "the run's end, at 30 s | ask for a longer",
        ),
        ("events: {}", "F004", 1, 9, "events must be a list"),
        ("links: [{from: ann}]", "F003", 1, 9, "link 0 lacks 'to'"),
        ("network: {loss: 0.1, loss: 0.2}", "F006", 1, 22, "'loss' appears twice"),
        ("events: [{at: 2020-01-01, crash: ann}]", "F004", 1, 15, "a number, a bool, a text"),
        ("- 1", "F004", 1, 1, "the scenario must be a mapping"),
        ("events: ]", "F001", 1, 9, "a value is expected here"),
        ("", "F001", 1, 1, "empty"),
        ("events: &e [*e]", "F001", 1, 13, "*e is a part of its own value"),
        ("events: [*e]", "F001", 1, 10, "undefined alias"),
        ("events: " + "[" * 3000 + "]" * 3000, "F001", 1, 108, "more than 100 deep"),
    ],
)
def test_each_mistake_at_its_place(text: str, code: str, line: int, column: int, said: str) -> None:
    data, found = told(text)
    assert data is None
    assert [f[:3] for f in found] == [(code, line, column)], found
    assert said in found[0][3]


def test_several_mistakes_in_one_run() -> None:
    found = told("events:\n  - {at: x, crash: ann}\nnetwork: {delay: -1}\n")[1]
    assert [f[:3] for f in found] == [("F004", 2, 10), ("F005", 3, 18)]


def command(*more: str) -> int:
    return main(["sim", str(LINEFORM / "lineform.koord"), "--fleet", str(LINEFORM / "fleet.yaml"), *more])


def test_the_command_refuses_a_wrong_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "s.yaml"
    file.write_text("events:\n  - {at: 1, crash: alica}\n")
    assert command("--scenario", str(file)) == 1
    error = capsys.readouterr().err
    assert f"{file}:2:20: error[F005]: no robot 'alica' in this fleet" in error and "did you mean 'alice'?" in error
    assert command("--scenario", str(tmp_path / "none.yaml")) == 1
    assert "error[F100]: the file cannot be read: No such file" in capsys.readouterr().err


def test_the_bundle_gets_it_as_json_and_the_flags_as_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, seen = tmp_path / "s.yaml", []

    def run(words: list[str], options: object) -> int:
        given = dict(word.lstrip("-").split("=", 1) for word in words if "=" in word)
        seen.append((given, json.loads(Path(given["scenario"]).read_text())))
        return 0

    monkeypatch.setattr(harness, "_run", run)
    file.write_text("network: {jitter: 0.01}\nevents:\n  - {at: 1, for: 2, crash: alice}\n")
    assert command("--scenario", str(file), "--loss", "0.1", "--seed=3") == 0
    ((given, data),) = seen
    assert (given["loss"], given["seed"]) == ("0.1", "3") and "delay" not in given
    assert data == {"network": {"jitter": 0.01}, "events": [{"at": 1, "for": 2, "crash": "alice"}]}
