"""A generator of obligations that is wrong in one place tells something wrong of a small program: fifty such."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from koordgen.diagnostics import InternalError
from koordgen.prove import begin, generate, goal, moment
from koordgen.prove import term as t
from koordgen.prove.encode import builtins, expr, fold, geometry, lists, quantifier, room, state, stmt, values
from koordgen.prove.encode.function import Functions
from koordgen.prove.solve import Limits, Solver
from tests.prove.battery import BATTERY
from tests.prove.told import checked, told

Mutant = tuple[object, str, Callable[[Any], Any]]


def constant(value: object) -> Callable[[Any], Any]:
    return lambda real: lambda *args, **named: value


def swapped(*order: int) -> Callable[[Any], Any]:
    """The same function, its arguments in another order."""
    return lambda real: lambda *args: real(*[args[place] for place in order])


def without_calls(real: Any) -> Any:
    return lambda *args, **named: None


def first_only(real: Any) -> Any:
    return lambda *args: real(*args)[:1]


def other(result: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """The same function, its result changed."""
    return lambda real: lambda *args, **named: result(real(*args, **named))


def unmoved(real: Any) -> Any:
    return lambda self, key, robot: self.before.of(key, robot)


class OneMoves(state.Moved):
    """After a step of the environment in which one robot moved."""

    def of(self, key: Any, robot: Any) -> Any:
        one = t.constant("mover", t.INT)
        return values.pick(t.equals(robot, one), super().of(key, robot), self.before.of(key, robot))


def only_one_moves(real: Any) -> Any:
    def init(self: Any, stage: Any, property_: Any, moment: Any) -> None:
        moved = isinstance(moment, state.Moved)
        real(self, stage, property_, OneMoves(moment.before, moment.after, moment.moved) if moved else moment)

    return init


def everyone_writes(real: Any) -> Any:
    return lambda self, key, robot: self.writes.get(key, self.before.of(key, robot))


def two_of(real: Any) -> Any:
    """The acting robot only, never another."""
    return lambda self, chosen, more: iter([next(real(self, chosen, more))])


def no_lock(real: Any) -> Any:
    """Transactions read the round's start, too."""

    def of_event(setting: Any, event: Any) -> Any:
        from koordgen.node import replace

        return real(setting, replace(event, lock=None))

    return of_event


def all_locked(real: Any) -> Any:
    def of_event(setting: Any, event: Any) -> Any:
        from koordgen.node import replace

        return real(setting, replace(event, lock=0))

    return of_event


def assumed_goals(real: Any) -> Any:
    """What is to be shown is among the facts."""

    def one(self: Any, name: Any, invariant: Any, kind: Any, assumed: Any, conjuncts: Any) -> Any:
        return real(self, name, invariant, kind, assumed + conjuncts, conjuncts)

    return one


def no_steps(real: Any) -> Any:
    return lambda stage, cuts: []


def unchanged_by_loops(real: Any) -> Any:
    return lambda block, temps: {}


def one_robot_fewer(real: Any) -> Any:
    return lambda self, index: t.and_(t.at_most(t.integer(0), index), t.less(t.add(index, t.integer(1)), self.size))


def written_by_first(real: Any) -> Any:
    def cell(self: Any, key: Any, before: Any) -> Any:
        run = self.run(t.integer(0))
        return values.pick(run.counts, run.env.get(key, before), before)

    return cell


def nothing_demanded(real: Any) -> Any:
    return lambda self, formula, label, line: None


MUTANTS: dict[str, Mutant] = {
    "what is written is lost": (state.Written, "of", unmoved),
    "the frame is dropped: all robots write": (state.Written, "of", everyone_writes),
    "plain events read what others wrote in the round": (generate, "of_event", all_locked),
    "transactions read the round's start": (generate, "of_event", no_lock),
    "the environment does not move": (state.Moved, "of", unmoved),
    "the environment moves one robot": (goal._Goals, "__init__", only_one_moves),
    "no port assumption": (moment.Stage, "ports", without_calls),
    "primes are swapped": (moment.Stage, "ports", swapped(0, 2, 1)),
    "no invariant is known before": (moment.Stage, "holds", without_calls),
    "no axiom": (moment.Stage, "axioms", without_calls),
    "a planner answers anything": (moment.Stage, "answered", without_calls),
    "less means at most": (t, "less", lambda real: t.at_most),
    "at most means less": (t, "at_most", lambda real: t.less),
    "one robot fewer": (room.Room, "within", one_robot_fewer),
    "any int names a robot": (room.Room, "within", constant(t.TRUE)),
    "nothing is demanded": (room.Room, "demand", nothing_demanded),
    "no instance": (room.Room, "instantiate", without_calls),
    "every robot is the acting one": (room.Room, "same", constant(t.TRUE)),
    "no robot is the acting one": (room.Room, "same", constant(t.FALSE)),
    "what is learned is the contrary": (room.Room, "learn", lambda real: lambda self, g: real(self, t.not_(g))),
    "one part of the goal": (generate, "goal", first_only),
    "the acting robot only": (goal._Goals, "robots", two_of),
    "bystanders are never looked at": (goal, "_names_robots", constant(True)),
    "the goal is assumed": (generate._Output, "one", assumed_goals),
    "a loop's runs need not keep anything": (generate, "_at_cuts", no_steps),
    "a loop leaves nothing behind": (stmt, "kept_by", unchanged_by_loops),
    "ways are merged to the first": (stmt.Frame, "merged", lambda real: lambda self, c, a, b: real(self, t.TRUE, a, b)),
    "the ways are swapped": (stmt.Frame, "merged", swapped(0, 1, 3, 2)),
    "what is chosen is the other": (state, "pick", swapped(0, 2, 1)),
    "a list picks the other": (lists, "pick", swapped(0, 2, 1)),
    "reached stays": (begin, "ended", lambda real: lambda program, writes, *_: dict(writes)),
    "reached after an event": (generate, "ended", lambda real: lambda program, writes, *_: {
        k: v for k, v in writes.items() if k[0] != "wrote"}),
    "init is not run": (begin.Ready, "of", lambda real: lambda self, key, robot: self.launch.of(key, robot)),
    "the lowest pid writes": (begin, "written", constant({})),
    "robot 0 alone writes in init": (begin.Ready, "_cell", written_by_first),
    "nothing holds initially": (generate, "launched", without_calls),
    "bools begin with true": (begin, "default", lambda real: lambda type_, records: t.TRUE),
    "a list does not grow": (lists, "_STEPS", lambda real: {**real, "appended": 0}),
    "a list shrinks by two": (lists, "_STEPS", lambda real: {**real, "popped": -2}),
    "points are equal": (lists.Lists, "same", lambda real: lambda self, a, b:
                         t.TRUE if isinstance(a, tuple) else real(self, a, b)),
    "nobody is in a fleet": (expr, "in_fleet", constant(t.FALSE)),
    "no witness": (quantifier, "proxy", constant(t.TRUE)),
    "sums are zero": (builtins, "folded", constant(t.integer(0))),
    "sums have no bounds": (fold, "_bounded", without_calls),
    "no lemma about paths": (geometry.Geometry, "lemmas", without_calls),
    "paths are points": (geometry.Geometry, "path_distance", constant(t.real(0))),
    "a box is its first half": (expr, "_between", lambda real: lambda x, a, b:
                                t.and_(t.at_most(a, x), t.at_most(x, b))),
    "nothing is ensured": (room.Room, "given", without_calls),
    "others do nothing in a round": (generate, "changes", without_calls),
    "contracts are not looked at": (Functions, "extern", lambda real: lambda self, f, args, node:
                                    self.opaque(f.name, args, node)),
    "remainders are the dividend": (t, "remainder", lambda real: lambda a, b: a),
    "quotients are truncated": (t, "floor_divide", lambda real: lambda a, b: t.integer(-3)),
    "halves are whole": (expr, "_number", lambda real: lambda op, a, b: a if op == "/" else real(op, a, b)),
    "what is assumed is never looked at": (generate, "consistent", constant([])),
}  # fmt: skip
FEW = list(MUTANTS)[::6]


@pytest.fixture(scope="module")
def solver() -> Iterator[Solver]:
    with Solver("z3", Limits(query=1.0, total=100_000.0)) as running:
        yield running


def noticed(solver: Solver) -> bool:
    """Whether some program of the battery is judged otherwise than it should be."""
    for text, wanted in BATTERY.values():
        try:
            if told(checked(text), solver) != wanted:
                return True
        except (AssertionError, InternalError, KeyError, TypeError, AttributeError, RecursionError):
            return True
    return False


def check(name: str, monkeypatch: pytest.MonkeyPatch, solver: Solver) -> None:
    where, attribute, mutate = MUTANTS[name]
    monkeypatch.setattr(where, attribute, mutate(getattr(where, attribute)))
    assert noticed(solver), name


@pytest.mark.parametrize("name", FEW)
def test_a_wrong_generator_is_noticed(name: str, monkeypatch: pytest.MonkeyPatch, solver: Solver) -> None:
    check(name, monkeypatch, solver)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in MUTANTS if name not in FEW])
def test_every_wrong_generator_is_noticed(name: str, monkeypatch: pytest.MonkeyPatch, solver: Solver) -> None:
    check(name, monkeypatch, solver)
