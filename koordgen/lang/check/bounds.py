"""Indices and divisors: shown right for every robot of every fleet, shown wrong by an example, or left to run time."""

from __future__ import annotations

from koordgen.lang.analyze import linear
from koordgen.lang.analyze.decide import Example, find, relevant, unsat
from koordgen.lang.analyze.facts import Flow, excludes_zero, has_length, length, names_of, nonzero, term
from koordgen.lang.analyze.linear import N_SYS, PID, And, AtLeastZero, Fact, Formula, Linear
from koordgen.lang.analyze.number import number_of
from koordgen.lang.analyze.runs import sure
from koordgen.lang.check.context import Context, Site
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.decl import Param
from koordgen.lang.ir.types import FLOAT, INT
from koordgen.lang.node import replace
from koordgen.lang.source import Span

_PID, _SIZE, _ZERO = linear.variable(PID), linear.variable(N_SYS), linear.constant(0)
_LAST = linear.combine(_SIZE, linear.constant(-1))
_AT_RUN_TIME = "it is checked at run time: a robot for which it fails discards the event and holds"


def index_proved(index: ir.Expr, span: Span, c: Context) -> bool:
    """Whether 0 <= index < N_SYS here, always; a wrong or doubtful one is reported."""
    if type(index) is ir.Pid:
        return True
    if c.flow is None or c.poisoned:
        return False
    value = term(index, c.flow)
    if value is not None:
        sides = (linear.at_least(value, _SIZE), linear.less(value, _ZERO))
        bad = linear.Or(sides)
        if _holds_never(bad, c):
            return True
        if _right_by_default(bad, c):
            return False
        text = c.text(span)
        for side in sides:
            example, certain = _refuted(side, bad, (value,), c)
            if example is None:
                continue
            robot, shown = _who(side, value, example, c)
            such = _example(example, value)
            if certain:
                c.refuted.append(len(c.found))
                c.error("K030", f"{robot} reads {text}: index {shown} names no robot ({such})", span)
            else:
                c.warn("K031", f"{robot} may read {text}: index {shown} names no robot ({such})", span, _help(c))
            return False
        if _wrong_in_a_run(value, _SIZE, "N_SYS", "names no robot", span, c):
            return False
    open_ = _open_side(value, _SIZE, c.text(index.span), "N_SYS", c)
    check = f"'if {open_ or f'0 <= {c.text(index.span)} < N_SYS'}:' around it shows it"
    help = _help(c) if c.place in ("property", "assume") or len(check) > 80 else f"{_help(c)}; {check}"
    c.warn("K031", f"{c.text(span)} may name no robot{_untold(open_)}", span, help)
    return False


def _help(c: Context) -> str:
    return "let the formula say what robots it speaks of" if c.place in ("property", "assume") else _AT_RUN_TIME


def element_proved(operand: ir.Expr, index: ir.Expr, span: Span, c: Context) -> bool:
    """Whether 0 <= index < len(operand) here, always; a wrong or doubtful one is reported."""
    if c.flow is None or c.poisoned:
        return False
    value, size = term(index, c.flow), length(operand, c.flow)
    if value is not None and not value.terms and value.constant < 0:
        text = c.text(operand.span)
        help = f"{text}[len({text}) - {-value.constant}]" + (" is the last" if value.constant == -1 else "")
        c.error("K036", f"an index never counts from the end, as {c.text(index.span)} would", index.span, help)
        return False
    many, at = f"len({c.text(operand.span)})", c.text(index.span)
    if value is not None and size is not None:
        sides = (linear.at_least(value, size), linear.less(value, _ZERO))
        bad = linear.Or(sides)
        if _holds_never(bad, c):
            return True
        if _right_by_default(bad, c) or _element_refuted(sides, bad, value, size, span, c):
            return False
        if _wrong_in_a_run(value, size, many, "leaves its range", span, c):
            return False
    open_ = f"{many} > {at}" if isinstance(index, ir.Const) else _open_side(value, size, at, many, c)
    check = f"'if {open_ or f'0 <= {at} < {many}'}:' around it shows that it does not"
    help = f"{_help(c)}; {check}" if len(check) <= 90 else _help(c)
    c.warn("K034", f"{c.text(span)} may leave its range{_untold(open_)}", span, help)
    return False


def _open_side(value: Linear | None, size: Linear | None, index: str, many: str, c: Context) -> str:
    """What remains to be shown of an index where one side is shown already, in Koord's words."""
    if value is None or size is None:
        return ""
    above, below = _never(linear.less(value, _ZERO), c), _never(linear.at_least(value, size), c)
    return "" if above == below else f"{index} < {many}" if above else f"{index} >= 0"


def _untold(open_: str) -> str:
    return f": nothing says that {open_}" if 0 < len(open_) <= 60 else ""


def _wrong_in_a_run(value: Linear, size: Linear, many: str, wrong: str, span: Span, c: Context) -> bool:
    """Whether an index was reported that is sure to be wrong in the first or the last run of the loop around.
    `many`: the size in Koord's words."""
    runs = None if c.loop is None else sure(c.loop, span, (value, size))
    if c.loop is None or runs is None:
        return False
    here = c.path
    c.flow = runs.flow
    found = _wrong_run(runs.values, c.loop.temp, value, size, c)
    c.path = here
    if found is None:
        return False
    at, such = found
    c.refuted.append(len(c.found))
    message = f"for {c.loop.name} = {linear.show(at)}, {c.text(span)} {wrong}{such}"
    c.error("K030", message, span, f"the first index is 0, and the last is {many} - 1")
    return True


def _wrong_run(
    runs: tuple[Linear, ...], var: str, value: Linear, size: Linear, c: Context
) -> tuple[Linear, str] | None:
    """A value of `var`, of those in `runs`, with which an index is wrong for all robots, or else for an example."""
    bad = linear.Or((linear.at_least(value, size), linear.less(value, _ZERO)))
    for at in runs:
        now = linear.equal(linear.variable(var), at)
        if _never(And((now, linear.negate(bad))), c) and not _never(now, c):
            return at, ""
    assert c.flow is not None
    if not all(_is_given(name, c) for fact in c.flow.facts for name in linear.variables(fact)):
        return None  # no example is certain
    for at in runs:
        index, count = linear.substitute(value, var, at), linear.substitute(size, var, at)
        bad = linear.Or((linear.at_least(index, count), linear.less(index, _ZERO)))
        example, certain = (None, False) if _never(bad, c) else _refuted(bad, bad, (index, count), c)
        if example is not None and certain:
            return at, f" ({_example(example, linear.combine(index, count))})"
    return None


def _element_refuted(
    sides: tuple[Formula, Formula], bad: Formula, value: Linear, size: Linear, span: Span, c: Context
) -> bool:
    """Whether an index was reported with an example, or as one that leaves its range whatever is the case."""
    text = c.text(span)
    if _never(linear.negate(bad), c) and not _never(linear.TRUE, c):
        many = "" if size.terms else f": there are {size.constant} elements" if size.constant != 1 else ": there is one"
        c.error("K030", f"{text} leaves its range{many}", span)
        return True
    for side in sides:
        example, certain = _refuted(side, bad, (value, size), c)
        if example is None:
            continue
        robot, shown = _who(side, value, example, c)
        such = f"index {shown} of {linear.show(size)} elements ({_example(example, value)})"
        if certain:
            c.refuted.append(len(c.found))
            c.error("K030", f"{robot} reads {text}: {such}", span)
        else:
            c.warn("K034", f"{robot} may read {text}: {such}", span, _help(c))
        return True
    return False


def end_proved(end: ir.Expr, span: Span, c: Context) -> bool:
    """Whether an end of a slice, or a place to insert at, is 0 or more here, always; else it is reported."""
    if c.flow is None or c.poisoned:
        return False
    value = term(end, c.flow)
    if value is not None and not value.terms:
        if value.constant >= 0:
            return True
        help = f"write len(...) - {-value.constant}"
        c.error("K036", f"an index never counts from the end, as {c.text(end.span)} would", end.span, help)
        return False
    if value is not None and _holds_never(linear.less(value, _ZERO), c):
        return True
    text = c.text(end.span)
    help = f"{_help(c)}; 'if {text} >= 0:' around it shows that it is not"
    c.warn("K034", f"{c.text(span)}: {text} may be negative", end.span, help)
    return False


def holds_some(values: ir.Expr, c: Context) -> bool:
    """Whether something has an element here, always."""
    many = length(values, c.flow) if c.flow is not None and has_length(values.type) else None
    return many is not None and _never(linear.less(many, linear.constant(1)), c)


def exponent(node: ir.Expr, span: Span, c: Context) -> None:
    """Report an int to the power of a constant below zero, which is no int."""
    value = term(node, c.flow) if c.flow is not None else None
    if value is not None and not value.terms and value.constant < 0:
        help = "with a float on one side it is a float: 2.0 ** -1"
        c.error("K012", f"an int to the power of {value.constant} is no int", span, help)


def divisor_proved(divisor: ir.Expr, span: Span, c: Context) -> bool:
    """Whether a divisor differs from zero here, always; a wrong or doubtful one is reported."""
    if type(divisor) is ir.Widen and type(divisor.operand) is ir.Const:
        divisor = divisor.operand
    if type(divisor) is ir.Const and divisor.value:
        return True
    if c.flow is None or c.poisoned:
        return False
    bad = linear.negate(nonzero(divisor, c.flow))
    if _holds_never(bad, c):
        return True
    if _right_by_default(bad, c):
        return False
    text = c.text(divisor.span)
    value = term(divisor, c.flow)
    if value is not None:
        example, certain = _refuted(bad, bad, (value,), c)
        if example is not None and certain:
            c.refuted.append(len(c.found))
            if value.terms:
                robot, _ = _who(bad, value, example, c)
                message = f"{robot} divides by {text}, which is 0 ({_example(example, value)})"
                help = f"leave those robots out with 'if {text} != 0:' around it, or divide by another number"
            else:
                message = "this divides by 0" if text == "0" else f"this divides by {text}, which is 0"
                help = "a division by 0 has no value: divide by another number"
            c.error("K032", message, span, help)
            return False
    c.warn("K033", f"{text} may be zero", divisor.span, f"{_help(c)}; 'if {text} != 0:' around it shows that it is not")
    return False


def _right_by_default(bad: Formula, c: Context) -> bool:
    """Whether nothing is wrong as long as the params have the values that the program gives them; a fleet file may give
    others, so it is still checked at run time."""
    assert c.flow is not None
    names = names_of(bad)
    facts = c.flow.relevant(names)
    names = names.union(*map(names_of, facts))
    given = [d for name in names if name.startswith("param ") for d in _default(name[6:], c)]
    return bool(given) and unsat((*facts, bad, *given))


def _default(name: str, c: Context) -> list[Formula]:
    """What a param's default tells of it."""
    entity = c.entities.get(name)
    if not isinstance(entity, Param):
        return []
    read = ir.ParamRead(name, entity.type, entity.span)
    if entity.type is INT:
        value, var = term(entity.default, Flow()), linear.variable(f"param {name}")
        return [] if value is None else [linear.equal(var, value)]
    if entity.type is FLOAT:
        number = number_of(entity.default)
        if number is None:
            return []
        told: list[Formula] = [Fact((op, read), excludes_zero(op, number)) for op in ("!=", ">", ">=", "<", "<=")]
        return [*told, Fact(read, number != 0)]
    if has_length(entity.type):
        many = length(entity.default, Flow())
        return [] if many is None else [linear.equal(linear.variable(linear.Length(f"param {name}")), many)]
    return []


def is_own(index: ir.Expr, c: Context) -> bool:
    """Whether an index is `pid` here, always."""
    if type(index) is ir.Pid or c.flow is None or c.poisoned:
        return True
    value = term(index, c.flow)
    return value is not None and _never(linear.negate(linear.equal(value, _PID)), c)


def judge_update(name: str, reads: bool, span: Span, c: Context) -> None:
    """Report a write to an allwrite variable of what was made from its old value, unless nothing can be lost: under
    `atomic`, or where one robot alone can be. `reads`: the old value is part of this very statement."""
    if c.place == "init":
        if reads and name not in c.written_shared:
            help = "build it in a variable of the block, and assign that"
            c.error("K023", f"init cannot change {name}, only set it: it is shared", span, help)
        return
    if reads:
        c.read_shared.add(name)
    if name in c.read_shared and not c.transaction and not c.poisoned:
        from koordgen.lang.check.locks import only_one_robot

        if not only_one_robot(c):
            help = "another robot may write it in the same round, and one update is lost; under 'atomic:' none is"
            c.warn("K040", f"this event reads {name} and writes it: an update may be lost", span, help)
            c.read_shared.discard(name)
    c.written_shared.add(name)


def impossible(condition: Formula, before: Flow) -> bool:
    """Whether a condition contradicts what is known."""
    if condition is linear.UNKNOWN:
        return False
    names = names_of(condition)
    facts = before.relevant(names)
    if not facts and PID not in names and N_SYS not in names:
        # Nothing is known of these: only what contradicts itself is impossible, and one comparison does not.
        match condition:
            case Fact():
                return False
            case AtLeastZero(value) if value.terms:
                return False
            case And((AtLeastZero(first), AtLeastZero(second))) if (
                len(first.terms) == 1 and first.constant == -second.constant
            ):
                return False
    return unsat((*facts, condition))


def _one_value(first: Linear, second: Linear) -> bool:
    """Whether two bounds are those of `variable == constant`."""
    return len(first.terms) == 1 and abs(first.terms[0][1]) == 1 and second == linear.scale(first, -1)


def help_by_negation(written: Span, c: Context) -> None:
    """Where the opposite of the guard (`written` there) would make every index and divisor right, says so."""
    if not c.refuted or c.guard is None:
        return
    opposite = linear.negate(c.guard.formula)
    if unsat((opposite,)):
        return
    if all(unsat((*relevant((opposite, *site.facts), site.bad), site.bad)) for site in c.sites):
        text = c.text(written)
        text = text if text.startswith("(") and text.endswith(")") else f"({text})"
        for position in c.refuted:
            help = f"with `pre: not {text}` every index and divisor of this event would be right"
            c.found[position] = replace(c.found[position], help=help)


def _holds_never(bad: Formula, c: Context) -> bool:
    assert c.flow is not None
    if c.place == "effect":
        guard = None if c.guard is None else c.guard.formula
        c.sites.append(Site(tuple([k.formula for k in c.flow.known if k.origin is not guard]), bad))
    return _never(bad, c)


def _never(condition: Formula, c: Context) -> bool:
    """Whether a condition cannot hold here."""
    assert c.flow is not None
    return unsat((*c.flow.relevant(names_of(condition)), condition))


def _refuted(side: Formula, bad: Formula, values: tuple[Linear, ...], c: Context) -> tuple[Example | None, bool]:
    """An example of a robot for which `side` holds, and whether that is certain: no matter what else is the case,
    or because `bad` holds whenever one gets here."""
    assert c.flow is not None
    names = [var for value in values for var in linear.variables(value)]
    if not all(_is_given(name, c) for name in names):
        return None, False
    example = find((*c.flow.facts, side), c.defaults)
    if example is None:
        return None, False
    return example, example.certain or _never(linear.negate(bad), c)


def _is_given(name: object, c: Context) -> bool:
    """Whether an example gives a variable a value."""
    return isinstance(name, str) and (name in (PID, N_SYS) or name in c.defaults)


def _who(side: Formula, value: Linear, example: Example, c: Context) -> tuple[str, str]:
    """The robots for which it goes wrong, and the index in their terms: ("robot N_SYS - 1", "N_SYS")."""
    assert c.flow is not None
    here = linear.constant(example.values[PID])
    for robot in (_LAST, here):
        if _never(And((side, linear.negate(linear.equal(_PID, robot)))), c):
            return f"robot {linear.show(robot)}", _index(linear.substitute(value, PID, robot), value, example)
    return "a robot", _index(value, value, example)


def _index(shown: Linear, value: Linear, example: Example) -> str:
    if all(isinstance(var, str) for var, _ in shown.terms):
        return linear.show(shown)
    return str(linear.value_of(value, example.values))


def _example(example: Example, value: Linear) -> str:
    others = [n for n in dict.fromkeys(linear.variables(value)) if isinstance(n, str) and n not in (PID, N_SYS)]
    given = "".join(f", {n.rpartition(' ')[2]} = {example.values[n]}" for n in others)
    return f"for example pid = {example.values[PID]} of N_SYS = {example.values[N_SYS]}{given}"
