"""Commands end by themselves, whatever loops, powers or recursive calls the program has."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Collection
from pathlib import Path
from typing import Any

import pytest

from koordgen.cli.base.alarm import alarm
from koordgen.lang.semantics.deadline import OutOfTime
from tests.verify.replay.runs import Run

HANG = 120  # seconds: no criterion but for a hang, on a machine however busy
TURNS = "it is not finished by the end of the round"
BITS = "an int of more than 4096 bits"
SIZE = "where an event makes at most 100000"


def event(effect: str, functions: str = "", guard: str = "not done", keeps: str = "k[i] >= 3") -> str:
    lines = "\n".join(["    " + line for line in effect.split("\n")])
    return f"""{functions}local:
  int k = 3
  bool done
  string s = "ab"
  List<int> xs = [1, 2, 3]
Go:
  pre: {guard}
  eff:
{lines}
    done = True
invariant Kept: forall i in ID: {keeps}
"""


def forty(statement: str) -> str:
    return "\n".join([statement] * 40)


SLOW = "fun slow(int a) -> int:\n  int n = a\n  while n >= 0: n += 1\n  return n\n"
TWICE = "fun f0(int a) -> int:\n  return a + 1\n" + "".join(
    [f"fun f{i}(int a) -> int:\n  return f{i - 1}(a) - f{i - 1}(a + 1)\n" for i in range(1, 41)]
)
INIT = event("k = 4").replace("Go:", "init:\n  while True: k = k + 1\nGo:")
FAR = event("k = 4").replace("forall i in ID: k[i] >= 3", "forall n in range(1000000000): n >= 0")
# By name: the program, and why its event has no result; empty where it has one.
BAD = {
    "forever": (event("while True: pass"), TURNS),
    "long range": (event("for i in range(1000000000): k += i"), TURNS),
    "nested loops": (event("for a in range(1000):\n  for b in range(1000):\n    for c in range(1000): k += 1"), TURNS),
    "squares": (event(forty("k = k * k")), BITS),
    "squares in a loop": (event("for i in range(40): k = k * k"), BITS),
    "powers": (event("\n".join(["k = 2 ** k"] * 6)), "exponent"),
    "sums": (event("while True: k = k + k"), BITS),
    "texts": (event(forty("s = s + s")), SIZE),
    "texts in a loop": (event("for i in range(40): s = s + s"), SIZE),
    "lists": (event(forty("xs.extend(xs)")), SIZE),
    "lists in a loop": (event("for i in range(40): xs.extend(xs)\nk = sum(sorted(reversed(xs)))"), SIZE),
    "a loop in a guard": (event("k = 4", SLOW, "slow(k) > 0"), TURNS),
    "a loop of calls": (event("for i in range(10): k = slow(k)", SLOW), TURNS),
    "calls of calls": (event("k = f40(k)", TWICE), TURNS),
    "init": (INIT, TURNS),
    "a formula": (FAR, "Kept is violated"),
    "many statements": (event("\n".join([f"if k > {i}: k = k + {i}" for i in range(1000)])), "Kept is violated"),
    "literals": (event("k = " + " * ".join(["1000000000000000000"] * 100)), BITS),
}  # fmt: skip


def slowly(names: Collection[str], *slow: str) -> list[Any]:
    """Return parameters, of which those in `slow` take seconds and are not tried every day."""
    return [pytest.param(name, marks=pytest.mark.slow) if name in slow else name for name in names]


def ran(folder: Path, text: str, command: str, *options: str) -> subprocess.CompletedProcess[str]:
    """Run a command on a program; it must end by itself."""
    path = folder / "app.koord"
    path.write_text(text)
    return subprocess.run(
        [sys.executable, "-m", "koordgen", command, str(path), *options], capture_output=True, text=True, timeout=HANG
    )


@pytest.mark.parametrize("name", BAD)
def test_check_ends(name: str, tmp_path: Path) -> None:
    done = ran(tmp_path, BAD[name][0], "check")
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", slowly(BAD, "a loop in a guard", "a formula"))
def test_explore_ends_by_the_limits_of_one_event(name: str, tmp_path: Path) -> None:
    text, reason = BAD[name]
    done = ran(tmp_path, text, "explore", "--robots", "1", "--no-deadlock")
    if name == "many statements":
        assert done.returncode == 0, done.stdout + done.stderr
    else:
        assert done.returncode == 3, done.stdout + done.stderr
        assert reason in done.stdout


@pytest.mark.parametrize("first", ["2 ** 1024 ** 1024", "2 ** 1000", "2 ** 1000 * 2 ** 1000", "7 // 0 ** 5"])
@pytest.mark.parametrize("command", ["check", "prove", "explore"])
def test_a_first_value_that_robots_cannot_keep_is_an_error(first: str, command: str, tmp_path: Path) -> None:
    done = ran(tmp_path, event("k = 4").replace("k = 3", f"k = {first}"), command)
    assert done.returncode == 1, done.stdout + done.stderr
    assert "error[K057]" in done.stderr
    assert ":2:" in done.stderr


SUMS = " + ".join(["sum(xs)"] * 20)  # of 96 elements, which take no turns
LONG = event(f"for i in range(5): xs.extend(xs)\nfor i in range(900000): k = {SUMS}")  # within all limits: minutes
MANY = LONG.split("Go:")[0] + "Go:\n  pre: not done\n  eff: done = True\n"
MANY += "invariant Kept: forall a, b, c, d, e in ID: k[a] + k[b] + k[c] + k[d] + k[e] > 0\n"


@pytest.mark.parametrize(("text", "robots"), [(LONG, "1"), (MANY, "100")], ids=["an event", "a formula"])
def test_explore_ends_when_its_time_is_over_in_the_middle_of_what_takes_long(
    text: str, robots: str, tmp_path: Path
) -> None:
    done = ran(tmp_path, text, "explore", "--robots", robots, "--seconds", "1")
    assert done.returncode == 4, done.stdout + done.stderr
    assert "the time limit of 1 s" in done.stdout


@pytest.mark.parametrize("name", slowly(BAD, "calls of calls", "many statements", "squares"))
def test_prove_ends(name: str, tmp_path: Path) -> None:
    done = ran(tmp_path, BAD[name][0], "prove", "--timeout", "1", "--format", "json")
    assert done.returncode in (0, 3, 4), done.stderr
    assert "Kept" in [verdict["name"] for verdict in json.loads(done.stdout)["invariants"]]


@pytest.mark.parametrize(
    "name",
    slowly(
        ["long range", "nested loops", "squares in a loop", "a loop of calls", "init"],
        "long range",
        "nested loops",
        "a loop of calls",
    ),
)
def test_prove_ends_where_it_runs_what_is_false(name: str, tmp_path: Path) -> None:
    text = BAD[name][0].replace("k[i] >= 3", "k[i] == 3")
    done = ran(tmp_path, text, "prove", "--timeout", "1", "--robots", "2", "--format", "json")
    assert done.returncode in (3, 4), done.stdout + done.stderr
    assert "Kept" in [verdict["name"] for verdict in json.loads(done.stdout)["invariants"]]


GROWN = "fun g0(int a) -> int: return a % 3\n" + "".join(  # with other arguments each: equal calls are encoded once
    [f"fun g{i + 1}(int a) -> int: return g{i}(2 * a) + g{i}(2 * a + 1)\n" for i in range(22)]
)
LARGE = (
    event("k = g22(k)", GROWN)
    + """Other:
  pre: len(xs) < 5
  eff: xs.append(1)
Third:
  pre: k > 100
  eff: k = 3 * k
invariant Other: forall i in ID: len(xs[i]) >= 3
invariant Wrong: forall i in ID: len(xs[i]) < 5
"""
)


@pytest.mark.slow
def test_prove_decides_what_does_not_depend_on_an_event_that_is_too_large(tmp_path: Path) -> None:
    done = ran(tmp_path, LARGE, "prove", "--format", "json", "--attack", "0", "--emit", str(tmp_path / "smt"))
    found = {each["name"]: each for each in json.loads(done.stdout)["invariants"]}
    verdicts = {name: each["verdict"] for name, each in found.items()}
    assert verdicts.pop("Wrong") in ("FALSIFIED", "NOT INDUCTIVE")
    assert verdicts == {"Kept": "UNKNOWN", "Other": "PROVED", "(well-defined)": "UNKNOWN"}
    assert done.returncode == 3, done.stderr
    (large,) = [each for each in found["Kept"]["obligations"] if each["name"] == "Kept-Go"]
    assert large["result"] == "unknown", "no solver was asked"
    assert "Kept-Go" in found["Kept"]["suggestion"]
    assert "the formulas take more than 200,000 steps to write down" in found["Kept"]["suggestion"]
    written = (tmp_path / "smt" / "Kept-Go.smt2").read_text()
    assert "(assert true)" in written  # whoever asks a solver about this file gets no proof from it
    assert "200,000 steps" in written


@pytest.mark.parametrize("name", ["forever", "squares", "lists in a loop"])
def test_replay_and_audit_end_and_agree_with_the_robot(name: str, tmp_path: Path) -> None:
    text, reason = BAD[name]
    folder = Run(tmp_path / "run", text, n=1).run(1.35).save()
    traces = [json.loads(line) for file in folder.glob("*.jsonl") for line in file.read_text().splitlines()]
    told = [line["fault"]["reason"] for line in traces if line.get("fault")]
    assert told, "the robot must have met the limit"
    assert all(reason in why for why in told)
    for command, status in (("replay", 0), ("audit", 3)):  # to audit, a discarded event is a violation
        done = subprocess.run(
            [sys.executable, "-m", "koordgen", command, str(folder)], capture_output=True, text=True, timeout=HANG
        )
        assert done.returncode == status, done.stdout + done.stderr


SLOW_FORMULA = event("k = 4", keeps="k[i] >= 3").replace(
    "forall i in ID:", "forall n in range(999999): exists i in ID:"
)


@pytest.mark.parametrize(
    ("command", "text"), [("replay", event("k = 4", SLOW, "slow(k) > 0")), ("audit", SLOW_FORMULA)]
)
def test_seconds_end_replay_and_audit(command: str, text: str, tmp_path: Path) -> None:
    folder = Run(tmp_path / "run", text, n=1).run(1.35).save()
    done = subprocess.run(
        [sys.executable, "-m", "koordgen", command, str(folder), "--seconds", "0.01"],
        capture_output=True, text=True, timeout=HANG,
    )  # fmt: skip
    assert done.returncode == 4, done.stdout + done.stderr
    assert "ended by --seconds 0.01" in done.stdout


def test_the_alarm_interrupts_and_is_gone_afterwards() -> None:
    before = signal.getsignal(signal.SIGALRM)
    with pytest.raises(OutOfTime), alarm(0.0):
        while True:
            pass
    assert signal.getsignal(signal.SIGALRM) is before
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_the_alarm_rings_again_if_something_swallows_it() -> None:
    """As a bare `except` of the user does, or the interpreter, which raises nothing out of a destructor."""
    swallowed = 0
    with pytest.raises(OutOfTime), alarm(0.0):
        while True:
            try:
                while True:
                    pass
            except BaseException:
                swallowed += 1
                if swallowed == 2:
                    raise
    assert swallowed == 2
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_without_a_limit_there_is_no_alarm() -> None:
    with alarm(None):
        assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
