"""Runs that agents can execute: the test shared by explore and prove, and the search among such runs."""

from __future__ import annotations

import json
from collections.abc import Hashable, Iterator
from itertools import islice, product
from pathlib import Path
from typing import Any

import pytest

from koordgen.cli import main
from koordgen.lang.ir import decl
from koordgen.lang.semantics.relations import Happened, choice, is_order_of_agents
from koordgen.lang.semantics.state import State
from koordgen.lang.semantics.step import applied, initial, round_, run_init, select
from tests.lang.semantics.priorities import ranked
from tests.lang.semantics.programs import compiled
from tests.verify.explore.reference import LEVEL, after_explored, explored, key, unjudged

# No agent runs Late: whenever its guard holds, First's does.
HIDDEN = """
local: int a
  bool late
First:
  pre: a < 3
  eff: a += 1
Late:
  pre: a == 1
  eff: late = True
Finish:
  pre: a == 3
  eff: stop
invariant Never: forall i in ID: not late[i]
"""
# Two commits lead to it: in one round of the language, in two of agents.
COMMITS = """
allwrite: int sum
local: bool done
Add:
  pre: not done
  eff: atomic:
    sum += 1
    done = True
Finish:
  pre: done
  eff: stop
invariant Few: sum < 2
"""


def explore(tmp_path: Path, text: str, capsys: pytest.CaptureFixture[str], *more: str) -> tuple[dict[str, Any], str]:
    path = tmp_path / "app.koord"
    path.write_text(text)
    asked = ["explore", str(path), "--robots", "2", "--no-deadlock", *more]
    assert main([*asked, "--format", "json"]) == 3
    found = json.loads(capsys.readouterr().out)["violation"]
    assert main(asked) == 3
    return found, " ".join(capsys.readouterr().out.split())


def test_a_run_of_a_hidden_event_is_none_of_agents(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found, told = explore(tmp_path, HIDDEN, capsys)
    assert found["order_of_agents"] is False and found["rounds"] == 2
    assert "robots' agents cannot execute this run" in told
    proved, told = prove(tmp_path, HIDDEN, capsys)
    assert proved["order_of_agents"] is False
    assert "robots' agents cannot execute this run" in told


def test_a_run_of_first_events_is_one_of_agents(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = HIDDEN.replace("not late[i]", "a[i] < 2")
    found, told = explore(tmp_path, text, capsys)
    assert found["order_of_agents"] is True and "robots' agents can execute this run" in told
    proved, told = prove(tmp_path, text, capsys)
    assert proved["order_of_agents"] is True and "robots' agents can execute this run" in told


def test_agents_need_a_round_for_each_commit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found, told = explore(tmp_path, COMMITS, capsys)
    assert (found["order_of_agents"], found["rounds"], found["shortest"]) == (True, 2, 1)
    assert (
        "Few is violated after 2 rounds; the language allows it after 1, in an order of events that agents never use"
        in told
    )


@pytest.mark.parametrize(("guard", "can"), [("xs[0] == 1", False), ("len(xs) == 1", True)])
def test_no_agent_goes_past_a_guard_without_a_value(
    guard: str, can: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = f"""
local: int a
  List<int> xs
Go:
  pre: a == 0
  eff: a = 1
Half:
  pre: a == 1 and {guard}
  eff: a = 3
Bad:
  pre: a == 1
  eff: a = 2
invariant No: forall i in ID: a[i] < 2
"""
    program = compiled(text)
    first = initial(program, 1)
    begun, _ = run_init(program, first)
    run: list[Happened] = [(first, "", None, 0), (begun, "init", None, 0)]
    state = begun
    for number, event in ((1, "Go"), (2, "Bad")):
        chosen = next(e for e in program.events if e.name == event)
        step = compiled_step(program, chosen, state)
        state = applied(program, state, step)
        run.append((state, event, 0, number))
    assert is_order_of_agents(program, run) is can


def compiled_step(program: decl.Program, event: decl.Event, state: State) -> Any:
    step = choice(program, event, state, 0)
    assert step is not None
    return step


def prove(tmp_path: Path, text: str, capsys: pytest.CaptureFixture[str]) -> tuple[dict[str, Any], str]:
    path = tmp_path / "app.koord"
    path.write_text(text)
    assert main(["prove", str(path), "--format", "json"]) == 3
    (found,) = [i for i in json.loads(capsys.readouterr().out)["invariants"] if i["verdict"] == "FALSIFIED"]
    assert main(["prove", str(path)]) == 3
    return found["counterexample"], " ".join(capsys.readouterr().out.split())


def rounds_of_agents(program: decl.Program, state: State) -> Iterator[Hashable]:
    """Every end of a round of agents: who skips, and who commits, is any."""
    pids = range(len(state.robots))
    for skips in product((False, True), repeat=len(pids)):
        skipping = [pid for pid in pids if skips[pid]]
        chosen = {pid: select(program, state, pid) for pid in pids if pid not in skipping}
        wanting = {
            lock: [pid for pid, event in chosen.items() if isinstance(event, decl.Event) and event.lock == lock]
            for lock in range(len(program.locks))
        }
        for holders in product(*[pids or [-1] for pids in wanting.values()]):
            after, _ = round_(program, state, skipping, dict(zip(wanting, holders, strict=True)))
            yield key(after)


@pytest.mark.parametrize("seed", range(20))
def test_the_search_of_agents_takes_the_rounds_of_agents(seed: int) -> None:
    program = unjudged(compiled(ranked(seed)))
    made, _ = explored(program, 2, LEVEL, 2, deadlock=False, as_agents=True)
    for fleet in islice(made.known, 0, None, max(1, len(made.known) // 12)):
        assert after_explored(made, fleet) == set(rounds_of_agents(program, made.machine.state(fleet)))


COUNTING = """
local: int wait = 2
  bool done
priority:
  Rest:
    pre: wait > 0
    eff: wait -= 1
  Go:
    pre: not done
    eff: done = True
  Finish:
    pre: done and wait < 9
    eff: stop
invariant Never: forall i in ID: not done[i]
"""


def test_a_counter_that_goes_before_other_events_is_not_forgotten() -> None:
    _, result = explored(compiled(COUNTING), 2)
    assert result.violation is not None
    assert [moment.event for moment in result.violation.run_states[2:]] == ["Rest", "Rest", "Go"]


@pytest.mark.parametrize("effect", ["wait -= 1", "stop"])
def test_what_other_events_hide_is_never_enabled(effect: str) -> None:
    text = COUNTING.replace("priority:\n  Rest:\n    pre: wait > 0\n    eff: wait -= 1\n", "priority:\n")
    text = text.replace("pre: done and wait < 9", "pre: done").replace("not done[i]", "done[i] or not done[i]")
    text = text.replace("not done\n", "wait < 9 and not done\n")
    hidden = f"  Rest:\n    pre: wait > 0\n    eff: {effect}\ninvariant"
    _, result = explored(compiled(text.replace("invariant", hidden)), 2)
    assert result.violation is None and [event.name for event in result.unseen] == ["Rest"]


def test_an_earlier_guard_without_a_value_blocks_in_the_explorer() -> None:
    program = compiled("""
local: List<int> xs
priority:
  Wait:
    pre: xs[0] > 1
    eff: xs = []
  Go:
    pre: True
    eff: xs = [7]
""")
    made, _ = explored(program, 1, deadlock=False, forgetting=False)
    (fleet,) = made.known
    assert made.machine.prior((0, 1), 0, fleet[0], fleet[1:]) == (0,)
    assert after_explored(made, fleet) == {key(made.machine.state(fleet))}
