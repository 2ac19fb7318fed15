"""Proofs that an inner program keeps the assumptions of an outer program, of which each robot is an inner fleet."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import get_args
from unittest.mock import patch

import pytest

from koordgen.build.pipeline import check_file
from koordgen.cli import main
from koordgen.lang.ir.decl import Program
from koordgen.lang.semantics.property import holds_property
from koordgen.lang.semantics.state import State
from koordgen.lang.semantics.step import initial, round_, run_init
from koordgen.verify.prove.obligations.provided import START, ProvidedModules
from koordgen.verify.prove.report import levels
from koordgen.verify.prove.report.levels import LevelVerdicts, levels_text, prove_levels
from koordgen.verify.prove.smt.obligation import Kind
from koordgen.verify.prove.smt.solve import Limits, Solver

ROOT = Path(__file__).parents[3]
OUTER = """\
using Motion:
  sensors:
    float position
    bool reached
  actuators: float target
  assume {assume}
Go:
  pre: Motion.reached
  eff: Motion.target = 1.0
"""
INNER = """\
{first}provides Motion:
  sensors:
    float position = centre
    bool reached = centre == goal
  actuators: float target = goal
allwrite:
  float goal
  float centre
local: int k
Step:
  pre: centre != goal
  eff: atomic: centre = {next}
Count:
  pre: True
  eff: k += 1
{last}"""
BETWEEN = "min(position, target) <= position' and position' <= max(position, target)"
HALF = "(centre + goal) / 2"


@pytest.fixture(scope="module")
def solver() -> Iterator[Solver]:
    with Solver("z3", Limits()) as running:
        yield running


def programs(folder: Path, assume: str, next: str = HALF, first: str = "", last: str = "") -> tuple[Program, Program]:
    (folder / "inner.koord").write_text(INNER.format(next=next, first=first, last=last))
    (folder / "outer.koord").write_text(OUTER.format(assume=assume))
    return check_file(str(folder / "inner.koord")).program, check_file(str(folder / "outer.koord")).program


def judged(folder: Path, solver: Solver, assume: str, **inner: str) -> LevelVerdicts:
    return prove_levels(*programs(folder, assume, **inner), {}, {}, solver)


PROVED = {
    "a robot stays between its position and its target": (BETWEEN, HALF),
    "one that has arrived stays there": ("not reached or reached'", HALF),
    "a step to the goal": ("not reached or reached'", "goal"),
    "nothing about an actuator": ("position' == position' and not (reached' and not reached')", HALF),
}
UNPROVED = {
    "a step that goes too far": (BETWEEN, "3 * goal - 2 * centre", "it is not kept: the event Step may break it"),
    "a step away": ("not reached' or position' == target", "centre + 1", ""),
    "a command moves the target away": ("abs(position' - target) <= 1", HALF, "it is not true at once"),
    "what the first state breaks": ("position' > 0", HALF, "it is not true at once: the state after init"),
}


@pytest.mark.parametrize("case", PROVED)
def test_an_assumption_that_every_inner_step_keeps_is_proved(case: str, tmp_path: Path, solver: Solver) -> None:
    assume, next = PROVED[case]
    (found,) = judged(tmp_path, solver, assume, next=next).provided
    assert found.verdict == "PROVED", found.reason
    assert found.has_slack == ("target" in assume), "until a command is applied, the one before counts"


@pytest.mark.parametrize("case", [case for case in UNPROVED if UNPROVED[case][2]])
def test_an_assumption_that_an_inner_step_may_break_names_the_step(case: str, tmp_path: Path, solver: Solver) -> None:
    assume, next, why = UNPROVED[case]
    (found,) = judged(tmp_path, solver, assume, next=next).provided
    assert found.verdict == "UNPROVED" and why in found.reason


def test_a_command_clears_a_sensor_whatever_the_inner_program_provides(tmp_path: Path, solver: Solver) -> None:
    """`reached` is false after a command, so what is not reached before must not be reached without a step."""
    _, outer = programs(tmp_path, "reached or not reached'")
    text = (tmp_path / "inner.koord").read_text().replace("bool reached = centre == goal", "bool reached = True")
    (tmp_path / "inner.koord").write_text(text)
    (found,) = prove_levels(check_file(str(tmp_path / "inner.koord")).program, outer, {}, {}, solver).provided
    assert found.verdict == "UNPROVED" and "it is not true at once" in found.reason


def test_functions_of_the_outer_program_are_known_and_extern_ones_are_not(tmp_path: Path, solver: Solver) -> None:
    inner, _ = programs(tmp_path, BETWEEN)
    body = "fun low(float a, float b) -> float:\n  return least(a, b)\n"
    body += "fun least(float a, float b) -> float:\n  return min(a, b)\n"
    assume = "low(position, target) <= position' and position' <= max(position, target)"
    (tmp_path / "outer.koord").write_text(body + OUTER.format(assume=assume))
    (found,) = prove_levels(inner, check_file(str(tmp_path / "outer.koord")).program, {}, {}, solver).provided
    assert found.verdict == "PROVED", found.reason
    body = "extern fun far(float a) -> float\nfun low(float a) -> float:\n  return far(a)\n"
    (tmp_path / "outer.koord").write_text(body + OUTER.format(assume="low(position') >= 0"))
    (found,) = prove_levels(inner, check_file(str(tmp_path / "outer.koord")).program, {}, {}, solver).provided
    assert (found.verdict, found.reason) == ("UNPROVED", "far is an extern function")


def test_a_proof_may_rest_on_an_invariant_of_the_inner_program(tmp_path: Path, solver: Solver) -> None:
    last = "invariant Low: centre <= 0 or centre > 0\ninvariant Counted: forall i in ID: k[i] >= 0\n"
    found = judged(tmp_path, solver, "position' <= position or position' > position", last=last)
    assert (
        found.is_proved and [v.verdict for v in found.invariants if v.invariant in ("Low", "Counted")] == ["PROVED"] * 2
    )
    text = (
        "local: bool gone\nOut:\n  pre: not gone\n  eff:\n    gone = True\ninvariant Never: forall i in ID: k[i] < 0\n"
    )
    found = judged(tmp_path, solver, "position' >= 0 and position' < 0", last=text)
    assert not found.is_proved, "an invariant that is not PROVED is not relied upon"


def test_contradictory_assumptions_of_the_inner_program_prove_nothing(tmp_path: Path, solver: Solver) -> None:
    found = judged(
        tmp_path, solver, BETWEEN, first="initially: N_SYS > 2 and N_SYS < 2\n", last="invariant T: centre == centre\n"
    )
    assert [v.verdict for v in found.invariants] == ["VACUOUS"]
    assert [each.verdict for each in found.provided] == ["UNPROVED"]


@pytest.mark.parametrize(
    "first", ["initially: N_SYS > 2 and N_SYS < 2\n", "param int n = 1\ninitially: n > 2 and n < 2\n"]
)
def test_contradictory_assumptions_are_seen_without_any_invariant(first: str, tmp_path: Path, solver: Solver) -> None:
    (found,) = judged(tmp_path, solver, "not reached' or position' == target + 1", next="goal", first=first).provided
    assert found.verdict == "UNPROVED" and "anything follows from that" in found.reason, found.reason


def test_the_robots_of_the_outer_fleet_are_not_those_of_the_inner_one(tmp_path: Path, solver: Solver) -> None:
    (found,) = judged(tmp_path, solver, "position' == position' and forall i in ID: i < N_SYS").provided
    assert (found.verdict, found.reason) == ("UNPROVED", "it is about all robots of the outer fleet")


def test_what_the_inner_program_does_not_provide_is_named(tmp_path: Path, solver: Solver) -> None:
    inner, _ = programs(tmp_path, BETWEEN)
    text = OUTER.format(assume="battery' <= battery").replace(
        "    bool reached\n", "    bool reached\n    float battery\n"
    )
    (tmp_path / "other.koord").write_text(text)
    other = check_file(str(tmp_path / "other.koord")).program
    (found,) = prove_levels(inner, other, {}, {}, solver).provided
    assert found.reason == "inner.koord does not provide Motion.battery"
    (tmp_path / "int.koord").write_text(
        OUTER.format(assume="position' == position'").replace("float position", "int position")
    )
    (found,) = prove_levels(inner, check_file(str(tmp_path / "int.koord")).program, {}, {}, solver).provided
    assert found.reason == "Motion.position is a sensor of type int here, and a sensor of type float in inner.koord"


def contradicted(folder: Path, assume: str, next: str, seed: int) -> bool:
    """Return whether a run of the inner program, without commands after some time, breaks an assumption."""
    inner, outer = programs(folder, assume, next)
    stated = ProvidedModules(inner, outer, {})
    (each,) = stated.assumptions
    assert each.kept is not None
    rng = Random(seed)
    state, _ = run_init(inner, initial(inner, 2))
    for _ in range(rng.randrange(3)):
        state = _commanded(round_(inner, state)[0], rng)
    program = stated.program((each.kept,))
    cells = state.store.cells
    start = {f"Motion.position{START}": cells["centre"], f"Motion.reached{START}": cells["centre"] == cells["goal"]}
    for _ in range(rng.randrange(5)):
        now = state._replace(params={**state.params, **start, "outer.pid": 0, "outer.N_SYS": 2})
        if not holds_property(each.kept, program, now):
            return True
        state = round_(inner, state)[0]
    return False


def _commanded(state: State, rng: Random) -> State:
    cells = {**state.store.cells, "goal": float(rng.randrange(-4, 5))}
    return state._replace(store=state.store._replace(cells=cells))


def test_no_run_contradicts_what_is_proved(tmp_path: Path) -> None:
    for assume, next in PROVED.values():
        assert not any(contradicted(tmp_path, assume, next, seed) for seed in range(40)), assume


@pytest.mark.parametrize("rule", ["event", "base"])
def test_a_prover_without_one_of_the_two_rules_is_contradicted(rule: str, tmp_path: Path, solver: Solver) -> None:
    """Without `kept`, or without `at once`, an assumption that a run breaks is PROVED."""
    assume, next = {"event": (BETWEEN, "3 * goal - 2 * centre"), "base": ("abs(position' - target) <= 1", HALF)}[rule]
    every: frozenset[Kind] = frozenset(get_args(Kind))
    shown = levels._Search._shown

    def weaker(search, properties, known, skipped):  # type: ignore[no-untyped-def]
        is_kept = bool(skipped)
        return shown(search, properties, known, every if is_kept == (rule == "event") else skipped)

    with patch.object(levels._Search, "_shown", weaker):
        (found,) = judged(tmp_path, solver, assume, next=next).provided
    assert found.verdict == "PROVED"
    assert any(contradicted(tmp_path, assume, next, seed) for seed in range(40))


def test_the_example_of_the_page_is_proved(tmp_path: Path, solver: Solver) -> None:
    page = (ROOT / "docs/explanation/proofs.md").read_text()
    (text,) = re.findall(r"```koord\n(# column.koord\n.*?)```", page, re.DOTALL)
    (tmp_path / "column.koord").write_text(text)
    inner = check_file(str(tmp_path / "column.koord")).program
    found = prove_levels(inner, check_file(str(ROOT / "examples/lineform/geofence.koord")).program, {}, {}, solver)
    assert found.is_proved
    shown = page[page.index("each robot of geofence.koord is a fleet") :]
    assert shown.startswith(levels_text(found).partition("\nassumed")[0].rstrip()), "as the command prints it"


def test_the_command_prints_both_levels(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    programs(tmp_path, BETWEEN)
    inner, outer = str(tmp_path / "inner.koord"), str(tmp_path / "outer.koord")
    assert main(["prove", outer, "--inner", inner]) == 0
    text = capsys.readouterr().out
    assert "each robot of outer.koord is a fleet of inner.koord" in text and "PROVED    assume" in text
    assert "not covered: the time before the first command" in text
    assert main(["prove", outer, "--inner", inner, "--format", "json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)["levels"]
    assert [each["verdict"] for each in found["assumptions"]] == ["PROVED"]
    programs(tmp_path, "position' > 0")
    assert main(["prove", outer, "--inner", inner]) == 4
    capsys.readouterr()
    assert main(["prove", outer, "--inner", outer]) == 2
    assert "provides no module" in capsys.readouterr().err
