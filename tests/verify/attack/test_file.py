"""File of a contradiction: it is read as it was written, and anything else is rejected."""

from __future__ import annotations

import json
from collections.abc import Callable
from fractions import Fraction
from random import Random
from typing import Any

import pytest

from koordgen.lang.ir.decl import Program
from koordgen.lang.semantics.exact import exact
from koordgen.verify.attack.attack import attack
from koordgen.verify.attack.file import MOST_BYTES, BadFile, read_trial, to_text
from koordgen.verify.attack.judge import Contradiction, Trial, TrialJudge, TrialNotCovered, UnusableStep
from tests.verify.attack.faults import every_name, ticks
from tests.verify.prove.proving import checked

HASH = "0123456789abcdef"
RICH = """
def Parcel:
  Point at
  string label max 16
using Motion:
  sensors:
    Point position
    Pose pose
    bool reached
  actuators: Point target
  PathPlanner planner
allread: List<Parcel> xs[N_SYS] max 4
allwrite: Map<int, float> m max 4
local:
  Set<int> z max 4
  Queue<(int, float)> q max 4
  Grid cell
  GridMap map max 64
  float third
  int n
init:
  third = 1.0 / 3
  z.add(3)
  z.add(1)
  q.push((2, third))
  Map<int, float> one
  one[pid] = third
  m = one
Go:
  pre: n == 0
  eff:
    Parcel p
    p.at = Motion.position
    p.label = "a"
    xs[pid].append(p)
    third = sqrt(2.0)
    List<Point> way = Motion.planner(Point(1, 2, 3))
    n = 1 + len(way)
invariant Q: forall i in ID: n[i] == 0
"""


def made() -> tuple[Program, Contradiction, str]:
    """A contradiction from a state after `init`."""
    program = checked(RICH)
    found = attack(program, every_name(program), robots=2, clock=ticks()).contradiction
    assert found is not None
    state, acts = found.trial
    begun = TrialJudge(exact(program), [], lambda *_: ()).replay(Trial(state, acts[:1])).states[1]
    found = found._replace(trial=Trial(begun, acts[1:]))
    return exact(program), found, to_text(found, ["Q", "(well-defined)"], HASH, "app.koord")


PROGRAM, FOUND, TEXT = made()


def changed(change: Callable[[Any], object]) -> bytes:
    document = json.loads(TEXT)
    change(document)
    return json.dumps(document).encode()


def test_a_contradiction_is_read_as_it_was_written_and_contradicts_again() -> None:
    given = read_trial(TEXT.encode(), PROGRAM, HASH)
    assert given.trial == FOUND.trial
    assert (given.invariant, given.proved) == ("Q", ("(well-defined)", "Q"))
    again = TrialJudge(PROGRAM, given.proved, lambda *_: ()).replay(given.trial).contradiction
    assert again is not None and again.breach == FOUND.breach and again.after == FOUND.after
    assert again.after.robots[0].ports != {} and again.trial.acts[-1].answers, "the planner's answer stands in the file"


def test_numbers_are_exact_texts() -> None:
    assert '"1/3"' in TEXT
    state = read_trial(TEXT.encode(), PROGRAM, HASH).trial.state
    assert state.robots[0].locals["third"] == Fraction(1, 3)


CHANGES: dict[str, tuple[Callable[[Any], object], str]] = {
    "another format": (lambda d: d.update(format="koord-trace/1"), "the file's format is not koord-unsound/1"),
    "another program": (lambda d: d.update(program="f" * 16), "another program"),
    "no program": (lambda d: d.pop("program"), "the file lacks"),
    "an unknown key": (lambda d: d.update(run="rm"), "the file has an unknown"),
    "an unknown invariant": (lambda d: d.update(proved=["R"]), "is none of the allowed names"),
    "an invariant that was not proved": (lambda d: d.update(proved=["(well-defined)"]), "none of the allowed names"),
    "nothing proved": (lambda d: d.update(proved=[]), "proved is not a list"),
    "no robots": (lambda d: d["state"].update(robots=[]), "robots is not a list of 1 to 4"),
    "too many robots": (lambda d: d["state"].update(robots=5 * d["state"]["robots"]), "robots is not a list of 1 to 4"),
    "slots of fewer robots": (lambda d: d["state"]["slots"].update(xs=[]), "xs is not a list of 2 to 2"),
    "a local of another program": (lambda d: d["state"]["robots"][0]["locals"].update(y=1), "unknown"),
    "a local that lacks": (lambda d: d["state"]["robots"][0]["locals"].pop("n"), "lacks"),
    "a bool for an int": (lambda d: d["state"]["robots"][0]["locals"].update(n=True), "n: true is not of type int"),
    "an int for a bool": (lambda d: d["state"]["robots"][0].update(stopped=0), "neither true nor false"),
    "a float": (lambda d: d["state"]["robots"][0]["locals"].update(third=0.5), "third: 0.5 is not of type float"),
    "a quotient by zero": (lambda d: d["state"]["robots"][0]["locals"].update(third="1/0"), "is not of type float"),
    "a power of ten": (lambda d: d["state"]["robots"][0]["locals"].update(third="1e999999"), "is not of type float"),
    "the root of a negative number": (lambda d: d["state"]["robots"][0]["locals"].update(third="sqrt(-1)"), "is no"),
    "a long number": (lambda d: d["state"]["robots"][0]["locals"].update(third="9" * 5000), "is not of type float"),
    "a long int": (lambda d: d["state"]["robots"][0]["locals"].update(n=10**1001), "is not of type int"),
    "a set out of order": (lambda d: d["state"]["robots"][0]["locals"].update(z=[3, 1]), "is not of type Set"),
    "a map with a key twice": (lambda d: d["state"]["cells"].update(m=[[0, "1"], [0, "2"]]), "is not of type Map"),
    "a text that is not Unicode": (lambda d: d["state"]["slots"].update(xs=[[[["0"] * 3, "\ud800"]], []]), "is no"),
    "a point of two": (
        lambda d: d["state"]["robots"][0]["ports"].update({"Motion.target": ["0", "0"]}), "is not of type Point",
    ),
    "a map of cells that is none": (
        lambda d: d["state"]["robots"][0]["locals"].update(map=["1", 0, 0, 9, 9, "AA=="]),
        "is not of type GridMap",
    ),
    "no steps": (lambda d: d.update(steps=[]), "steps is not a list of 1 to 64"),
    "an unknown event": (lambda d: d["steps"][-1].update(event="Fly"), "a step's event"),
    "a robot that is not there": (lambda d: d["steps"][-1].update(robot=2), "is not a whole number from 0 to 1"),
    "answers of nobody": (lambda d: d["steps"][-1]["answers"][0].update(port="Motion.target"), "an answer's port"),
    "steps that are none": (lambda d: d.update(steps=["init"]), "a step's event"),
    "another round": (lambda d: d["state"].update(round=-1), "round: -1 is not a whole number"),
}  # fmt: skip


@pytest.mark.parametrize("name", CHANGES)
def test_what_is_wrong_in_a_file_is_said_with_a_way_out(name: str) -> None:
    change, said = CHANGES[name]
    with pytest.raises(BadFile) as error:
        read_trial(changed(change), PROGRAM, HASH)
    assert said in str(error.value)
    assert error.value.help and len(str(error.value)) < 300


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "not valid JSON"),
        (b"[]", "the file is not an object"),
        (b"\xff\xfe", "not valid JSON"),
        (b"[" * 100_000, "nested too deeply"),
        (b'{"a": NaN}', "NaN is not a number"),
        (b'{"a": 1, "a": 1}', "a key occurs twice"),
        (b'{"a": ' + b"9" * 5000 + b"}", "not valid JSON"),
        (b" " * (MOST_BYTES + 1), "the limit is"),
    ],
)
def test_bytes_that_are_no_such_file(data: bytes, said: str) -> None:
    with pytest.raises(BadFile, match=said):
        read_trial(data, PROGRAM, HASH)


def followed(data: bytes) -> str:
    """What comes of a file, whatever it is."""
    try:
        given = read_trial(data, PROGRAM, HASH)
        found = TrialJudge(PROGRAM, given.proved, lambda *_: ()).replay(given.trial).contradiction
    except (BadFile, TrialNotCovered, UnusableStep) as error:
        return type(error).__name__
    return "contradiction" if found is not None else "none"


def test_a_file_that_is_cut_short_anywhere_is_refused() -> None:
    data = TEXT.encode()
    assert {followed(data[:end]) for end in range(0, len(data) - 2, 7)} == {"BadFile"}


def test_no_byte_that_is_changed_ends_in_anything_but_an_answer() -> None:
    random, data = Random(0), TEXT.encode()
    said = set()
    for _ in range(600):
        place = random.randrange(len(data))
        said.add(followed(data[:place] + bytes([random.choice(b'019-/"[]{},:aQ\x00\xff')]) + data[place + 1 :]))
    assert (
        {"BadFile", "contradiction"} <= said <= {"BadFile", "TrialNotCovered", "UnusableStep", "contradiction", "none"}
    )


def test_an_answer_that_the_assumptions_do_not_allow_shows_nothing() -> None:
    text = RICH.replace("  PathPlanner planner\n", "  PathPlanner planner\n  assume planner(goal) == []\n")
    program = exact(checked(text))
    assert any(act.answers and act.answers[0].asked.answer for act in FOUND.trial.acts), "it answered with a way"
    given = read_trial(TEXT.encode(), program, HASH)
    with pytest.raises(UnusableStep, match=r"allow none of the known results of Motion\.planner"):
        TrialJudge(program, given.proved, lambda *_: ()).replay(given.trial)
