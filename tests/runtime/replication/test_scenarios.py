"""Scenarios of the protocol as text scripts, each a test; and the errors of their runner."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.runtime.replication.scenarios import __main__ as command
from tests.runtime.replication.scenarios.runner import (
    COMMANDS,
    EXPECTATIONS,
    FOLDER,
    ScriptError,
    run,
    run_text,
    scripts,
)

BEGIN = "# A script of a test.\n\nrobots 3\n"


@pytest.mark.parametrize("path", scripts(), ids=lambda path: path.stem)
def test_scenario(path: Path) -> None:
    run(path)


def error(text: str) -> str:
    with pytest.raises(ScriptError) as raised:
        run_text(BEGIN + text, "some.txt")
    return str(raised.value)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("jump 3", "no command 'jump': there are crash, cut, delay,"),
        ("crash 3", "no robot 3: there are 0 to 2"),
        ("crash {0,x}", "'x' is no number"),
        ("tick soon", "'soon' is no number"),
        ("robots 4", "expected `robots N`, once"),
        ("timeout 4", "expected `timeout N` before `robots`"),
        ("until 0", "expected `until ROUND`, a later round than 1"),
        ("drop 0", "'0' is no link: expected 0->1, 0-1 or *"),
        ("drop 0->1 Need", "no kind of message 'Need': there are entries, report, nack"),
        ("drop", "expected LINK [KIND], for example 0->1 nack"),
        ("cut 0", "expected `cut ROBOTS ROBOTS`"),
        ("event 0 sometimes", "expected `event ROBOTS none|plain|atomic"),
        ("event 0 plain y=3", "no variable 'y': there are x, wins, count, last"),
        ("event 0 plain twice", "'twice' is nothing of an event"),
        ("expect rain", "expected one of: expect applied, "),
        ("expect applied", "expected `expect applied VALUE [ROBOTS]`"),
        ("expect applied 4 1", "applied of robot 1 is 0"),
        ("expect applied 0 1 2", "too many words: 2"),
        ("expect output 1 0", "robot 0 has no output"),
        ("expect view 1 {0,1}", "robot 0 goes by view 0 {0,1,2} from 1"),
        ("expect view 0 {0,1,2} from 2", "robot 0 goes by view 0 {0,1,2} from 1"),
        ("expect view 0", "expected `expect view NUMBER MEMBERS [from ROUND] [ROBOTS]`"),
        ("expect store y 1", "expected `expect store VARIABLE VALUE [ROBOTS]`, a variable of x, wins, count, last"),
        ("expect store x (1,0,0) 2", "x of robot 2 is (0,0,0)"),
        ("expect skipped 0 stopped", "robot 0 skipped its last round for: None"),
        ("expect skipped 0", "expected `expect skipped ROBOTS REASON`"),
        ("expect sent nack 0->1", "0 such messages were sent"),
        ("expect sent nack", "expected `expect sent KIND LINK [COUNT] [saying TEXT]`"),
        ("show", "expected `show state [ROBOTS]` or `show messages [LINK [KIND]]`"),
        ("    0->1 nack", "an indented line is the output of `show`, and there is none before it"),
    ],
)
def test_an_error_has_its_place(line: str, message: str) -> None:
    found = error(line)
    assert found.startswith(f"some.txt:4: {message}"), found
    assert found.splitlines()[1].strip() == line.strip()


def test_a_script_begins_with_its_robots() -> None:
    with pytest.raises(ScriptError, match=r"^some.txt:1: a script begins with `robots N`"):
        run_text("tick\n", "some.txt")


def test_a_failed_expectation_comes_with_the_last_messages() -> None:
    found = error("event 0 plain\ntick\nexpect applied 2\n")
    assert found.startswith(
        "some.txt:6: applied of robot 0 is 1\n  expect applied 2\n  messages since the last step:\n"
    )
    assert "\n    0->{1,2} entries: 0@1* applied 0\n" in found
    assert "... " in error("round 9\nexpect applied 2\n"), "only the last ones"
    assert "none was sent on 1->0" in error("crash 1\ntick\nexpect sent entries {1,2}->0")


def test_output_that_differs_is_an_error_and_can_be_rewritten(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = BEGIN + "tick\nshow messages 0->*\n    nothing\nexpect applied 1\n"
    with pytest.raises(ScriptError) as raised:
        run_text(text, "some.txt")
    assert str(raised.value).startswith(
        "some.txt:5: the output differs (- stands, + is)\n  - nothing\n  + 0->{1,2} entries: 0@1 applied 0\n"
    )
    path = tmp_path / "some.txt"
    path.write_text(text)
    assert command.main([str(path)]) == 1 and "the output differs" in capsys.readouterr().out
    assert command.main(["--rewrite", str(path)]) == 0
    assert path.read_text() == text.replace("nothing", "0->{1,2} entries: 0@1 applied 0")
    assert command.main([str(path)]) == 0 and run(path) == path.read_text()


def test_a_broken_invariant_is_an_error() -> None:
    """A robot that has forgotten what it voted for makes a second view of the same number with others."""
    text = (FOLDER / "kept_vote.txt").read_text()
    found = text.replace("restart 1\n", "forget 1\nrestart 1\n", 1)
    expected = found[found.index("expect sent promise") : found.index("restart 0")]
    with pytest.raises(ScriptError, match=r"two views 1: "):
        run_text(found.replace(expected, ""), "some.txt")


def test_what_was_not_saved_must_not_be_sent() -> None:
    found = error("round 3\ndrop *->0\ntick\nforget 0\nround\n")
    assert found.startswith("some.txt:8: robot 0 has sent what it has not saved: through 4 applied 3"), found


def test_the_page_names_every_command() -> None:
    page = (FOLDER / "README.md").read_text()
    missing = [name for name in {*COMMANDS, *EXPECTATIONS} if f"`{name}" not in page and f" `{name}" not in page]
    assert not missing
