"""Bugs to seed into either meaning. Comparing both meanings on random programs must find each of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import pytest

from koordgen.lang.ir import decl as d
from koordgen.lang.ir import expr as e
from koordgen.lang.ir import stmt as s
from koordgen.lang.ir.tree import child_fields
from koordgen.lang.ir.types import INT, Sequence, TupleOf
from koordgen.lang.node import Node, replace
from koordgen.lang.semantics import builtins, eval, exec, numbers, values
from koordgen.lang.semantics.eval import StateView
from koordgen.lang.semantics.values import Value, items
from tests.agree.both import Generated, Pass, nothing, untouched
from tests.agree.general import binary, when
from tests.agree.kinds import whole

Change = Callable[[Any], Any]


class Fault(NamedTuple):
    """A seeded bug with its name.

    `emitted`: a pass before the emitter, as if the emitter were wrong. `spoil`: breaks the loaded generated program.
    `patch`: changes the executable semantics.
    """

    name: str
    emitted: Pass = untouched
    spoil: Callable[[Generated], None] = nothing
    patch: Callable[[pytest.MonkeyPatch], None] = lambda monkeypatch: None


def rewritten(root: Any, change: Change) -> Any:
    """Return a tree, or tuple of trees, with every node changed, from the leaves up; a statement may become a tuple."""
    if isinstance(root, tuple):
        found = [rewritten(part, change) for part in root]
        flat: list[Any] = []
        for old, new in zip(root, found, strict=True):
            flat.extend(new) if isinstance(old, Node) and isinstance(new, tuple) else flat.append(new)
        return tuple(flat)
    if not isinstance(root, Node):
        return root
    return change(replace(root, **{f: rewritten(getattr(root, f), change) for f in child_fields(type(root))}))


def rewriting(change: Change) -> Pass:
    """Return a pass over functions and events."""

    def run(program: d.Program) -> d.Program:
        functions, events, init = (rewritten(t, change) for t in (program.functions, program.events, program.init))
        return replace(program, functions=functions, events=events, init=init)

    return run


def rounding_up(node: Node) -> Node:
    if isinstance(node, e.Binary) and node.op == "//" and node.type == INT:
        minus = e.Unary("-", node.left, INT, node.span)
        return e.Unary("-", replace(node, left=minus), INT, node.span)
    return node


def longer_slices(node: Node) -> Node:
    return (
        replace(node, stop=binary("+", node.stop, whole(1), INT)) if isinstance(node, e.Slice) and node.stop else node
    )


def lost_widening(node: Node) -> Node:
    return node.operand if isinstance(node, e.Widen) else node


def unordered_sets(node: Node) -> Node:
    if isinstance(node, e.Make) and isinstance(node.type, Sequence) and node.type.name == "Set":
        return replace(node, type=Sequence("List", node.type.element, 64))
    return node


def eager_logic(node: Node) -> Node:
    """Evaluate the right operand first, and always."""
    return replace(node, left=node.right, right=node.left) if isinstance(node, e.Logic) else node


def eager_conditionals(node: Node) -> Any:
    """Evaluate both alternatives."""
    if not isinstance(node, e.Conditional):
        return node
    pair = e.Make((node.then, node.orelse), TupleOf((node.type, node.type)), node.span)
    first, second = (e.Item(pair, i, node.type, node.span) for i in range(2))
    return when(node.condition, first, second)


def operator(old: str, new: str) -> Change:
    kinds = (e.Binary, e.Compare, e.Logic)
    return lambda node: replace(node, op=new) if isinstance(node, kinds) and node.op == old else node


def without(kind: type[Node]) -> Change:
    return lambda node: () if isinstance(node, kind) else node


def continuing(node: Node) -> Node:
    return s.Continue(node.span) if isinstance(node, s.Break) else node


def own_slots(node: Node) -> Node:
    return replace(node, index=e.Pid(INT, node.span)) if isinstance(node, e.SlotRead) else node


def kept_parts(node: Node) -> Any:
    return node.operand if isinstance(node, e.With) else node


def shadowing(node: Node) -> Node:
    """Let a block's own variable be another variable."""
    if isinstance(node, (s.Let, e.TempRead, s.TempPlace)) and node.name[0] in "tl" and node.name[1:].isdigit():
        return replace(node, name=f"{node.name[0]}{int(node.name[1:]) // 2}")
    return node


def library(name: str, wrong: Callable[..., Any]) -> Callable[[Generated], None]:
    """Replace a function of the runtime in the generated program."""

    def spoil(generated: Generated) -> None:
        if name in generated.scope:
            generated.scope[name] = wrong

    return spoil


def meaning(name: str, wrong: Callable[..., Any]) -> Callable[[pytest.MonkeyPatch], None]:
    return lambda monkeypatch: monkeypatch.setitem(builtins.MEANINGS, name, wrong)


def live_loops(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a loop see the changes that its block makes to the list."""

    def elements(node: e.Expr, view: StateView) -> Iterator[Value]:
        if isinstance(node, e.Range) or not isinstance(node.type, Sequence):
            yield from eval.elements(node, view)
            return
        i = 0
        while i < min(len(items(eval.evaluate(node, view))), 1000):
            yield items(eval.evaluate(node, view))[i]
            i += 1

    monkeypatch.setattr(exec, "elements", elements)


def truncation(monkeypatch: pytest.MonkeyPatch) -> None:
    right = numbers._of_numbers

    def wrong(op: str, a: float, b: float) -> float:
        return int(a / b) if op == "//" and isinstance(a, int) else right(op, a, b)

    monkeypatch.setattr(numbers, "_of_numbers", wrong)


def boundless(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do not check capacities, infinities and long ints."""
    monkeypatch.setattr(exec, "flaw", lambda value, type_: "")


def any_number(monkeypatch: pytest.MonkeyPatch) -> None:
    """Store and send NaN, infinity and ints of more than 64 bits."""
    monkeypatch.setattr(values, "number_flaw", lambda value: "")


def from_the_end(xs: Any, i: int) -> Any:
    return xs[i]


COMMON = [
    Fault("// rounds up", rewriting(rounding_up)),
    Fault("- is +", rewriting(operator("-", "+"))),
    Fault("a slice is too long", rewriting(longer_slices)),
    Fault("and, or evaluate the right side", rewriting(eager_logic)),
    Fault("an int is not widened", rewriting(lost_widening)),
    Fault("a Set keeps its writing's order", rewriting(unordered_sets)),
    Fault("a part is not replaced", rewriting(kept_parts)),
    Fault("for runs over the live list", patch=live_loops),
    Fault("no loop invariant is evaluated", rewriting(without(s.LoopInvariant))),
    Fault("a loop invariant without a value discards", spoil=library("claim", lambda line, holds: holds() or True)),
    Fault("a loop ends at its last value", spoil=library("behind", lambda turns: turns[-1] if turns else turns.start)),
]
# Random programs seldom compare a number that is NaN: this one is shown by an effect that does.
NAN_COMPARED = Fault("NaN is compared", spoil=library("no_nan", lambda x: x))
RARE = [
    Fault("// truncates", patch=truncation),
    Fault("< is <=", rewriting(operator("<", "<="))),
    Fault("and is or", rewriting(operator("and", "or"))),
    Fault("if else evaluates both", rewriting(eager_conditionals)),
    Fault("break continues", rewriting(continuing)),
    Fault("continue is left out", rewriting(without(s.Continue))),
    Fault("stop is left out", rewriting(without(s.Stop))),
    Fault("lines to streams are lost", rewriting(without(s.Emit))),
    Fault("x[i] is x[pid]", rewriting(own_slots)),
    Fault("two temps are one", rewriting(shadowing)),
    Fault("an index counts from the end", spoil=library("at", from_the_end)),
    Fault("a slice's bound counts from the end", spoil=library("slice_", lambda xs, a, b: xs[a:b])),
    Fault("remove takes all", spoil=library("removed", lambda xs, v: tuple(x for x in xs if x != v))),
    Fault("insert is one off", spoil=library("inserted", lambda xs, i, v: (*xs[: i + 1], v, *xs[i + 1 :]))),
    Fault("a Set takes twice", spoil=library("set_with", lambda xs, v: tuple(sorted((*xs, v))))),
    Fault("a Map is not ordered", spoil=library("map_with", lambda m, k, v: (*(p for p in m if p[0] != k), (k, v)))),
    Fault("get finds nothing", spoil=library("map_get", lambda m, k, v: v)),
    Fault("NaN within a value is compared", spoil=library("no_nan_in", lambda value: value)),
    Fault("NaN and infinity are kept", patch=any_number),
    Fault("** as Python", spoil=library("power", lambda a, b: a**b)),
    Fault("a difference is a union", patch=meaning("difference", lambda a, b: builtins.set_of((*a, *b)))),
    Fault("round is half up", patch=meaning("round", lambda x: int(x + 0.5))),
    Fault("max is of the last", patch=meaning("max", lambda a, b: b)),
    Fault("nothing is bounded", patch=boundless),
]
