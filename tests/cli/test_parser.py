"""Usage errors propose what to do, options cannot be abbreviated, and help explains each command and option."""

from __future__ import annotations

import argparse
import re
import shlex
from collections.abc import Sequence
from pathlib import Path

import pytest

from koordgen import __version__
from koordgen.cli import _COMMANDS, main
from koordgen.cli.base.parser import Parser
from koordgen.cli.commands import COMMANDS, harnesses, parsed
from targets.sim.base.schedule import DURATION, MOST_DELAY

ROOT = Path(__file__).parents[2]
EVERYTHING = {**COMMANDS, **harnesses()}


def left(arguments: Sequence[str]) -> int:
    """Return the exit status of a command that may raise SystemExit, as argparse does."""
    try:
        return main(arguments)
    except SystemExit as ended:
        assert isinstance(ended.code, int)
        return ended.code


def test_robots_may_stand_before_and_behind_options() -> None:
    assert parsed(["logs", "fleet.yaml", "alice", "--follow", "bert", "cleo"]).robots == ["alice", "bert", "cleo"]


@pytest.mark.parametrize(
    ("arguments", "usage", "words"),
    [
        ("chek app.koord", "koordgen COMMAND", "did you mean check?"),
        ("simm app.koord", "koordgen COMMAND", "did you mean sim?"),
        ("", "koordgen COMMAND", "`koordgen help` lists the commands"),
        ("--fleet f.yaml build", "koordgen COMMAND", "the option --fleet comes before the command"),
        ("sim app.koord --duraton 10", "koordgen sim APP.koord", "did you mean --duration?"),
        ("sim app.koord --duraton=10", "koordgen sim APP.koord", "no option --duraton"),
        ("sim --flet fleet.yaml app.koord", "koordgen sim APP.koord", "did you mean --fleet?"),
        ("check app.koord --form json", "koordgen check APP.koord", "did you mean --format?"),
        ("prove app.koord --att 1", "koordgen prove APP.koord", "did you mean --attack or --attack-from?"),
        ("check one.koord two.koord", "koordgen check APP.koord", "unexpected argument: two.koord"),
        ("sim app.koord --loss 20", "koordgen sim APP.koord", "expected a probability from 0 to 1, not 20"),
        ("sim app.koord --delay -1", "koordgen sim APP.koord", "expected seconds from 0 to 10, not -1"),
        ("validate a.koord --offset -1,0,0", "koordgen validate APP.koord", "--offset=-1,0,0"),
        ("prove app.koord --robots 0", "koordgen prove APP.koord", "a number from 1 to 1000"),
        ("check", "koordgen check APP.koord", "required: APP.koord"),
        ("dump fleet.yaml", "koordgen dump APP.koord", "expected a program (.koord), not the YAML file fleet.yaml"),
        (
            "fmt a.koord fleet.yml",
            "koordgen fmt FILE...",
            "`koordgen build APP.koord --fleet fleet.yml` checks a fleet",
        ),
        ("build a.koord --fleet b.koord", "koordgen build APP.koord", "expected a fleet file (YAML), not the program"),
        ("help chek", "", "did you mean check?"),
    ],
)
def test_a_usage_error_names_the_way_out(
    arguments: str, usage: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert left(shlex.split(arguments)) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.startswith(f"usage: {usage}" if usage else "error:"), told.err
    assert words in told.err
    assert "Traceback" not in told.err


def test_values_that_look_like_options_are_none() -> None:
    options = parsed(["validate", "a.koord", "--fleet", "f.yaml", "--offset=-1,0,0", "--param", "a b"])
    assert options.offset == (-1.0, 0.0, 0.0)
    assert parsed(["build", "a.koord", "-odir", "--target", "car"]).out == "dir"
    assert parsed(["fmt", "-"]).files == ["-"]


@pytest.mark.parametrize("name", EVERYTHING)
def test_help_of_a_command(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["help", name]) == 0
    told = capsys.readouterr().out
    assert left([name, "--help"]) == 0
    assert capsys.readouterr().out == told
    assert told.startswith(f"usage: koordgen {name}")
    assert re.search(r"^[A-Z].*\.$", told, re.MULTILINE), "one sentence"
    assert told.count(f"\n  koordgen {name}") == 2, "two examples"
    assert told.rstrip().endswith(f"more: `koordgen docs {EVERYTHING[name].page}`")
    assert main(["docs", EVERYTHING[name].page]) == 0


@pytest.mark.parametrize("name", EVERYTHING)
def test_each_option_has_a_help_text_and_names_its_default(name: str) -> None:
    for action in Parser(name, EVERYTHING[name])._actions:
        assert action.help, action.dest
        if action.option_strings and action.nargs != 0 and action.default not in (None, []):
            assert "(default: " in action.help, action.dest


@pytest.mark.parametrize("example", [e for command in EVERYTHING.values() for e in command.examples])
def test_an_example_can_be_called(example: str) -> None:
    words = shlex.split(example.partition(" > ")[0])[1:]
    parsed(words)
    for word in words:
        assert not word.startswith("examples/") or (ROOT / word).exists() or word.endswith(".key"), word


def test_the_overview_lists_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["help"]) == 0
    told = capsys.readouterr().out
    assert re.findall(r"^  ([a-z]+) {2,}\S", told, re.MULTILINE).sort() == list(EVERYTHING).sort()
    assert left(["--help"]) == 0
    assert capsys.readouterr().out == told
    assert set(_COMMANDS) == set(COMMANDS)


@pytest.mark.parametrize("flag", ["-V", "--version"])
def test_version(flag: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert left([flag]) == 0
    assert capsys.readouterr().out == f"koordgen {__version__}\n"


def test_limits_and_defaults_are_those_of_the_harness() -> None:
    for name, command in harnesses().items():
        actions = {action.dest: action for action in Parser(name, command)._actions}
        assert f"(default: {DURATION:g})" in str(actions["duration"].help)
        read = actions["delay"].type
        assert callable(read)
        assert read(f"{MOST_DELAY:g}") == MOST_DELAY
        with pytest.raises(argparse.ArgumentTypeError):
            read(f"{MOST_DELAY + 0.1}")
