"""Verdicts on programs with known truth. The semantics reproduces every counterexample and every run."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import pytest

from koordgen.build.pipeline import check_file
from koordgen.lang.ir.decl import Program
from koordgen.lang.semantics.exact import exact
from koordgen.verify.prove.obligations.generate import obligations
from koordgen.verify.prove.report.explain import invariant_of
from koordgen.verify.prove.report.model import failing_conjunct, is_true, with_values
from koordgen.verify.prove.report.show import suggestion
from koordgen.verify.prove.report.unknown import unknown_reason
from koordgen.verify.prove.report.verdict import InvariantVerdict, Question, prove
from koordgen.verify.prove.smt.solve import Limits, Solver, SolverAnswer
from tests.verify.prove.programs import CONTRADICTION, COUNTER, CUBES, DIVIDES, LINE, STRONG, TOKEN


@pytest.fixture(scope="module")
def solver() -> Iterator[Solver]:
    with Solver("z3", Limits(query=2.0)) as running:
        yield running


def program_of(tmp_path: Path, text: str) -> Program:
    path = tmp_path / "app.koord"
    path.write_text(text)
    return check_file(str(path)).program


def verdicts(tmp_path: Path, text: str, solver: Solver, robots: int | None = None) -> dict[str, InvariantVerdict]:
    return {v.invariant: v for v in prove(Question(program_of(tmp_path, text), robots, None), solver)}


@pytest.mark.parametrize("robots", [None, 1, 3])
def test_what_is_inductive_is_proved(tmp_path: Path, solver: Solver, robots: int | None) -> None:
    found = verdicts(tmp_path, STRONG, solver, robots)
    assert {name: v.verdict for name, v in found.items()} == {"Geofence": "PROVED", "(well-defined)": "PROVED"}
    kinds = {entry.kind for entry in found["Geofence"].assumptions}
    assert {"port assumption", "initially", "arithmetic"} <= kinds
    assert all(o.answer.result == "unsat" for o in found["Geofence"].outcomes)


LOOP = """\
allread: int n[N_SYS]

Up:
  pre: n[pid] == 0
  eff:
    for i in range(N_SYS):
      n[pid] = (n[pid] + 1) % 3

invariant Zero: forall i in ID: n[i] == 0
"""


def test_what_holds_for_three_robots_only_is_proved_for_them_written_out(tmp_path: Path, solver: Solver) -> None:
    """The turns of the loop keep no invariant. Three of them lead back to zero."""
    assert verdicts(tmp_path, LOOP, solver)["Zero"].verdict != "PROVED"
    assert verdicts(tmp_path, LOOP, solver, 3)["Zero"].verdict == "PROVED"
    wrong = LOOP.replace("% 3", "% 4")
    assert verdicts(tmp_path, wrong, solver, 3)["Zero"].verdict in ("FALSIFIED", "NOT INDUCTIVE")


def test_with_a_number_the_assumptions_are_consistent_for_that_number(tmp_path: Path, solver: Solver) -> None:
    crowded = f"{STRONG}initially: N_SYS < 3\n"
    assert verdicts(tmp_path, crowded, solver)["Geofence"].verdict == "PROVED"
    assert verdicts(tmp_path, crowded, solver, 2)["Geofence"].verdict == "PROVED"
    assert verdicts(tmp_path, crowded, solver, 3)["Geofence"].verdict == "VACUOUS"


def test_the_published_invariant_lacks_a_bound_on_targets_which_is_named(tmp_path: Path, solver: Solver) -> None:
    found = verdicts(tmp_path, LINE, solver)["Geofence"]
    assert found.verdict == "NOT INDUCTIVE"
    told = found.explanation
    assert told is not None and told.counterexample is not None
    assert told.lacking == ("forall i in ID: Motion.target[i] in Rect(lo, hi)",)
    shown = told.counterexample
    assert shown.kind == "environment" and shown.failed is not None
    # Once more, by the semantics alone: true before, false after, by a step that the assumption allows.
    program = with_values(exact(program_of(tmp_path, LINE)), shown.before.params)
    geofence = invariant_of(program, "Geofence")
    assert is_true(geofence, program, shown.before)
    assert not is_true(geofence, program, shown.after)
    numbers = [c for r in shown.after.robots for p in r.ports.values() for c in (p.x, p.y, p.z)]  # type: ignore[union-attr]
    assert all(type(number) is Fraction for number in numbers)


def test_with_what_was_named_it_is_proved(tmp_path: Path, solver: Solver) -> None:
    told = verdicts(tmp_path, LINE, solver)["Geofence"].explanation
    assert told is not None
    stronger = f"{LINE}invariant More: {told.lacking[0]}\n"
    assert {v.verdict for v in verdicts(tmp_path, stronger, solver).values()} == {"PROVED"}


def test_a_sensor_of_which_nothing_is_assumed_is_named_with_what_could_be(tmp_path: Path, solver: Solver) -> None:
    assume = "assume position' in Rect(position, target)"
    bare = LINE.replace(f"  {assume}\n", "")
    found = verdicts(tmp_path, bare, solver)["Geofence"]
    assert found.verdict == "FALSIFIED"
    told = found.explanation
    assert told is not None and told.unassumed == ("Motion.position",)
    assert told.supposed == (f"using Motion: {assume}",)
    assert told.lacking == ("forall i in ID: Motion.target[i] in Rect(lo, hi)",)
    assert "nothing is assumed about Motion.position after a step" in suggestion(found)
    with_targets = verdicts(tmp_path, STRONG.replace(f"  {assume}\n", ""), solver)["Geofence"].explanation
    assert with_targets is not None
    assert (with_targets.supposed, with_targets.lacking) == ((f"using Motion: {assume}",), ())


def test_where_no_assumption_helps_none_is_proposed(tmp_path: Path, solver: Solver) -> None:
    bare = LINE.replace("  assume position' in Rect(position, target)\n", "")
    wrong = bare.replace("x[i] in Rect(lo, hi)\n", "x[i].x < Motion.target[i].x and Motion.position[i].x < 5\n")
    told = verdicts(tmp_path, wrong, solver)["Geofence"].explanation
    assert told is not None and (told.supposed, told.lacking) == ((), ())


def test_a_false_invariant_comes_with_a_run_and_does_not_spoil_the_others(tmp_path: Path, solver: Solver) -> None:
    found = verdicts(tmp_path, COUNTER, solver)
    assert (found["Below"].verdict, found["Small"].verdict) == ("FALSIFIED", "PROVED")
    assert "Below" not in found["Small"].rests_on
    told = found["Below"].explanation
    assert told is not None and told.run is not None
    events = [moment.event for moment in told.run.run_states]
    assert events[:2] == ["", "init"] and events.count("Up") == 3
    last = told.run.run_states[-1].state
    program = exact(program_of(tmp_path, COUNTER))
    assert failing_conjunct(invariant_of(program, "Below"), program, last) is not None
    assert all(
        failing_conjunct(invariant_of(program, "Below"), program, m.state) is None for m in told.run.run_states[:-1]
    )
    acted = next(m.pid for m in told.run.run_states if m.event == "Up")
    assert acted is not None and last.robots[acted].locals["third"] == Fraction(1)


def test_contradictory_assumptions_prove_nothing(tmp_path: Path, solver: Solver) -> None:
    found = verdicts(tmp_path, CONTRADICTION, solver)["Low"]
    assert found.verdict == "VACUOUS"
    assert "app.koord:3" in found.reason and "app.koord:4" in found.reason


FOR_ROBOT_0 = """\
using S:
  sensors: int v
  assume pid == 0 or v' > 0
  assume pid == 0 or v' < 0
local: int a
Go:
  pre: True
  eff: a = 0
invariant Zero: forall i in ID: a[i] == 0
"""


def test_assumptions_that_contradict_for_some_robots_only_prove_nothing(tmp_path: Path, solver: Solver) -> None:
    found = verdicts(tmp_path, FOR_ROBOT_0, solver)["Zero"]
    assert found.verdict == "VACUOUS"
    assert "of two robots or more" in found.reason
    assert verdicts(tmp_path, FOR_ROBOT_0, solver, 1)["Zero"].verdict == "PROVED"
    alone = f"initially: N_SYS == 1\n{FOR_ROBOT_0}"
    assert verdicts(tmp_path, alone, solver)["Zero"].verdict == "PROVED"
    without = FOR_ROBOT_0.replace("  assume pid == 0 or v' < 0\n", "")
    assert verdicts(tmp_path, without, solver)["Zero"].verdict == "PROVED"


def test_an_event_without_a_result_is_told_with_its_line(tmp_path: Path, solver: Solver) -> None:
    found = verdicts(tmp_path, DIVIDES, solver)["(well-defined)"]
    assert found.verdict == "NOT INDUCTIVE"
    told = found.explanation
    assert told is not None and told.counterexample is not None
    assert told.counterexample.discarded == "line 8: division by zero"


def test_what_is_beyond_solvers_is_unknown_and_names_the_obligation(tmp_path: Path) -> None:
    with Solver("z3", Limits(query=0.3)) as quick:
        found = verdicts(tmp_path, CUBES, quick)["Right"]
    assert found.verdict == "UNKNOWN"
    assert "Right-Try" in found.reason and "z3" in found.reason


def test_two_robots_that_read_the_same_moment_both_take_it(tmp_path: Path, solver: Solver) -> None:
    found = verdicts(tmp_path, TOKEN, solver)["One"]
    assert found.verdict in ("FALSIFIED", "NOT INDUCTIVE")
    told = found.explanation
    assert told is not None
    state = told.run.run_states[-1].state if told.run else told.counterexample.after  # type: ignore[union-attr]
    assert [robot.locals["mine"] for robot in state.robots] == [True, True]


class Lying(Solver):
    """Says of every obligation what it is told to say."""

    def __init__(self, result: str, about: str = "") -> None:
        super().__init__("z3", Limits())
        self.result, self.about = result, about

    def ask(self, obligation, wanted=(), core=False, most=0.0) -> SolverAnswer:  # type: ignore[no-untyped-def]
        if obligation.kind == "consistency" and self.about != "consistency":
            return SolverAnswer("sat", 0.0)
        if self.about in obligation.name:
            values = tuple([0] * len(wanted)) if self.result == "sat" else ()
            return SolverAnswer(self.result, 0.0, "it said so", values)  # type: ignore[arg-type]
        return SolverAnswer("unsat", 0.0)

    def ask_all(self, rooms):  # type: ignore[no-untyped-def]
        return [(obligation, self.ask(obligation)) for room in rooms for obligation in room]


@pytest.mark.parametrize("result", ["unknown", "sat"])
@pytest.mark.parametrize("about", ["", "Geofence-init", "Geofence-TargetUpdate", "Geofence-environment"])
def test_a_solver_that_is_wrong_or_silent_about_one_obligation_proves_nothing(
    tmp_path: Path, result: str, about: str
) -> None:
    found = verdicts(tmp_path, STRONG, Lying(result, about))["Geofence"]
    assert found.verdict == "UNKNOWN"
    assert "it said so" in found.reason or "cannot be shown" in found.reason


def test_without_knowing_that_assumptions_are_consistent_nothing_is_proved(tmp_path: Path) -> None:
    found = verdicts(tmp_path, STRONG, Lying("unknown", "consistency"))["Geofence"]
    assert found.verdict == "UNKNOWN"
    assert "consistency of the assumptions is undecided" in found.reason


# An event that cannot be run exactly stands beside one that can; of what `weigh` yields nothing is known.
ROUND = """\
param float gap = 1.0

extern fun weigh(Point p) -> float

using Motion:
  sensors:
    Point position
    bool reached
  actuators: Point target

local:
  bool sent
  bool there
  float heavy
  float part

Send:
  pre: not sent
  eff:
    Motion.target = Point(cos(gap), sin(gap), 0)
    sent = True

Arrive:
  pre: Motion.reached
  eff: there = True

Weigh:
  pre: True
  eff: heavy = weigh(Motion.position)

Share:
  pre: True
  eff: part = 1 / gap

invariant Sent: forall i in ID: not there[i] or sent[i]
invariant Light: forall i in ID: heavy[i] <= 5
"""


def test_a_run_is_found_past_events_that_cannot_be_run_exactly(tmp_path: Path, solver: Solver) -> None:
    found = verdicts(tmp_path, ROUND, solver)["Sent"]
    assert found.verdict == "FALSIFIED"
    assert [m.event for m in found.explanation.run.run_states] == ["", "init", "Arrive"]  # type: ignore[union-attr]


def test_what_has_no_value_by_the_params_alone_is_told(tmp_path: Path, solver: Solver) -> None:
    found = verdicts(tmp_path, ROUND, solver)["(well-defined)"]
    assert (found.verdict, found.explanation.with_defaults) == ("NOT INDUCTIVE", True)  # type: ignore[union-attr]
    assert verdicts(tmp_path, f"{ROUND}initially: gap > 0\n", solver)["(well-defined)"].verdict == "PROVED"


def test_unknown_tells_the_obligation_its_place_the_reason_and_what_may_help(tmp_path: Path, solver: Solver) -> None:
    light = verdicts(tmp_path, ROUND, solver)["Light"]
    assert light.verdict == "UNKNOWN"
    assert light.reason.startswith("Light-Weigh (") and "app.koord:27): " in light.reason
    assert "the result of weigh is known only by its contract and axioms" in light.reason
    assert light.reason.endswith("Add facts to an invariant, a contract or an axiom")


def test_unknown_names_the_products_that_are_too_hard(tmp_path: Path) -> None:
    with Solver("z3", Limits(query=0.3)) as hasty:
        right = verdicts(tmp_path, CUBES, hasty)["Right"]
    assert right.verdict == "UNKNOWN" and "found no answer within 0.3 s" in right.reason
    assert "`a * a * a` (line 8), `b * b * b` (line 8), `c * c * c` (line 8)" in right.reason
    assert "`a * a`" not in right.reason, "the whole product, not its parts"


# A ring that two robots may enter by stale copies: what another one wrote meanwhile is its leg's successor.
RING = """\
allread: int leg[N_SYS]

local: bool begun

init: leg[pid] = pid

Begin:
  pre: not begun
  eff: begun = True

Next:
  pre: begun and not (leg[pid] + 1) % 7 in leg
  eff: leg[pid] = {following}

invariant Legs: forall i in ID: 0 <= leg[i] and (not begun[i] or leg[i] < 7) and (begun[i] or leg[i] == i)
invariant Apart: forall i, j in ID: i == j or leg[i] != leg[j]
"""


@pytest.mark.parametrize(("following", "apart"), [("(leg[pid] + 1) % 7", True), ("0", False)])
def test_of_another_robot_it_is_told_what_its_plain_event_wrote(
    tmp_path: Path, solver: Solver, following: str, apart: bool
) -> None:
    text = RING.format(following=following).replace("pre: not begun", "pre: not begun and pid < 7")
    found = verdicts(tmp_path, text, solver)
    assert found["Legs"].verdict == "PROVED"
    assert (found["Apart"].verdict == "PROVED") == apart


def test_the_ledger_tells_lemmas_from_approximations() -> None:
    from koordgen.verify.prove.report.ledger import COMPARED, HARMLESS, Ledger

    program = check_file(str(Path(__file__).parents[3] / "examples/task/task.koord")).program
    entries = Ledger(program).of(obligations(program))
    kinds = {entry.kind: entry.checked for entry in entries if entry.kind in ("lemma", "approximation")}
    assert kinds == {"lemma": COMPARED, "approximation": HARMLESS}
    assert any(e.kind == "lemma" and e.text.startswith("path_distance: symmetric") for e in entries)


def test_what_was_too_much_for_a_solver_is_told_by_how_much_it_is() -> None:
    program = check_file(str(Path(__file__).parents[3] / "examples/task/separation.koord")).program
    obligation = next(o for o in obligations(program) if o.name == "Clear-Assign")
    late = SolverAnswer("unknown", 1.0, "z3 found no answer within 1 s; try a longer --timeout")
    said = unknown_reason(program, obligation, late, "")
    assert said.startswith("Clear-Assign (") and "--timeout. The obligation is linear" in said
    assert f"{len(obligation.facts)} facts" in said and "of them from `distances of paths`" in said
    assert "facts" not in unknown_reason(program, obligation, late._replace(reason="z3 was killed by signal 9"), "")


MAPS = """\
param Point corner = Point(0, 0, 0)
param Point opposite = Point(2, 2, 0)
allwrite: GridMap known = GridMap(corner, opposite, 1.0)
local: bool looked
Look:
  pre: not looked
  eff:
    looked = True
    known = mark_free(known, Grid(0, 0, 1.0))
invariant Dark: known == GridMap(corner, opposite, 1.0)
"""


def test_a_map_that_is_made_of_params_is_no_mistake_of_the_prover(tmp_path: Path, solver: Solver) -> None:
    found = verdicts(tmp_path, MAPS, solver)["Dark"]
    assert found.verdict == "UNKNOWN"  # such maps are not calculated exactly, so no run is shown
