"""K040: an event that reads and writes an allwrite variable may lose another robot's update."""

from __future__ import annotations

from typing import assert_never

from koordgen.lang.analyze.facts import linear
from koordgen.lang.analyze.facts.decide import unsat
from koordgen.lang.analyze.rules.analysis import Analysis
from koordgen.lang.source import Span


def check_write(name: str, span: Span, a: Analysis) -> None:
    """Report a write to an allwrite variable that the event has read before.

    No update can be lost under `atomic`, or if only one robot can reach this point in a round.
    """
    if a.place == "init":
        return  # init cannot read shared variables
    if name in a.read_shared and not a.transaction and not a.poisoned and not _only_one_robot(a):
        help = (
            f"another robot may write {name} in the same round, and one update is lost; "
            "under 'atomic:' no update is lost"
        )
        a.warn("K040", f"this event reads {name} and writes it: an update may be lost", span, help)
        a.read_shared.discard(name)
    a.written_shared.add(name)


_OTHER = "other pid"


def _only_one_robot(a: Analysis) -> bool:
    """Return whether two robots can never reach this point in the same round.

    The proof: the guard, or the facts at this point, cannot hold for two robots with different pids. Such robots have
    their own local variables and ports, but the same params and shared variables.
    """
    if a.flow is None:
        return True
    # Within a round, each robot sees its own writes to shared variables, so two robots may see different values.
    own = {f"shared {name}" for name in a.written_shared}
    here = [fact for fact in a.flow.facts if own.isdisjoint(linear.variables(fact))]
    return _contradictory(here) or (a.guard is not None and _contradictory([a.guard.formula]))


def _contradictory(facts: list[linear.Formula]) -> bool:
    """Return whether the facts cannot hold for two different robots at the same time."""
    pid, another, size = linear.variable(linear.PID), linear.variable(_OTHER), linear.variable(linear.N_SYS)
    return unsat((*facts, *map(_renamed, facts), linear.less(pid, another), linear.less(another, size)))


def _renamed(item: linear.Formula) -> linear.Formula:
    """Return a condition with another robot's variables in place of the variables of this robot."""
    match item:
        case linear.AtLeastZero(term):
            return linear.AtLeastZero(_term(term))
        case linear.BoolFact(key, holds):
            return linear.BoolFact(_key(key), holds)
        case linear.And(parts):
            return linear.And(tuple([_renamed(part) for part in parts]))
        case linear.Or(parts):
            return linear.Or(tuple([_renamed(part) for part in parts]))
        case linear.UnknownCondition():
            return item
        case _:
            assert_never(item)


def _is_common(name: str) -> bool:
    return name.startswith(("param ", "shared "))


def _key(key: object) -> object:
    return key if isinstance(key, str) and _is_common(key) else (_OTHER, key)


def _term(term: linear.Linear) -> linear.Linear:
    return linear.Linear(tuple([(_variable(var), factor) for var, factor in term.terms]), term.constant)


def _variable(var: linear.Var) -> linear.Var:
    match var:
        case str():
            return var if var == linear.N_SYS or _is_common(var) else f"other {var}"
        case linear.Quotient(operand, divisor):
            return linear.Quotient(_term(operand), divisor)
        case linear.Remainder(operand, divisor):
            return linear.Remainder(_term(operand), _term(divisor))
        case linear.ConditionalTerm(condition, then, orelse):
            return linear.ConditionalTerm(_renamed(condition), _term(then), _term(orelse))
        case linear.Length(of):
            return linear.Length(_key(of))
        case linear.Value(of):
            return linear.Value(_key(of))
        case _:
            assert_never(var)
