"""Traces that cannot be followed, or not to their end: what is said, and that nothing raises."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import pytest

from koordgen.build.pipeline import check_file
from koordgen.cli import main
from koordgen.lang.ir.decl import Program
from koordgen.runtime.trace.schema import BadTrace
from koordgen.verify.follow.plan import CannotExecute, alone, make_plan
from koordgen.verify.follow.read import read
from tests.sim.follow.following import fleet, follow
from tests.sim.follow.test_follow import GRID, MOVED, found
from tests.verify.explore.test_search import LOST

PARAM = "param int most = 2\nparam Point away = Point(1, 2, 3)\nallread: int n[N_SYS]\nUp:\n  pre: n[pid] < 5\n"
PARAM += "  eff: n[pid] = n[pid] + 1\ninvariant Low: forall i in ID: n[i] <= most\n"


def changed(trace: Path, change: Callable[[list[Any]], object]) -> Path:
    """The trace with its records changed."""
    lines = [json.loads(line) for line in trace.read_text().splitlines()]
    change(lines)
    trace.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return trace


def refused(folder: Path, trace: Path, robots: int = 2, more: tuple[str, ...] = (), status: int = 1) -> str:
    done = follow(folder / "app.koord", fleet(folder, robots), trace, more=more)
    assert done.status == status, done
    return done.said


def test_another_version_of_the_program(tmp_path: Path) -> None:
    trace = found(tmp_path, LOST, 2)
    its = json.loads(trace.read_text().splitlines()[0])["program_hash"]
    app = tmp_path / "app.koord"
    app.write_text(LOST + "# of another day\n")
    assert follow(app, fleet(tmp_path, 2), trace).status == 3  # it means the same
    app.write_text(LOST.replace("added += 1", "added += 2"))
    said = refused(tmp_path, trace)
    assert f"is the trace of a program with the hash {its}; " in said and "search for the counterexample again" in said


def test_another_number_of_robots(tmp_path: Path) -> None:
    said = refused(tmp_path, found(tmp_path, LOST, 2), 3)
    assert "is the trace of 2 robots, but " in said and "fleet.yaml has 3" in said and "--robots 3" in said


def test_params_come_from_the_trace_unless_the_fleet_has_others(tmp_path: Path) -> None:
    trace = found(tmp_path, PARAM, 2, ("--param", "most=3"))
    assert json.loads(trace.read_text().splitlines()[0])["given"] == ["most"]
    app = tmp_path / "app.koord"
    assert follow(app, fleet(tmp_path, 2), trace).status == 3
    assert follow(app, fleet(tmp_path, 2, "params: {most: 3, away: [1, 2, 3]}\n"), trace, out="again").status == 3
    done = follow(app, fleet(tmp_path, 2, "params: {most: 1}\n"), trace)
    assert (
        done.status == 1 and "param most is 3 in the trace, but 1 in this run" in done.said and "--fleet" in done.said
    )
    assert "param most is 3 in the trace, but 4 in this run" in refused(tmp_path, trace, more=("--param", "most=4"))


def test_numbers_that_robots_do_not_have(tmp_path: Path) -> None:
    trace = found(tmp_path, PARAM, 2)
    changed(trace, lambda lines: lines[0]["params"].update(away=["1/3", 0, 0]))
    assert "param away" in refused(tmp_path, trace)


def test_a_trace_that_is_cut_off_is_followed_as_far_as_it_goes(tmp_path: Path) -> None:
    trace = found(tmp_path, LOST, 2)
    lines = trace.read_text().splitlines(keepends=True)
    trace.write_text("".join(lines[:7]) + lines[7][:30])  # amid the second robot's event
    done = follow(tmp_path / "app.koord", fleet(tmp_path, 2), trace)
    assert done.status == 0 and done.said.endswith("cx.jsonl:8: the trace is cut off here"), done
    trace.write_text("".join(lines[:8]))  # between the records of one step
    done = follow(tmp_path / "app.koord", fleet(tmp_path, 2), trace, out="again")
    assert done.status == 0 and done.said.endswith("cx.jsonl:8: the trace is cut off here"), done
    trace.write_text("".join(lines[:1]))
    assert "the trace contains no complete step" in refused(tmp_path, trace)


def test_what_was_changed_by_hand(tmp_path: Path) -> None:
    trace = found(tmp_path, LOST, 2)
    changed(trace, lambda lines: lines[8]["shared"].update(added=7))  # what the whole round led to
    assert "no rounds of agents lead to the state in the trace" in refused(tmp_path, trace)
    changed(trace, lambda lines: lines[3]["shared"].update(added=7))
    assert "after init, added of robot 0 is 7 in the trace and 0 by the program" in refused(tmp_path, trace)


def test_an_order_that_agents_do_not_have(tmp_path: Path) -> None:
    text = "allwrite: int last\nlocal: bool told\nTell:\n  pre: not told\n  eff:\n    last = pid + 1\n    told = True\n"
    trace = found(tmp_path, text + "invariant No: last != 1 or not (exists i in ID: told[i] and i == 1)\n", 2)
    assert [r["pid"] for r in map(json.loads, trace.read_text().splitlines()) if r.get("event") == "Tell"] == [1, 0]
    done = follow(tmp_path / "app.koord", fleet(tmp_path, 2), trace)
    # Robots tell in two rounds, since neither reads what the other has written.
    assert done.status == 3 and "replayed in 2 rounds of the agents" in done.said, done
    stale = text.replace("last = pid + 1", "last = (pid + 1) * (1 + last)")
    trace = found(tmp_path, stale + "invariant No: last != 1 or not (exists i in ID: told[i] and i == 1)\n", 2)
    said = refused(tmp_path, trace, status=4)  # the language has it, so the file is not wrong
    assert "round 1: Tell of robot 1, Tell of robot 0, in this order" in said and "in the model only" in said


def test_a_step_from_any_state(tmp_path: Path) -> None:
    text = "allread: int n[N_SYS]\nallwrite: int sum\nlocal: bool late\nUp:\n  pre: n[pid] < 9\n  eff: atomic:\n"
    text += "    n[pid] = n[pid] + 2\n    sum += 1\n    late = True\ninvariant Odd: forall i in ID: n[i] != 7\n"
    trace = found(tmp_path, text, 2, command="prove")
    assert json.loads(trace.read_text().splitlines()[0])["counterexample"] == "step"
    done = follow(tmp_path / "app.koord", fleet(tmp_path, 2), trace)
    assert done.status == 3 and "Odd is violated after the same round" in done.said, done
    assert main(["replay", str(done.folder)]) == 0


def test_a_step_amid_a_round(tmp_path: Path) -> None:
    text = "allwrite: int a\nallwrite: int b\nCopy:\n  pre: a < 3\n  eff: b = a\nRaise:\n  pre: True\n  eff: atomic:\n"
    text += "    a += 1\n    if a > 5: a = 5\ninvariant Near: b <= a\n"
    trace = found(tmp_path, text, 2, command="prove")
    header, *_ = [json.loads(line) for line in trace.read_text().splitlines()]
    assert header["counterexample"] == "step"  # Copy read another `a` than the one with which the step begins
    said = refused(tmp_path, trace, status=4)
    assert (
        "round 1: Copy of robot " in said
        and "b of robot 0 is " in said
        and "reads the store of the round's start" in said
    )


@pytest.mark.parametrize("option", ["--duration=3", "--loss=0.1", "--gui", "--scenario=x.yaml"])
def test_what_does_not_go_with_it(tmp_path: Path, option: str) -> None:
    trace = found(tmp_path, LOST, 2)
    done = follow(tmp_path / "app.koord", fleet(tmp_path, 2), trace, more=(option,))
    assert done.status == 2 and "does not go with --follow" in done.said


def test_other_files(tmp_path: Path) -> None:
    found(tmp_path, LOST, 2)
    for text, why in (
        ("", "no header of format"), ("{}\n", "no header"), ("[1]\n", "no record"),
        ("{" * 5000 + "\n", "not a line of JSON"),
        ("\x7fELF\x02\n", ":1: not a line of JSON"), ("\udc80\x00\n\x00", ":1: not a line of JSON"),
        ('{"kind": "header", "format": "koord-trace/1"}\n', "not the trace of a counterexample"),
        ('{"kind": "header", "format": "koord-trace/1", "counterexample": "run"}\n', "a broken header"),
    ):  # fmt: skip
        other = tmp_path / "other.jsonl"
        other.write_text(text, errors="surrogateescape")
        assert why in refused(tmp_path, other)
    assert "No such file" in refused(tmp_path, tmp_path / "none.jsonl")


def _spoilt(dice: Random, value: Any) -> Any:
    """Something else somewhere in a record."""
    if isinstance(value, dict) and value and dice.random() < 0.9:
        name = dice.choice(sorted(value))
        if dice.random() < 0.15:
            return {n: v for n, v in value.items() if n != name}
        return {**value, name: _spoilt(dice, value[name])}
    if isinstance(value, list) and value and dice.random() < 0.9:
        place = dice.randrange(len(value))
        return [_spoilt(dice, v) if k == place else v for k, v in enumerate(value)]
    return dice.choice([None, True, -1, 3, 2**70, 1e308, float("nan"), "1/3", "1/0", "x", [], {}, [[]], {"a": 1}])


def tried(path: Path, program: Program) -> str:
    try:
        given = read(path)
        plan = make_plan(alone(program, given.robots), given, [{}])
    except (BadTrace, CannotExecute) as error:
        assert str(error)
        return "refused"
    assert plan.rounds
    return "planned"


@pytest.mark.parametrize("seed", range(2))
def test_whatever_is_in_a_trace_it_is_followed_or_refused(tmp_path: Path, seed: int) -> None:
    (tmp_path / "env.yaml").write_text(GRID)
    trace = found(tmp_path, MOVED, 2, ("--env", str(tmp_path / "env.yaml"), "--no-deadlock"))
    program = check_file(str(tmp_path / "app.koord")).program
    lines, raw = trace.read_text().splitlines(keepends=True), trace.read_bytes()
    assert tried(trace, program) == "planned"
    dice = Random(seed)
    for _ in range(150):
        spoilt = list(lines)
        for _ in range(dice.choice((1, 1, 2))):
            place = dice.randrange(len(spoilt))
            spoilt[place] = json.dumps(_spoilt(dice, json.loads(lines[place]))) + "\n"
        if dice.random() < 0.3:
            spoilt.pop(dice.randrange(len(spoilt)))
        trace.write_text("".join(spoilt))
        tried(trace, program)
        cut = bytearray(raw[: dice.randrange(len(raw))])
        if cut and dice.random() < 0.5:
            cut[dice.randrange(len(cut))] = dice.randrange(256)
        trace.write_bytes(bytes(cut))
        tried(trace, program)
