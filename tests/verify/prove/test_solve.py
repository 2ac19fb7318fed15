"""Solvers are not trusted: anything but one answer is UNKNOWN, with its reason."""

from __future__ import annotations

import sys
import time
from fractions import Fraction
from pathlib import Path

import pytest

from koordgen.lang.diagnostics import InternalError
from koordgen.lang.node import replace
from koordgen.verify.prove.smt import solve
from koordgen.verify.prove.smt.axis_parallel import axis_parallel
from koordgen.verify.prove.smt.obligation import LabelledFormula, Obligation
from koordgen.verify.prove.smt.sexpr import Unreadable, read, value, values
from koordgen.verify.prove.smt.solve import CrossCheck, Limits, Solver, SolverMissing, solver_of
from koordgen.verify.prove.smt.term import INT, REAL, add, all_of, constant, equals, less, multiply, real
from tests.verify.prove.terms import ROBOT, contradictory, false_one, hard, obligation, true_one, x

QUICK = Limits(query=0.2, total=5.0, memory=512)
# A solver that does to each question what ANSWER says: `question` is the text up to its echo, `end` the word echoed.
FAKE = """
import os, re, signal, sys, time
def asked():
    text = ""
    for line in sys.stdin:
        text += line
        found = re.match(r'\\(echo "(.*)"\\)', line)
        if found:
            yield text, found[1]
            text = ""
for question, end in asked():
    ANSWER
    print(end, flush=True)
"""


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solve, "GRACE", 0.2)


def fake(tmp_path: Path, answer: str, limits: Limits = QUICK) -> Solver:
    script = tmp_path / f"solver{len(list(tmp_path.iterdir()))}.py"
    script.write_text(FAKE.replace("ANSWER", answer))
    return Solver("z3", limits, [sys.executable, "-S", str(script)])


@pytest.mark.parametrize("name", ["z3", "cvc5", "both"])
def test_real_solvers_answer_and_show_models_and_cores(name: str) -> None:
    with solver_of(name, Limits()) as solver:
        assert solver.ask(true_one()).result == "unsat"
        found = solver.ask(false_one(), [x(ROBOT), ROBOT])
        assert found.result == "sat"
        number, robot = found.values
        assert isinstance(number, (int, Fraction)) and Fraction(1, 3) <= number < Fraction(1, 2)
        assert isinstance(robot, int)
        assert solver.ask(contradictory(), core=True).core == (0, 2)
        assert solver.ask(true_one()).result == "unsat", "what was asked before leaves nothing behind"


LIES = {
    "nothing": ("pass", "neither sat nor unsat"),
    "nonsense": ("print('maybe')", "neither sat nor unsat: maybe"),
    "both": ("print('unsat\\nsat')", "neither sat nor unsat: unsat sat"),
    "an error first": ("print('(error \"line 3: unknown constant\")\\nunsat')", "unknown constant"),
    "unsat and more": ("print('unsat (sort of)')", "neither sat nor unsat"),
    "dies": ("sys.exit(3)", "ended with status 3"),
    "dies with a word": ("print('unsat', flush=True); sys.exit(1)", "ended with status 1"),
    "is killed": ("os.kill(os.getpid(), signal.SIGKILL)", "killed by signal 9"),
    "out of memory": ("print('(error \"out of memory\")', flush=True); sys.exit(101)", "its memory is limited"),
    "hangs": ("time.sleep(60)", "did not answer in time"),
    "talks without end": ("[print('x' * 1000) for _ in iter(int, 1)]", "did not answer in time"),
    "is not text": ("sys.stdout.buffer.write(b'\\xff\\xfe\\n'); sys.stdout.flush()", "neither sat nor unsat"),
    "gives up": ("print('unknown' if 'check-sat' in question else '(:reason-unknown \"(incomplete)\")')", "incomplete"),
    "takes too long": ("print('unknown' if 'check-sat' in question else '(:reason-unknown \"timeout\")')", "--timeout"),
}


@pytest.mark.parametrize("lie", LIES)
def test_whatever_is_no_answer_is_unknown_with_a_reason(tmp_path: Path, lie: str) -> None:
    answer, reason = LIES[lie]
    with fake(tmp_path, answer) as solver:
        found = solver.ask(true_one())
    assert found.result == "unknown"
    assert reason in found.reason
    assert len(found.reason) < 300


def test_a_solver_that_broke_is_started_anew(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    answer = f"""
    if not os.path.exists({str(mark)!r}):
        open({str(mark)!r}, "w").close()
        sys.exit(1)
    print("unsat")
    """
    with fake(tmp_path, answer.strip("\n ")) as solver:
        assert [solver.ask(true_one()).result for _ in range(3)] == ["unknown", "unsat", "unsat"]


@pytest.mark.parametrize("model", ["", "(", "((x))", '(error \\"no model\\")', "((x 1) (y 2))", "sat"])
def test_sat_without_a_model_that_can_be_read_is_unknown(tmp_path: Path, model: str) -> None:
    answer = f"print('sat' if 'check-sat' in question else '''{model}''')"
    with fake(tmp_path, answer) as solver:
        found = solver.ask(false_one(), [x(ROBOT)])
    assert found.result == "unknown"
    assert "unusable model" in found.reason


def test_a_solver_that_does_not_read_does_not_block(tmp_path: Path) -> None:
    script = tmp_path / "deaf.py"
    script.write_text("import time\ntime.sleep(60)\n")
    large = [constant(f"{'v' * 200}{i}", INT) for i in range(2000)]  # more than a pipe holds
    began = time.monotonic()
    with Solver("z3", QUICK, [sys.executable, "-S", str(script)]) as solver:
        assert solver.ask(true_one(), large).result == "unknown"
    assert time.monotonic() - began < 20, "it sleeps for 60 s"


def test_all_queries_together_have_a_limit(tmp_path: Path) -> None:
    with fake(tmp_path, "time.sleep(60)", Limits(query=0.1, total=0.15)) as solver:
        reasons = [solver.ask(true_one()).reason for _ in range(3)]
    assert "did not answer" in reasons[0]
    assert "used up" in reasons[2]


def test_what_is_beyond_a_solver_is_unknown() -> None:
    with Solver("z3", Limits(query=0.3)) as solver:
        found = solver.ask(hard())
        assert found.result == "unknown"
        assert "--timeout" in found.reason or "cannot decide" in found.reason
        assert solver.ask(true_one()).result == "unsat"


def test_memory_is_limited() -> None:
    with Solver("z3", Limits(query=5.0, memory=1)) as solver:
        found = solver.ask(hard())
    assert found.result == "unknown"


def test_two_solvers_that_contradict_each_other_stop_everything(tmp_path: Path) -> None:
    liar = fake(tmp_path, "print('sat')")
    with CrossCheck([Solver("z3", Limits()), liar]) as both, pytest.raises(InternalError, match="contradict"):
        both.ask(true_one())


def test_of_two_solvers_one_may_not_know(tmp_path: Path) -> None:
    with CrossCheck([fake(tmp_path, "print('unknown')"), Solver("z3", Limits())]) as both:
        assert both.ask(true_one()).result == "unsat"
    with CrossCheck([fake(tmp_path, "print('unknown')"), fake(tmp_path, "sys.exit(1)")]) as neither:
        assert neither.ask(true_one()).result == "unknown"


def test_a_missing_solver_is_no_answer(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with pytest.raises(SolverMissing, match="/no/such/solver"):
        Solver("z3", QUICK, ["/no/such/solver"]).ask(true_one())
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(SolverMissing, match="solver z3 not found"):
        solver_of("z3", Limits())


def test_values() -> None:
    text = "((a 3) (b (- 3)) (c 0.5) (d (/ 1.0 3.0)) (e (- (/ 1 3))) (f (/ (- 1) 3)) (g true) (h |T!val!0|))"
    found = values(text, 8)
    assert found[:2] == [3, -3]
    assert found[2:6] == [Fraction(1, 2), Fraction(1, 3), Fraction(-1, 3), Fraction(-1, 3)]
    assert found[6:] == [True, "|T!val!0|"]
    assert value(read("(as @T_0 T)")[0]) == "@T_0"
    assert str(value(read("(root-obj (+ (^ x 2) (- 2)) 2)")[0])).startswith("irrational")
    for wrong in ("(/ 1 0)", "(- true)", "(- (/ 1 0))"):
        with pytest.raises(Unreadable):
            value(read(wrong)[0])
    for text in ("((a 1)", "(a 1))", "((a 1))", "sat"):
        with pytest.raises(Unreadable):
            values(text, 2)


def parted() -> Obligation:
    """A true and a false conjunct, of three robots by number."""
    parts = (less(x(ROBOT), real(1)), less(x(ROBOT), real(Fraction(1, 3))))
    facts = tuple([LabelledFormula("goal", part, "app.koord", 9) for part in parts])
    return replace(true_one(), conjuncts=facts, robots=3, goal=LabelledFormula("goal", all_of(parts), "app.koord", 9))


def test_a_goal_in_parts_is_proved_when_all_parts_are() -> None:
    fact = LabelledFormula("guard", less(x(ROBOT), real(Fraction(1, 4))), "app.koord", 1)
    with Solver("z3", Limits()) as solver:
        assert solver.ask(replace(parted(), facts=(fact,))).result == "unsat"
        assert solver.ask(parted()).result == "unsat"
        fact = LabelledFormula("guard", less(x(ROBOT), real(Fraction(1, 2))), "app.koord", 1)
        assert solver.ask(replace(parted(), facts=(fact,))).result == "sat"
        assert solver.ask(true_one()).result == "unsat"


@pytest.mark.parametrize(
    "said", ["unsat", "unsat\\nunsat\\nunsat", "", "unsat\\nmaybe", "unsat\\nunknown", "(error)\\nunsat"]
)
def test_a_part_without_an_answer_is_no_proof(tmp_path: Path, said: str) -> None:
    with fake(tmp_path, f"print('{said}')") as solver:
        assert solver.ask(parted()).result == "unknown"
    with fake(tmp_path, "print('unsat\\nunsat')") as solver:
        assert solver.ask(parted()).result == "unsat"


def many() -> list[list[Obligation]]:
    """Rooms of a true and a false one that share a fact; of one that is satisfiable; of one in parts."""
    true, false = true_one(), false_one()
    shared = (*true.facts, *false.facts)
    more = LabelledFormula("more", less(x(ROBOT), real(Fraction(1, 8))), "app.koord", 3)
    satisfiable = replace(true, goal=None, expected="sat")
    return [
        [replace(true, facts=shared), replace(false, facts=shared[1:]), replace(false, facts=(*shared, more))],
        [satisfiable],
        [replace(parted(), facts=(more,)), parted()],
    ]


@pytest.mark.parametrize("name", ["z3", "cvc5", "both"])
def test_many_are_answered_as_each_alone_is(name: str) -> None:
    with solver_of(name, Limits()) as solver:
        found = solver.ask_all(many())
        assert [o for o, _ in found] == [o for room in many() for o in room], "in their order"
        assert [answer.result for _, answer in found] == ["unsat", "sat", "unsat", "sat", "unsat", "unsat"]
        assert [solver.ask(o).result for o, _ in found] == [answer.result for _, answer in found]
        assert solver.ask_all([]) == []


def distance_of(x: int, y: int, about: float) -> Obligation:
    """Facts about two points: these are their gaps along x and y, and their distance is about a number."""
    d, u, v = (constant(name, REAL) for name in ("d", "u", "v"))
    square = equals(multiply(d, d), add(multiply(u, u), multiply(v, v)))
    near = all_of([less(real(about - 0.1), d), less(d, real(about + 0.1))])
    return obligation({"gap": equals(u, real(x)), "other gap": equals(v, real(y)), "square": square, "near": near},
                      None, logic="QF_UFNIRA")  # fmt: skip


def test_consistency_needs_no_points_on_a_line() -> None:
    """A batch tries points on a line parallel to an axis; without such a model the obligation itself is asked."""
    with Solver("z3", Limits()) as solver:
        found = solver.ask_all([[distance_of(0, 2, 2.0)], [distance_of(1, 1, 1.4)], [distance_of(0, 2, 3.0)]])
    assert [answer.result for _, answer in found] == ["sat", "sat", "unsat"]


def test_the_stricter_form_is_linear_and_implies_the_obligation() -> None:
    given = distance_of(1, 1, 1.4)
    stricter = axis_parallel(given)
    assert stricter is not None and stricter.logic in solve.LINEAR
    assert axis_parallel(replace(given, expected="unsat")) is None, "a proof must not get more facts"
    with Solver("z3", Limits()) as solver:
        for fact, other in zip(given.facts, stricter.facts, strict=True):
            claim = replace(given, facts=(other,), goal=fact, expected="unsat")
            assert solver.ask(claim).result == "unsat", fact.label


def test_what_is_beyond_the_batch_is_asked_alone() -> None:
    with Solver("z3", Limits(query=0.3)) as solver:
        found = [answer.result for _, answer in solver.ask_all([[true_one()], [hard()], [false_one()]])]
    assert found == ["unsat", "unknown", "sat"]


@pytest.mark.parametrize("lie", [lie for lie in LIES if lie not in ("hangs", "takes too long")])
def test_whatever_is_no_answer_is_unknown_in_a_batch_as_well(tmp_path: Path, lie: str) -> None:
    with fake(tmp_path, LIES[lie][0]) as solver:
        found = solver.ask_all([[true_one(), true_one()], [true_one()]])
    assert {answer.result for _, answer in found} == {"unknown"}


@pytest.mark.parametrize("wrong", ["", "unsat\\nunsat", "(error)\\nunsat", "unknown", "unsat unsat", "maybe"])
def test_an_answer_too_few_or_too_many_in_a_batch_counts_for_nothing(tmp_path: Path, wrong: str) -> None:
    """The second question of three is answered so, those that are asked alone are not decided."""
    asked = tmp_path / "asked"
    answer = f"""
    count = len(open({str(asked)!r}).read()) if os.path.exists({str(asked)!r}) else 0
    open({str(asked)!r}, "a").write("x" * ("check-sat" in question and end == "koordgen-batch"))
    if end == "koordgen-batch": print("{wrong}" if count == 1 else "unsat")
    elif "check-sat" in question: print("unknown" if end != "koordgen-0" else "sat")
    """
    with fake(tmp_path, answer.strip("\n ")) as solver:
        found = [answer.result for _, answer in solver.ask_all([[true_one(), true_one(), true_one()]])]
    assert found == (["unsat", "unknown", "unsat"] if wrong == "unknown" else ["unknown"] * 3)
