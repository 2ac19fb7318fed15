"""Facts known at a program point: conditions passed on the path to it, and values of variables.

A Flow is immutable: each branch derives its own Flow from its parent's.
"""

from __future__ import annotations

from collections.abc import Iterable

from koordgen.lang.analyze.facts import linear
from koordgen.lang.analyze.facts.linear import (
    UNKNOWN,
    And,
    AtLeastZero,
    BoolFact,
    Formula,
    Length,
    Linear,
    Or,
    Remainder,
    Var,
)
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir import stmt
from koordgen.lang.ir.tree import walk
from koordgen.lang.node import Node

# It is always sound to forget a fact. These limits keep the time for each line constant, however long an event is.
MOST_FACTS = 12
MOST_VALUES = 20

_Names = frozenset[str]
_Valued = tuple[Linear | Formula, _Names]
_NONE: _Names = frozenset()
_FLEET: _Names = frozenset((linear.PID, linear.N_SYS))


class KnownCondition(Node):
    """Condition that is known to hold.

    `about` is the set of the variables that the condition depends on. `origin` is the condition in the program from
    which this condition was derived.
    """

    formula: Formula
    about: frozenset[str]
    origin: Formula


class Flow(Node):
    """Facts known at a point of the program. Immutable.

    `known` lists the conditions that hold, the event's guard first. `values` maps a variable to its value, if that is
    known as a term or a condition, and to the set of the variables that the value depends on. Its keys are names as
    `variable_of` returns them; with the prefix `len ` a key stands for the variable's length. `about` is a superset of
    all variables that the facts depend on.
    """

    known: tuple[KnownCondition, ...] = ()
    values: dict[str, tuple[Linear | Formula, frozenset[str]]] = {}  # noqa: RUF012 - never changed
    about: frozenset[str] = frozenset()

    @property
    def facts(self) -> tuple[Formula, ...]:
        return tuple([known.formula for known in self.known])

    def value(self, name: str) -> Linear | Formula | None:
        found = self.values.get(name)
        return None if found is None else found[0]

    def relevant(self, names: frozenset[str]) -> list[Formula]:
        """Return the facts that are connected to `names` by common variables.

        Other facts cannot help to refute a condition about these names, unless they contradict each other. pid and
        N_SYS are always connected, by the facts about every fleet.
        """
        if not names.isdisjoint(_FLEET):
            names |= _FLEET
        if names.isdisjoint(self.about):
            return []
        left = list(self.known)
        kept: list[Formula] = []
        grown = True
        while grown:
            grown = False
            for known in list(left):
                if not names.isdisjoint(known.about):
                    left.remove(known)
                    kept.append(known.formula)
                    names |= known.about if known.about.isdisjoint(_FLEET) else known.about | _FLEET
                    grown = True
        return kept

    def assuming(self, condition: Formula, about: frozenset[str] | None = None) -> Flow:
        """Return these facts and one more condition. `about` is the set of the condition's variables, if known."""
        if condition is UNKNOWN or (type(condition) is And and not condition.parts):
            return self
        if about is None:
            about = names_of(condition)
        known = self.known if len(self.known) < MOST_FACTS else (self.known[0], *self.known[2:])
        return Flow((*known, KnownCondition(condition, about, condition)), self.values, self.about | about)

    def forgetting(self, names: frozenset[str], sized: frozenset[str] = frozenset()) -> Flow:
        """Return these facts without those that depend on the variables `names`.

        Facts that depend only on the lengths of the variables in `sized` are kept.
        """
        if names.isdisjoint(self.about):
            return self
        known = [rest for k in self.known for rest in _remaining(k, names)]
        known += [k for k in self.known if not k.about.isdisjoint(sized) and independent(k.formula, names, sized)]
        values = {}
        for name, value in self.values.items():
            if _owner(name) in names and not (name.startswith("len ") and _owner(name) in sized):
                continue
            if value[1].isdisjoint(names):
                values[name] = value
            else:
                known.extend(_range_of(name, value[0], names))
        return Flow(tuple(known[:MOST_FACTS]), values, self.about)

    def assigned(self, name: str, value: Linear | Formula | None, length: bool = False) -> Flow:
        """Return the facts after an assignment.

        `value` is the new value or the new length; None if it is unknown.

        Facts about the old value are dropped. An assignment such as `n = n + 1` rewrites such facts for the new value.
        """
        if value is None:
            return self.forgetting(frozenset((name,)))
        about = names_of(value)
        if name in about:
            return self._moved(name, value, Length(name) if length else name)
        flow = self.forgetting(frozenset((name,)))
        values = dict(flow.values)
        if len(values) >= MOST_VALUES:
            del values[next(iter(values))]
        values[f"len {name}" if length else name] = (value, about)
        return Flow(flow.known, values, flow.about | about | {name})

    def _moved(self, name: str, value: Linear | Formula, var: Var) -> Flow:
        if not isinstance(value, Linear) or value.terms != ((var, 1),):
            return self.forgetting(frozenset((name,)))
        by = value.constant
        known: list[KnownCondition] = []
        for item in self.known:
            if name not in item.about:
                known.append(item)
                continue
            for part in item.formula.parts if isinstance(item.formula, And) else (item.formula,):
                if _occurs_only_as(var, name, part):
                    moved = linear.shifted(part, var, by)
                    known.append(KnownCondition(moved, names_of(moved), item.origin))
        values = {n: v for n, v in self.values.items() if _owner(n) != name and name not in v[1]}
        flow = Flow(tuple(known[:MOST_FACTS]), values, self.about)
        longer = isinstance(var, Length) and by > 0
        return flow.assuming(AtLeastZero(Linear(((var, 1),), -by))) if longer else flow

    def joined(self, other: Flow) -> Flow:
        """Return the facts after two paths meet: the facts that are known at the ends of both paths."""
        if self is other:
            return self
        same = {id(known) for known in other.known}
        formulas = [known.formula for known in other.known]
        known = tuple([k for k in self.known if id(k) in same or k.formula in formulas])
        values = {n: v for n, v in self.values.items() if n in other.values and _same_value(v, other.values[n])}
        return Flow(known, values, self.about)


def _range_of(name: str, value: Linear | Formula, names: _Names) -> list[KnownCondition]:
    """Return the range of a variable whose value is a remainder: a fact that stays true when the dividend changes."""
    match value:
        case Linear(((Remainder(_, divisor), 1),), 0) if not name.startswith("len "):
            term = linear.variable(name)
            range_ = And((linear.at_least(term, linear.constant(0)), linear.less(term, divisor)))
            fact = Or((linear.less(divisor, linear.constant(1)), range_))
            about = names_of(fact)
            return [KnownCondition(fact, about, fact)] if about.isdisjoint(names) else []
        case _:
            return []


def _same_value(first: _Valued, second: _Valued) -> bool:
    return first is second or first[0] == second[0]


def _owner(name: str) -> str:
    """Return the variable to which a key of `values` belongs; the key may stand for the variable's length."""
    return name.removeprefix("len ")


def _remaining(known: KnownCondition, names: _Names) -> tuple[KnownCondition, ...]:
    """Return the part of a fact that stays true when some variables change.

    The parts of a conjunction that depend on these variables are removed.
    """
    if known.about.isdisjoint(names):
        return (known,)
    if not isinstance(known.formula, And):
        return ()
    parts = [(part, names_of(part)) for part in known.formula.parts]
    left = [(part, about) for part, about in parts if about.isdisjoint(names)]
    if not left:
        return ()
    about = _NONE.union(*(a for _, a in left))
    return (KnownCondition(And(tuple([part for part, _ in left])), about, known.origin),)


def independent(item: Linear | Formula, names: _Names, sized: _Names) -> bool:
    """Return whether a term or formula keeps its value when the variables `names` change.

    The lengths of the variables in `sized` do not change.
    """
    formula = AtLeastZero(item) if isinstance(item, Linear) else item
    return all(n in sized and _occurs_only_as(Length(n), n, formula) for n in names_of(item) & names)


def _occurs_only_as(var: Var, name: str, formula: Formula) -> bool:
    """Return whether a formula depends on the variable `name` only through the term `var`."""
    match formula:
        case AtLeastZero(term):
            return all(other == var or name not in names_of_var(other) for other, _ in term.terms)
        case And(parts) | Or(parts):
            return all(_occurs_only_as(var, name, part) for part in parts)
        case _:
            return name not in names_of(formula)


def variable_of(node: object) -> str | None:
    """Return a variable's name in a Flow: "local count", "port Motion.position"."""
    match node:
        case ir.LocalRead(name) | stmt.LocalPlace(name):
            return f"local {name}"
        case ir.TempRead(name) | stmt.TempPlace(name):
            return f"temp {name}"
        case ir.SharedRead(name) | stmt.SharedPlace(name):
            return f"shared {name}"
        case ir.SlotRead(name) | ir.SlotsRead(name) | stmt.OwnSlot(name):
            return f"slot {name}"
        case ir.PortRead(module, port) | stmt.PortPlace(module, port):
            return f"port {module}.{port}"
        case ir.ParamRead(name):
            return f"param {name}"
        case _:
            return None


def names_of(item: Linear | Formula) -> frozenset[str]:
    """Return all variables that a term or a formula depends on."""
    found: set[str] = set()
    _collect(item, found)
    return frozenset(found)


def _collect(item: Linear | Formula, found: set[str]) -> None:
    kind = type(item)
    if kind is AtLeastZero:
        item, kind = item.linear, Linear  # type: ignore[union-attr]
    if kind is Linear:
        for var, _ in item.terms:  # type: ignore[union-attr]
            if type(var) is str:
                found.add(var)
            else:
                _add_keys(linear.variables(var), found)
    elif kind is And or kind is Or:
        for part in item.parts:  # type: ignore[union-attr]
            _collect(part, found)
    elif kind is BoolFact:
        _add_keys((item.key,), found)  # type: ignore[union-attr]


def _add_keys(keys: Iterable[object], found: set[str]) -> None:
    for key in keys:
        if type(key) is str:
            found.add(key)
        else:
            name = variable_of(key)
            if name is not None and type(key) is not ir.SlotRead:
                found.add(name)
            else:
                _add_reads(key, found)


def names_of_var(var: Var) -> frozenset[str]:
    return frozenset((var,)) if isinstance(var, str) else names_of(Linear(((var, 1),), 0))


def _add_reads(key: object, found: set[str]) -> None:
    """Add the variables that an expression depends on.

    From a tuple such as (operator, operand), adds the variables of the expressions in the tuple.
    """
    if isinstance(key, tuple):
        for part in key:
            _add_reads(part, found)
    elif isinstance(key, Node):
        for node in walk(key):
            name = variable_of(node)
            if name is not None:
                found.add(name)
