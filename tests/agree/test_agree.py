"""Agreement of both meanings: random programs give equal bits in the executable semantics and as generated Python.

A difference names its program: `random_program(seed)`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable

import pytest

from koordgen.build.emit.program import program_text
from koordgen.lang.ir import expr, stmt
from koordgen.lang.ir.builtins import FUNCTIONS, METHODS, UPDATE_SIGNATURES
from koordgen.lang.ir.tree import walk
from koordgen.lang.ir.verify import verify
from koordgen.lang.semantics.step import initial, round_
from tests.agree.both import Difference, Generated, Meant, Outcome, agree
from tests.agree.faults import COMMON, NAN_COMPARED, RARE, Fault
from tests.agree.programs import N_SYS, random_program
from tests.lang.semantics.programs import compiled

# These stand in properties and assumptions only, of which there is no generated code.
FORMULAS = {"LocalOf", "PortOf"}
CONSTRUCTS = {cls.__name__ for union in (expr.Expr, stmt.Stmt, stmt.Place) for cls in union.__args__} - FORMULAS
CONSTRUCTS.add("LoopInvariant")
BUILTINS = {*FUNCTIONS, *UPDATE_SIGNATURES, *(name for _, name in METHODS)}


def run(seeds: Iterable[int]) -> tuple[Counter[str], Counter[str]]:
    """Return how often an event ran, and the number of programs that contain each construct."""
    seen: Counter[str] = Counter()
    contained: Counter[str] = Counter()
    for seed in seeds:
        program = agree(seed, seen)
        found = list(walk(program))
        contained.update({type(node).__name__ for node in found})
        contained.update({f"{node.name}()" for node in found if isinstance(node, expr.Builtin)})
        contained.update({"atomic" for event in program.events if event.lock is not None})
    return seen, contained


def rounds(seen: Counter[str]) -> int:
    """Return the number of rounds of one robot that were compared."""
    return seen["ran"] + seen["discarded"] + seen["none"]


def test_semantics_and_generated_code_agree() -> None:
    seen, _ = run(range(50))
    total = rounds(seen)
    assert total == 50 * 6
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
    """Return the number of programs until a seeded fault is seen; None if it is not seen in so many programs."""
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


HEAD = """
def Halt:
  Point place
  int id

using Motion:
  actuators: Point target
allread: float x[N_SYS]
allwrite: Map<int, float> known
local:
  float f = 1
  Point place
  List<float> kept
  bool on
  int i
fun inverse(float a) -> float:
  return 1 / a
fun grown(float a) -> float:
  return a * 10
fun above(float a, float b) -> bool:
  return a > b
E:
  pre: True
  eff:
    float big = 1e308
    float inf = big * 10
    float nan = inf - inf
    List<float> nans = [1, nan]
    Point p = Point(nan, 0, 0)
    Halt halt = Halt(p, 1)
    List<Halt> halts = [halt]
    Map<int, float> found = {1: nan}
    (int, float) pair = (1, nan)
    Queue<Point> points
    points.push(p)
"""


def outcomes(effect: str, spoil: Callable[[Generated], None] = lambda generated: None) -> tuple[Outcome, Outcome]:
    """Run an effect by the semantics and as generated code; return both results."""
    program = compiled(HEAD + "".join(f"    {line}\n" for line in effect.split("\n")))
    state, generated = initial(program, N_SYS), Generated(program, program_text(program))
    spoil(generated)
    return Meant(program).event(state, 0)[2], generated.event(state, 0)[2]


def test_a_comparison_that_does_not_look_for_nan_is_seen() -> None:
    meant, found = outcomes("on = nan != 1.0", NAN_COMPARED.spoil)
    assert meant == "discarded" and found != meant


@pytest.mark.parametrize(
    "met",
    [
        "nan == nan", "nan != 1.0", "nan < 1.0", "1.0 <= nan", "nan > nan", "nan >= inf", "0 * inf < 1", "1 < inf % 2",
        "nans == nans", "nans != [1.0]", "p == p", "halt == halt", "halts == halts", "found == found", "pair == pair",
        "points == points", "Pose(p, 0) == Pose(p, 0)", "Pose(Point(0, 0, 0), nan) != Pose(p, 0)",
        "Grid(0, 0, nan) == Grid(0, 0, 1)", "1.0 in nans", "nan in [1.0]", "nan not in [1.0]", "p in points",
        "halt in halts", "p in Rect(Point(0, 0, 0), Point(1, 1, 1))", "Point(0, 0, 0) in Rect(p, Point(1, 1, 1))",
        "Point(0, 0, 0) in Rect(Point(1, 1, 1), p)", "p in Ball(Point(0, 0, 0), 1)",
        "Point(0, 0, 0) in Ball(p, 1)", "Point(0, 0, 0) in Ball(Point(0, 0, 0), nan)",
        "Point(inf, 0, 0) in Ball(Point(inf, 0, 0), 1)", "min(nan, 1.0) == 1.0", "max(1.0, nan) > 0.0",
        "sorted(nans) == nans", "len(sorted([nan])) == 1", "nans.count(1) == 1", "nans.index(1) == 0",
        "clear([], [], nan)", "clear([p], [[p]], 1)", "path_distance([p], [p]) > 0", "distance(p, p) < 1",
        "above(nan, 1)", "above(1, inverse(inf) * inf)", "abs(nan) > 1", "sqrt(nan) > 1", "sum(nans) > 1",
        "first(nans[1:]) > 1", "(nan if on else nan) > 1", "not (nan > 1)", "halt.place.x > 1", "pair[1] > 1",
        "on or found[1] > 1", "floor(nan) > 1", "is_free(GridMap(p, Point(1, 1, 0), 1), Grid(0, 0, 1))",
    ],
)  # fmt: skip
def test_a_comparison_that_meets_nan_discards(met: str) -> None:
    assert outcomes(f"on = {met}") == ("discarded", "discarded")


@pytest.mark.parametrize(
    "effect",
    [
        "if nan < 1: pass", "while nan > 1: pass", "nans.remove(1)", "points.clear()\nhalts.remove(halt)",
        "for a in nans: on = a > 0", "for k, a in [(1, nan)]: on = a > 0",
        "f = f * 1e308\nf = f * 10\nif f - f == 0: on = True\nf = 1",
        "x[pid] = nan\nif x[pid] == 0: on = True\nx[pid] = 1",
        "known[1] = nan\nif known[1] == 0: on = True\nknown[1] = 1",
        "Motion.target = p\nif Motion.target == p: on = True\nMotion.target = Point(0, 0, 0)",
        "float a = 1\nfor k in range(400):\n  a = grown(a)\n  if a - a != 0: on = True",
    ],
)  # fmt: skip
def test_so_does_one_in_any_statement(effect: str) -> None:
    assert outcomes(effect) == ("discarded", "discarded")


@pytest.mark.parametrize("value", ["inf", "-inf", "nan"])
@pytest.mark.parametrize(
    "effect",
    [
        "f = {}", "place = Point(0, {}, 0)", "kept = [1, {}]", "x[pid] = {}", "known[1] = {}",
        "Motion.target = Point({}, 0, 0)",
    ],
)  # fmt: skip
def test_what_is_kept_or_sent_is_finite(effect: str, value: str) -> None:
    assert outcomes(effect.format(value)) == ("discarded", "discarded")


@pytest.mark.parametrize(
    ("effect", "value"),
    [
        ("on = inf > 1", True), ("on = inf == inf", True), ("on = inf in [1, inf]", True), ("on = -inf < big", True),
        ("on = path_distance([], []) > 1e300", True), ("on = Point(inf, 0, 0) == Point(0, 0, 0)", False),
        ("on = Point(inf, 0, 0) in Ball(Point(0, 0, 0), 1)", False), ("on = min(inf, 1.0) == 1.0", True),
        ("on = sorted([inf, 1.0])[0] == 1.0", True), ("on = Point(-0.0, 0, 0) == Point(0, 0, 0)", True),
        ("on = True or nan > 1", True), ("on = nans[:1] == nans[:1]", None), ("on = [nans[0]] == [1.0]", None),
        ("f = nan\nf = inf\nf = 2\non = True", True), ("on = 1 / inf == 0", True),
    ],
)  # fmt: skip
def test_infinity_may_be_compared_and_what_is_not_compared_may_be_nan(effect: str, value: bool | None) -> None:
    meant, found = outcomes(effect)
    assert meant == found
    assert isinstance(meant, dict)
    assert meant["locals"]["on"] == ("bool", repr(True if value is None else value))


GROWING = """
local: float f = 1
Grow:
  pre: f - f == 0
  eff: f = f * 10
"""


def test_a_number_that_is_multiplied_every_round_never_becomes_infinite() -> None:
    program = compiled(GROWING)
    generated, meant = Generated(program, program_text(program)), Meant(program)
    state = initial(program, N_SYS)
    for _ in range(308):
        found = generated.event(state, 0)
        assert found == meant.event(state, 0) and isinstance(found[2], dict)
        state = round_(program, state)[0]
    assert generated.event(state, 0) == meant.event(state, 0) == ("Grow", None, "discarded")
    assert state.robots[0].locals["f"] == pytest.approx(1e308)


def test_what_is_not_there_is_not_cleared() -> None:
    assert outcomes("Map<int, List<int>> lists\nlists[7].clear()") == ("discarded", "discarded")
