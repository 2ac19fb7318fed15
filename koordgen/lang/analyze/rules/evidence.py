"""Evidence about an index or a divisor (K030): proofs that it is right, examples where it is wrong."""

from __future__ import annotations

from koordgen.lang.analyze.facts import linear
from koordgen.lang.analyze.facts.decide import Example, find, unsat
from koordgen.lang.analyze.facts.linear import N_SYS, PID, And, BoolFact, Formula, Linear
from koordgen.lang.analyze.facts.number import number_of
from koordgen.lang.analyze.facts.runs import certain_iterations
from koordgen.lang.analyze.facts.terms import Flow, excludes_zero, has_length, length, names_of, term
from koordgen.lang.analyze.rules.analysis import Analysis, Site
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.types import FLOAT, INT
from koordgen.lang.source import Span

_PID, _SIZE, ZERO = linear.variable(PID), linear.variable(N_SYS), linear.constant(0)
_LAST = linear.combine(_SIZE, linear.constant(-1))
_CHECKED_AT_RUN_TIME = (
    "robots check this at run time: a robot whose check fails discards the event and holds its position"
)


def help_at_run_time(a: Analysis) -> str:
    """Return the help for an index or a divisor that may be wrong."""
    return (
        "restrict the formula to robots of the fleet"
        if a.place in ("property", "assume", "guarantee", "provided")
        else _CHECKED_AT_RUN_TIME
    )


def unproved_side(value: Linear | None, size: Linear | None, index: str, many: str, a: Analysis) -> str:
    """Return the unproved bound of an index, as Koord writes it, if the other bound is proved.

    Returns an empty string otherwise.
    """
    if value is None or size is None:
        return ""
    above, below = is_impossible(linear.less(value, ZERO), a), is_impossible(linear.at_least(value, size), a)
    return "" if above == below else f"{index} < {many}" if above else f"{index} >= 0"


def missing_condition(open_: str) -> str:
    """Return the end of a message, which names the unproved condition; empty if the condition is long."""
    return f": nothing shows that {open_}" if 0 < len(open_) <= 60 else ""


def is_right_by_default(bad: Formula, a: Analysis) -> bool:
    """Return whether the error condition `bad` cannot hold if all params have their default values.

    In this case the rules report nothing. A fleet file may give params other values, so the condition is still checked
    at run time.
    """
    assert a.flow is not None
    names = names_of(bad)
    facts = a.flow.relevant(names)
    names = names.union(*map(names_of, facts))
    given = [d for name in names if name.startswith("param ") for d in _default(name[6:], a)]
    return bool(given) and unsat((*facts, bad, *given))


def _default(name: str, a: Analysis) -> list[Formula]:
    """Return the facts that hold if a param has its default value."""
    param = a.params.get(name)
    if param is None:
        return []
    read = ir.ParamRead(name, param.type, param.span)
    if param.type is INT:
        value, var = term(param.default, Flow()), linear.variable(f"param {name}")
        return [] if value is None else [linear.equal(var, value)]
    if param.type is FLOAT:
        number = number_of(param.default)
        if number is None:
            return []
        facts: list[Formula] = [BoolFact((op, read), excludes_zero(op, number)) for op in ("!=", ">", ">=", "<", "<=")]
        return [*facts, BoolFact(read, number != 0)]
    if has_length(param.type):
        many = length(param.default, Flow())
        return [] if many is None else [linear.equal(linear.variable(linear.Length(f"param {name}")), many)]
    return []


def is_refuted(bad: Formula, a: Analysis) -> bool:
    """Return whether `bad`, which makes an index or a divisor wrong, cannot hold at the current point.

    In an effect, `bad` is also saved in `a.sites`, for the rule `opposite_guard`.
    """
    assert a.flow is not None
    if a.place == "effect":
        guard = None if a.guard is None else a.guard.formula
        a.sites.append(Site(tuple([k.formula for k in a.flow.known if k.origin is not guard]), bad))
    return is_impossible(bad, a)


def is_impossible(condition: Formula, a: Analysis) -> bool:
    """Return whether a condition cannot hold at the current point."""
    assert a.flow is not None
    return unsat((*a.flow.relevant(names_of(condition)), condition))


def counterexample(side: Formula, bad: Formula, values: tuple[Linear, ...], a: Analysis) -> tuple[Example | None, bool]:
    """Return an example of a robot for which `side` holds, or None, and whether the error is certain.

    The error is certain if the example depends on no unknown value, or if `bad` holds whenever this point is reached.
    """
    assert a.flow is not None
    names = [var for value in values for var in linear.variables(value)]
    if not all(_is_given(name, a) for name in names):
        return None, False
    example = find((*a.flow.facts, side), a.defaults)
    if example is None:
        return None, False
    return example, example.certain or is_impossible(linear.negate(bad), a)


def _is_given(name: object, a: Analysis) -> bool:
    """Return whether examples choose the value of a variable freely: of `pid`, `N_SYS` or a param in `a.defaults`."""
    return isinstance(name, str) and (name in (PID, N_SYS) or name in a.defaults)


def robots_of(side: Formula, value: Linear, example: Example, a: Analysis) -> tuple[str, str]:
    """Return the texts of the robots for which a value is wrong, and of the value: ("robot N_SYS - 1", "N_SYS")."""
    assert a.flow is not None
    here = linear.constant(example.values[PID])
    for robot in (_LAST, here):
        if is_impossible(And((side, linear.negate(linear.equal(_PID, robot)))), a):
            return f"robot {linear.show(robot)}", _index(linear.substitute(value, PID, robot), value, example)
    return "a robot", _index(value, value, example)


def _index(shown: Linear, value: Linear, example: Example) -> str:
    if all(isinstance(var, str) for var, _ in shown.terms):
        return linear.show(shown)
    return str(linear.value_of(value, example.values))


def example_text(example: Example, value: Linear) -> str:
    """Return an example as text: "for example pid = 0 of N_SYS = 3"."""
    others = [n for n in dict.fromkeys(linear.variables(value)) if isinstance(n, str) and n not in (PID, N_SYS)]
    given = "".join(f", {n.rpartition(' ')[2]} = {example.values[n]}" for n in others)
    return f"for example pid = {example.values[PID]} of N_SYS = {example.values[N_SYS]}{given}"


def is_wrong_in_a_run(value: Linear, size: Linear, many: str, wrong: str, span: Span, a: Analysis) -> bool:
    """Report an index that is certainly wrong in the first or last iteration of the innermost loop.

    Returns whether an error was reported. `many` is the number of elements, as an expression of Koord.
    """
    runs = None if a.loop is None else certain_iterations(a.loop, span, (value, size))
    if a.loop is None or runs is None:
        return False
    here = a.path
    a.flow = runs.flow
    found = _wrong_run(runs.values, a.loop.temp, value, size, a)
    a.path = here
    if found is None:
        return False
    at, example = found
    message = f"for {a.loop.name} = {linear.show(at)}, {a.text(span)} {wrong}{example}"
    a.site_error("K030", message, span, f"the first index is 0, and the last is {many} - 1")
    return True


def _wrong_run(
    runs: tuple[Linear, ...], var: str, value: Linear, size: Linear, a: Analysis
) -> tuple[Linear, str] | None:
    """Return a value of the loop's variable `var` that makes an index wrong, with the text of an example.

    `runs` has the values to try. A value for which the index is wrong for all robots is preferred; the text is then
    empty. Returns None if the index is not certainly wrong for any of the values.
    """
    bad = linear.Or((linear.at_least(value, size), linear.less(value, ZERO)))
    for at in runs:
        now = linear.equal(linear.variable(var), at)
        if is_impossible(And((now, linear.negate(bad))), a) and not is_impossible(now, a):
            return at, ""
    assert a.flow is not None
    if not all(_is_given(name, a) for fact in a.flow.facts for name in linear.variables(fact)):
        return None  # an example would not be certain
    for at in runs:
        index, count = linear.substitute(value, var, at), linear.substitute(size, var, at)
        bad = linear.Or((linear.at_least(index, count), linear.less(index, ZERO)))
        example, certain = (None, False) if is_impossible(bad, a) else counterexample(bad, bad, (index, count), a)
        if example is not None and certain:
            return at, f" ({example_text(example, linear.combine(index, count))})"
    return None
