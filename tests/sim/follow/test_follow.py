"""Counterexamples of explorer and prover, run by the very agents: they come to the same violation, or say where not."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from random import Random
from typing import Any

import pytest

from koordgen.build.emit.program import program_hash
from koordgen.build.pipeline import check_file
from koordgen.cli import main
from koordgen.verify.follow.exact import agree
from koordgen.verify.prove.report.trace import RunOrigin, run_trace
from tests.sim.follow.following import DRIVER, Followed, fleet, follow, replays
from tests.verify.explore.mutants import MUTANTS as ALL
from tests.verify.explore.mutants import Mutant
from tests.verify.explore.random_programs import program as random_text
from tests.verify.explore.reference import LEVEL, explored, unjudged
from tests.verify.explore.test_mutants import edited
from tests.verify.explore.test_search import LOST, STALE

EXAMPLES = Path(__file__).parents[3] / "examples"
SERVED = "modules: {Dev: dev:Dev}\n"

# program, what it says, what it says instead, robots, more of the command
MUTANTS = {
    "a lost update": ("atomicsum/atomicsum", "  eff: atomic:\n", "  eff:\n", 3, ()),
    "all but one is atomic": ("atomicsum/atomicsum", "    total += pid + 1\n", "    total = pid + 1\n", 3, ()),
    "a missing not": ("election/election", "not -1 in bid", "-1 in bid", 3, ()),
    "nobody is waited for": ("election/election", " and not -1 in bid", "", 2, ()),
    "a place that is taken": ("patrol/patrol", "if not taken(leg", "if taken(leg", 3, ("--no-deadlock",)),
    "nobody is looked at": ("patrol/patrol", "if not taken(leg, pid, following):", "if True:", 3, ("--no-deadlock",)),
    "a stale list": ("task/once", "    else: atomic:\n", "    else:\n", 2, ("--env", "once.yaml")),
    "a list that stays": ("task/once", "        all_tasks.remove(cur_task)\n", "", 2, ("--env", "once.yaml")),
}


def found(folder: Path, text: str, robots: int, more: tuple[str, ...] = (), command: str = "explore") -> Path:
    """The trace of a counterexample, beside its program."""
    app, trace = folder / "app.koord", folder / "cx.jsonl"
    app.write_text(text)
    arguments = [command, str(app), "--robots", str(robots), "--trace", str(trace), *more]
    with redirect_stdout(StringIO()), redirect_stderr(StringIO()) as failed:
        assert main(arguments) == 3, failed.getvalue()
    return trace


def same(folder: Path, trace: Path, robots: int, served: str = "") -> Followed:
    """Followed, it is violated where the trace says so, and a replay of the run finds no difference."""
    done = follow(folder / "app.koord", fleet(folder, robots, served), trace)
    assert done.status == 3 and "as in the trace" in done.said, done
    replays(done.folder)
    return done


def records(path: Path, kind: str) -> list[Any]:
    return [r for r in map(json.loads, path.read_text().splitlines()) if r["kind"] == kind]


def test_a_lost_update(tmp_path: Path) -> None:
    done = same(tmp_path, found(tmp_path, LOST, 2), 2)
    ending = records(tmp_path / "cx.jsonl", "violation")[0]
    violation = records(done.folder / "trace.jsonl", "violation")[0]
    assert (violation["name"], violation["what"]) == (ending["name"], "property") == ("Counted", "property")
    causes = records(done.folder / "trace.jsonl", "cause")
    assert [(c["what"], c["robots"]) for c in causes] == [("follow", ["r0", "r1"])]
    assert causes[0]["detail"] == "agents' round 1 is of the trace's round 1, line 6: Add of r0, Add of r1"
    assert records(done.folder / "trace.jsonl", "header")[0]["followed"] == "run"
    with redirect_stdout(StringIO()) as told:
        assert main(["audit", *map(str, done.folder.glob("robots/*/trace.jsonl"))]) == 3
    assert "invariant Counted is violated" in told.getvalue() and "round 1 after its events" in told.getvalue()


def test_an_event_without_a_result_after_commits_of_other_rounds(tmp_path: Path) -> None:
    done = same(tmp_path, found(tmp_path, STALE, 3), 3)
    assert "Bad of r" in done.said and "has no result" in done.said


def test_init_without_a_result(tmp_path: Path) -> None:
    text = "local: int n\ninit:\n  n = 2 ** (40 * pid + 40)\nUp:\n  pre: n < 1\n  eff: stop\n"
    done = same(tmp_path, found(tmp_path, text, 2), 2)
    ending = records(tmp_path / "cx.jsonl", "violation")[0]
    assert (ending["pid"], ending["event"]) == (1, "init") and "init of r1 has no result" in done.said


LOOP = """\
allwrite: int n
local: int mine
{init}Up:
  pre: mine < 2
  eff: atomic:
    int k = 0
    while k <= n:
      invariant k < 3
      k += 1
    n += 1
    mine += 1
Stop:
  pre: mine == 2
  eff: stop
"""


@pytest.mark.parametrize("init", ["", "init:\n  for i in ID:\n    invariant i < 2\n    mine = 0\n"])
def test_a_false_loop_invariant(init: str, tmp_path: Path) -> None:
    done = same(tmp_path, found(tmp_path, LOOP.format(init=init), 2), 2)
    ending = records(tmp_path / "cx.jsonl", "violation")[0]
    violation = records(done.folder / "trace.jsonl", "violation")[0]
    assert (
        (violation["name"], violation["what"])
        == (ending["name"], "property")
        == ("line 8" if not init else "line 5", "property")
    )
    with redirect_stdout(StringIO()) as told:
        assert main(["audit", *map(str, done.folder.glob("robots/*/trace.jsonl"))]) == 3
    assert f"loop invariant {ending['name']} is violated" in told.getvalue()


def test_the_command_itself(tmp_path: Path) -> None:
    trace = found(tmp_path, LOST, 2)
    command = [sys.executable, "-m", "koordgen", "sim", str(tmp_path / "app.koord"), "--fleet", str(fleet(tmp_path, 2))]
    command += ["--follow", str(trace), "--no-report", "--out", str(tmp_path / "run")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 3, done.stderr
    assert done.stdout.splitlines()[-1].endswith("Counted is violated after the same round as in the trace")
    replays(tmp_path / "run")


MOVED = """
using Motion:
  sensors: Point position
    bool reached
  actuators: Point target
  assume position' in Rect(position, target)
  assume reached' == (distance(position', target) <= 0.5)
allread: int legs[N_SYS]
Go:
  pre: Motion.reached and legs[pid] < 2
  eff: atomic:
    legs[pid] = legs[pid] + 1
    Motion.target = Point(legs[pid], 0, 0)
invariant Near: forall i in ID: Motion.position[i].x < 2
initially: forall i in ID: Motion.position[i].x == 0 and Motion.position[i].z == 0
"""
GRID = "Motion.position:\n  grid: {lo: [0, 0, 0], hi: [2, 1, 0], step: 1}\n"


def test_bodies_are_where_the_trace_says(tmp_path: Path) -> None:
    (tmp_path / "env.yaml").write_text(GRID)
    trace = found(tmp_path, MOVED, 2, ("--env", str(tmp_path / "env.yaml"), "--no-deadlock"))
    done = same(tmp_path, trace, 2)
    told = records(trace, "pose")[-2:]
    poses = records(done.folder / "trace.jsonl", "pose")[-2:]
    assert [p["position"] for p in poses] == [p["position"] for p in told]
    assert "VIOLATED since" in (done.folder / "summary.txt").read_text()


def test_a_deadlock(tmp_path: Path) -> None:
    done = same(tmp_path, found(tmp_path, "local: int n\nUp:\n  pre: n < 2\n  eff: n += 1\n", 2), 2)
    assert "no event is enabled any more" in done.said


def test_what_the_prover_found_from_the_beginning(tmp_path: Path) -> None:
    text = "allread: int n[N_SYS]\nUp:\n  pre: True\n  eff: n[pid] = n[pid] + 1\n"
    text += "invariant Below: forall i in ID: n[i] < 3\n"
    same(tmp_path, found(tmp_path, text, 2, command="prove"), 2)


STATE = """local: float share = 0.5
allread: float held[N_SYS]
Take:
  pre: PARTS * share == 1.0
  eff: held[pid] = held[pid] + 1.0
invariant Few: forall i in ID: held[i] <= 2.0
"""
PARAM = """param float part = 0.5
local: float share = 0.0
allread: float held[N_SYS]
Take:
  pre: held[pid] < 2.0
  eff:
    share = part
    held[pid] = held[pid] + 2.0
invariant Few: forall i in ID: held[i] < 2.0 or 3.0 * part < 1.0 or 3.0 * part > 1.0
"""


@pytest.mark.parametrize("text", [STATE.replace("PARTS", "3.0"), PARAM])
def test_exact_numbers_of_a_proof_are_the_nearest_floats(tmp_path: Path, text: str) -> None:
    trace = found(tmp_path, text, 2, command="prove")
    assert '"1/3"' in trace.read_text()
    same(tmp_path, trace, 2)


def test_what_only_exact_numbers_do_is_not_followed(tmp_path: Path) -> None:
    """49 times the float nearest to 1/49 is not 1."""
    trace = found(tmp_path, STATE.replace("PARTS", "49.0"), 2, command="prove")
    done = follow(tmp_path / "app.koord", fleet(tmp_path, 2), trace)
    assert done.status == 4 and "with floats for exact numbers, as 1/49, Take of robot 0 does not lead" in done.said


def test_what_comes_of_a_rounded_number_agrees_up_to_rounding() -> None:
    assert 49.0 * (1 / 49) < 1 and agree(1, 49.0 * (1 / 49), rounded=True) and not agree(1, 49.0 * (1 / 49))
    assert agree("1/3", 1 / 3) and not agree("1/3", 0.3334) and not agree(True, 1.0, rounded=True)


def test_numbers_that_are_near_to_no_float(tmp_path: Path) -> None:
    trace = found(tmp_path, STATE.replace("PARTS", "3.0"), 2, command="prove")
    for far in (f"1/3{'0' * 330}", f"1{'0' * 330}/3", "1/0", "1/3/5", "a/3"):
        other = tmp_path / "other.jsonl"
        other.write_text(trace.read_text().replace("1/3", far))
        done = follow(tmp_path / "app.koord", fleet(tmp_path, 2), other)
        assert done.status == 1 and "precision of robots' numbers | the proof uses exact numbers" in done.said


@pytest.mark.slow
@pytest.mark.parametrize("name", MUTANTS)
def test_mutants_of_examples(tmp_path: Path, name: str) -> None:
    program, old, new, robots, more = MUTANTS[name]
    text = (EXAMPLES / f"{program}.koord").read_text()
    assert old in text
    world = (EXAMPLES / "task/explore.yaml").read_text().splitlines(keepends=True)
    (tmp_path / "once.yaml").write_text("".join(line for line in world if not line.startswith(("  rest:", "  looks:"))))
    given = tuple(str(tmp_path / word) if word.endswith(".yaml") else word for word in more)
    same(tmp_path, found(tmp_path, text.replace(old, new), robots, given), robots)


@pytest.mark.slow
@pytest.mark.parametrize("mutant", ALL, ids=lambda mutant: mutant.name)
def test_all_mutants_that_exploration_catches(tmp_path: Path, mutant: Mutant) -> None:
    source, env = EXAMPLES / f"{mutant.program}.koord", (EXAMPLES / mutant.program).with_name(f"{mutant.env}.yaml")
    functions = source.with_name(f"{source.stem}_functions.py")
    if functions.is_file():
        (tmp_path / "app_functions.py").write_text(functions.read_text())
    more = ("--env", str(env)) if env.is_file() else ()
    trace = found(tmp_path, edited(mutant), 3, more)
    served = ""
    if source.stem == "hvac":
        (tmp_path / "hvac_driver.py").write_text(source.with_name("hvac_driver.py").read_text())
        served = "modules: {HVAC: hvac_driver:Hvac}\n"
    same(tmp_path, trace, 3, served)


def random_run(folder: Path, seed: int, robots: int, rounds: int) -> Path:
    """A random program, and the trace of a way to one of the states that it reaches."""
    (folder / "app.koord").write_text(random_text(seed))
    (folder / "dev.py").write_text(DRIVER)
    program = check_file(str(folder / "app.koord")).program
    made, _ = explored(unjudged(program), robots, LEVEL, rounds, symmetry=False, deadlock=False)
    last = list(made.known)[-20:]
    moments = made.run_to(last[Random(seed).randrange(len(last))])
    trace = folder / "cx.jsonl"
    trace.write_text(run_trace(program, moments, None, RunOrigin(program_hash(program))))
    return trace


def follow_random(folder: Path, seed: int, robots: int, rounds: int) -> str:
    """The agents come to the explorer's states exactly, after each of the trace's rounds, or the trace needs an order
    that agents do not have."""
    trace = random_run(folder, seed, robots, rounds)
    done = follow(folder / "app.koord", fleet(folder, robots, SERVED), trace)
    if done.status == 4:
        assert "no rounds of agents lead to the state in the trace" in done.said
        return "another order"
    assert done.status == 0 and "with the same results" in done.said, done
    replays(done.folder)
    return "followed"


@pytest.mark.parametrize("seed", (2, 8))
def test_random_runs(tmp_path: Path, seed: int) -> None:
    assert follow_random(tmp_path, seed, 2, 3) == "followed"


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(50))
def test_many_random_runs(tmp_path: Path, seed: int) -> None:
    follow_random(tmp_path, seed, 2 + seed % 2, 4 - seed % 2 * 2)


def _other_event(plan: Any) -> None:
    plan["rounds"][0]["events"]["1"] = "Finish"


def _other_value(plan: Any) -> None:
    plan["rounds"][1]["state"]["shared"]["added"] = 2


def _later(plan: Any) -> None:
    plan["found"] += 1


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (
            _other_event,
            "round 1, robot 1 (r1): the trace executes Finish, but its guard is false in the agent (round 1 of the",
        ),
        (_other_value, "round 2, robot 0 (r0): added is 1 when the round begins, 2 in the trace (round 2 of the"),
        (_later, "the trace ends with Counted: false: added == count(done, True); the run violates it at"),
    ],
)
def test_agents_that_do_something_else_are_a_mistake_of_ours(
    tmp_path: Path, change: Callable[[Any], None], why: str
) -> None:
    trace = found(tmp_path, LOST, 2)
    done = follow(tmp_path / "app.koord", fleet(tmp_path, 2), trace, change)
    assert done.status == 70 and why in done.said, done
