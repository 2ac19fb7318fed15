"""One meaning: random programs agree, bit for bit, in the executable semantics and as generated Python on the runtime.

A difference names its program: `random_program(seed)`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import pytest

from koordgen.emit.program import program_text
from koordgen.ir import expr, stmt
from koordgen.ir.builtins import FUNCTIONS, METHODS, UPDATE_SIGNATURES
from koordgen.ir.verify import verify
from koordgen.semantics.step import initial
from tests.agree.both import Difference, Generated, Meant, agree
from tests.agree.faults import COMMON, RARE, Fault
from tests.agree.programs import N_SYS, nodes, random_program
from tests.semantics.programs import compiled

# These stand in properties and assumptions only, of which there is no generated code.
FORMULAS = {"LocalOf", "PortOf"}
CONSTRUCTS = {cls.__name__ for union in (expr.Expr, stmt.Stmt, stmt.Place) for cls in union.__args__} - FORMULAS
CONSTRUCTS.add("LoopInvariant")
BUILTINS = {*FUNCTIONS, *UPDATE_SIGNATURES, *(name for _, name in METHODS)}


def run(seeds: Iterable[int]) -> tuple[Counter[str], Counter[str]]:
    """How often an event ran, and in how many of the programs each construct stands."""
    seen: Counter[str] = Counter()
    contained: Counter[str] = Counter()
    for seed in seeds:
        program = agree(seed, seen)
        found = nodes(program)
        contained.update({type(node).__name__ for node in found})
        contained.update({f"{node.name}()" for node in found if isinstance(node, expr.Builtin)})
        contained.update({"atomic" for event in program.events if event.lock is not None})
    return seen, contained


def rounds(seen: Counter[str]) -> int:
    """How many rounds of one robot were compared."""
    return seen["ran"] + seen["discarded"] + seen["none"]


def test_semantics_and_generated_code_agree() -> None:
    seen, _ = run(range(100))
    total = rounds(seen)
    assert total == 100 * 6
    assert seen["ran"] >= total / 2, "most of what is compared must do something"
    assert seen["discarded"] >= total / 50
    assert seen["violated"] >= total / 10, "loop invariants that are false must be reported"


def test_random_programs_are_well_typed() -> None:
    for seed in range(100):
        verify(random_program(seed))


@pytest.mark.slow
def test_semantics_and_generated_code_agree_on_2000_programs_of_every_construct() -> None:
    count = 2000
    seen, contained = run(range(1000, 1000 + count))
    print(f"\nof {rounds(seen)} rounds of {count} programs: {dict(seen)}; programs with")
    for name in sorted([*CONSTRUCTS, *[f"{b}()" for b in BUILTINS], "atomic"], key=lambda name: contained[name]):
        print(f"  {name:16} {contained[name] / count:6.1%}")
    assert seen["ran"] >= rounds(seen) / 2
    assert [name for name in (*CONSTRUCTS, "atomic") if contained[name] < count * 0.05] == []
    assert [name for name in BUILTINS if contained[f"{name}()"] < count * 0.01] == []


def programs_until_found(fault: Fault, most: int, monkeypatch: pytest.MonkeyPatch) -> int | None:
    """How many programs it takes to see a seeded fault; None when so many do not show it."""
    fault.patch(monkeypatch)
    for seed in range(most):
        try:
            agree(seed, Counter(), fault.emitted, fault.spoil)
        except Difference:
            return seed + 1
    return None


@pytest.mark.parametrize("fault", COMMON, ids=lambda fault: fault.name)
def test_a_seeded_fault_is_found(fault: Fault, monkeypatch: pytest.MonkeyPatch) -> None:
    assert programs_until_found(fault, 100, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("fault", RARE, ids=lambda fault: fault.name)
def test_a_rare_seeded_fault_is_found(fault: Fault, monkeypatch: pytest.MonkeyPatch) -> None:
    assert programs_until_found(fault, 2000, monkeypatch)


NANS = """
def Halt:
  Point place
  int id

local:
  List<bool> equal
  List<bool> within
  List<int> counts
  List<bool> others
E:
  pre: True
  eff:
    float nan = 1e308 * 10 - 1e308 * 10
    List<float> nans = [1, nan]
    Point p = Point(nan, 0, 0)
    Halt halt = Halt(p, 1)
    List<Halt> halts = [halt]
    Map<int, float> found = {1: nan}
    (int, float) pair = (1, nan)
    Queue<Point> points
    points.push(p)
    equal = [nan == nan, nans == nans, p == p, halt == halt, halts == halts, found == found, pair == pair, \\
             Pose(p, 0) == Pose(p, 0), points == points]
    within = [nan in nans, p in points, halt in halts, nan not in nans, not (p != p)]
    counts = [nans.count(nan), halts.count(halt), nans.index(1), nans.count(1)]
    others = [nans[:1] == nans[:1], Point(-0.0, 0, 0) == Point(0, 0, 0), 1.0 in nans, halt != halt]
"""


def test_nan_equals_nothing_at_any_depth() -> None:
    program = compiled(NANS)
    state = initial(program, N_SYS)
    event, _, outcome = Generated(program, program_text(program)).event(state, 0)
    assert (event, None, outcome) == Meant(program).event(state, 0)
    assert isinstance(outcome, dict)
    values = {name: [part[1] for part in parts[1:]] for name, parts in outcome["locals"].items()}
    assert values["equal"] == ["False"] * 9
    assert values["within"] == ["False", "False", "False", "True", "False"]
    assert values["counts"] == ["0", "0", "0", "1"]
    assert values["others"] == ["True"] * 4


@pytest.mark.parametrize("change", ["i = nans.index(nan)", "nans.remove(nan)", "places.remove(place)"])
def test_nan_is_not_found(change: str) -> None:
    text = f"""
local: int i
E:
  pre: True
  eff:
    float nan = 1e308 * 10 - 1e308 * 10
    List<float> nans = [1, nan]
    Point place = Point(nan, 0, 0)
    List<Point> places = [place]
    {change}
"""
    program = compiled(text)
    state = initial(program, N_SYS)
    assert Meant(program).event(state, 0) == ("E", None, "discarded")
    assert Generated(program, program_text(program)).event(state, 0) == ("E", None, "discarded")
