"""Going through trees of the IR: order, what is visited, what a rebuilt tree keeps."""

from __future__ import annotations

from typing import Any

import pytest

from koordgen.build.pipeline import check_file
from koordgen.lang.ir import decl, draft, expr, stmt, types
from koordgen.lang.ir.tree import child_fields, children, map_children, statements, transform, walk
from koordgen.lang.ir.types import BOOL, FLOAT, INT, list_of
from koordgen.lang.ir.verify_expr import _READERS as verifier
from koordgen.lang.node import Node, replace
from koordgen.lang.semantics.eval import MEANINGS
from koordgen.lang.semantics.exact import exact
from koordgen.lang.source import Span
from koordgen.lang.syntax import expr as written
from koordgen.verify.prove.encode.expr import _READERS as prover
from tests.agree.faults import rewritten
from tests.lang.ir.everything import nodes
from tests.lang.ir.test_encoding import EXPORTER, KITCHEN, PROVIDER, compiled, ir_classes

AT = Span(7, 7, 7, 8)
ONE, TWO, THREE = (expr.Const(i, INT, AT) for i in (1, 2, 3))
LOOP = """local:
  float x = 0.5
  int n = 3
A:
  pre: x < 1 / n
  eff:
    while n > 0:
      invariant n >= 0
      x = 0.25 + n
      n -= 1
"""
YES, NO = expr.Const(True, BOOL, AT), expr.Const(False, BOOL, AT)
TYPES = types.Type.__args__
# The fields with children of every class that has some.
FIELDS: dict[type[Node], tuple[str, ...]] = {
    expr.SlotRead: ("index",),
    expr.LocalOf: ("robot",),
    expr.PortOf: ("robot",),
    expr.Widen: ("operand",),
    expr.Unary: ("operand",),
    expr.Binary: ("left", "right"),
    expr.Compare: ("left", "right"),
    expr.Contains: ("item", "values"),
    expr.Logic: ("left", "right"),
    expr.Conditional: ("condition", "then", "orelse"),
    expr.Quantified: ("domain", "body"),
    expr.Range: ("start", "stop"),
    expr.Make: ("items",),
    expr.Field: ("operand",),
    expr.Item: ("operand",),
    expr.At: ("operand", "index"),
    expr.Slice: ("operand", "start", "stop"),
    expr.With: ("operand", "value"),
    expr.Builtin: ("args",),
    expr.Call: ("args",),
    expr.ExternCall: ("args",),
    expr.PortCall: ("args",),
    stmt.Assign: ("place", "value"),
    stmt.Let: ("value",),
    stmt.If: ("condition", "then", "orelse"),
    stmt.LoopInvariant: ("formula",),
    stmt.For: ("values", "block", "invariants"),
    stmt.While: ("condition", "block", "invariants"),
    stmt.Return: ("value",),
    stmt.Emit: ("items",),
    decl.Param: ("default",),
    decl.Record: ("defaults",),
    decl.Function: ("parameters", "block"),
    decl.ExternFunction: ("parameters", "requires", "ensures"),
    decl.SpecFunction: ("parameters",),
    decl.Assumption: ("formula",),
    decl.Module: ("ports", "assumptions"),
    decl.Shared: ("initial",),
    decl.Local: ("initial",),
    decl.Event: ("guard", "effect"),
    decl.Property: ("formula",),
    decl.Guarantee: ("formula",),
    decl.Export: ("guarantees",),
    decl.Provided: ("port", "value"),
    decl.Provides: ("ports",),
    decl.Program: (
        *("records", "extern_types", "functions", "externs", "specs", "params", "modules", "shared", "locals", "init"),
        *("events", "properties", "exports", "imports", "provides"),
    ),
}
LEAVES = {
    *(expr.Const, expr.Pid, expr.NSys, expr.Ids, expr.ParamRead, expr.LocalRead, expr.TempRead, expr.SlotsRead),
    *(expr.SharedRead, expr.PortRead),
    *(stmt.LocalPlace, stmt.OwnSlot, stmt.SharedPlace, stmt.PortPlace, stmt.TempPlace, stmt.Break, stmt.Continue),
    *(stmt.Stop, decl.Parameter, decl.ExternTypeDef, decl.Port, decl.Meaning, decl.Import),
    *TYPES,
}


def kitchen() -> decl.Program:
    return check_file(str(KITCHEN)).program


def test_the_fields_with_children_of_every_class() -> None:
    assert FIELDS.keys() | LEAVES == ir_classes()
    assert {kind: child_fields(kind) for kind in ir_classes()} == {**FIELDS, **dict.fromkeys(LEAVES, ())}


def test_drafts_have_children_and_are_no_statements() -> None:
    index, stop = expr.Pid(INT, AT), stmt.Stop(AT)
    assert [child_fields(k) for k in (draft.SlotPlace, draft.Atomic, draft.UnparsedStmt)] == [("index",), (), ()]
    assert children(draft.WrongStmt((index,), AT)) == (index,)
    block: tuple[draft.Draft, ...] = (draft.Atomic(AT), draft.UnparsedStmt(AT), stop, draft.WrongStmt((index,), AT))
    assert list(statements(block)) == [stop]


def test_children_stand_in_the_order_of_the_fields() -> None:
    loop = stmt.While(YES, (stmt.Break(AT), stmt.Continue(AT)), AT, (stmt.LoopInvariant(NO, AT),))
    assert children(loop) == (YES, stmt.Break(AT), stmt.Continue(AT), stmt.LoopInvariant(NO, AT))
    assert children(expr.Make((ONE, TWO), list_of(INT), AT)) == (ONE, TWO)
    assert children(expr.Compare("<", ONE, TWO, BOOL, AT)) == (ONE, TWO)
    assert children(expr.Widen(ONE, FLOAT, AT)) == (ONE,)
    assert children(stmt.Return(ONE, AT)) == (ONE,)
    assert children(ONE) == children(INT) == children(stmt.Stop(AT)) == ()


@pytest.mark.parametrize(("start", "stop"), [(None, None), (TWO, None), (None, THREE), (TWO, THREE)])
def test_a_bound_that_is_not_there_is_no_child(start: expr.Expr | None, stop: expr.Expr | None) -> None:
    node = expr.Slice(ONE, start, stop, True, list_of(INT), AT)
    assert children(node) == tuple(part for part in (ONE, start, stop) if part is not None)
    assert map_children(node, lambda part: part) is node
    changed = map_children(node, lambda part: THREE if part is TWO else part)
    assert changed == replace(node, start=THREE if start is TWO else start)


def test_only_nodes_of_the_ir_have_children() -> None:
    wrongs: list[Any] = [written.Name("x", AT), AT, [ONE]]
    for wrong in wrongs:
        with pytest.raises(TypeError, match="is not a node of the IR"):
            children(wrong)
        with pytest.raises(TypeError, match="is not a node of the IR"):
            list(walk(wrong))


def test_each_node_is_yielded_before_those_below_it() -> None:
    inner, outer = expr.Binary("+", ONE, TWO, True, INT, AT), expr.Unary("-", THREE, INT, AT)
    whole = expr.Compare("<", inner, outer, BOOL, AT)
    let = stmt.Let("x", BOOL, whole, AT)
    assert [id(n) for n in walk(whole)] == [id(n) for n in (whole, inner, ONE, TWO, outer, THREE)]
    assert [id(n) for n in walk((let, (YES, ()), NO))] == [id(n) for n in (let, *walk(whole), YES, NO)]
    assert list(walk(())) == []


def test_a_node_that_stands_in_two_places_is_yielded_twice() -> None:
    assert [id(n) for n in walk(expr.Logic("and", YES, YES, BOOL, AT))][1:] == [id(YES)] * 2


def test_a_walk_visits_all_but_what_is_read_where_it_stands() -> None:
    """`nodes` goes into every field."""
    programs = (kitchen(), compiled(LOOP), compiled(EXPORTER), compiled(PROVIDER))
    expected = [node for node in nodes(programs) if not isinstance(node, (Span, decl.Meaning, *TYPES))]
    assert [id(node) for node in walk(programs)] == [id(node) for node in expected]
    assert {type(node) for node in expected} >= FIELDS.keys()


def test_a_walk_of_a_deep_tree_needs_no_stack() -> None:
    node: expr.Expr = YES
    for _ in range(20_000):
        node = expr.Unary("not", node, BOOL, AT)
    assert sum(1 for _ in walk(node)) == 20_001


def test_the_identity_returns_the_tree_itself() -> None:
    program = kitchen()
    assert transform(program, lambda node: node) is program


def test_a_copy_of_every_node_is_an_equal_tree_with_the_same_places() -> None:
    program = kitchen()
    copy = transform(program, replace)
    assert copy is not program and repr(copy) == repr(program)
    pairs = list(zip(walk(program), walk(copy), strict=True))
    assert all(new is not old for old, new in pairs)
    assert all(getattr(new, "span", None) is getattr(old, "span", None) for old, new in pairs)


def test_only_what_stands_above_a_change_is_rebuilt() -> None:
    kept = expr.Unary("-", ONE, INT, AT)
    whole = expr.Compare("<", kept, expr.Binary("+", TWO, ONE, False, INT, AT), BOOL, AT)
    made = transform(whole, lambda node: THREE if node is TWO else node)
    assert made == expr.Compare("<", kept, expr.Binary("+", THREE, ONE, False, INT, AT), BOOL, AT)
    assert isinstance(made, expr.Compare) and made.left is kept and made.span is AT
    assert isinstance(made.right, expr.Binary) and made.right.right is ONE


def test_nodes_are_replaced_from_the_leaves_up() -> None:
    seen: list[Node] = []

    def doubled(node: Node) -> Node:
        seen.append(node)
        return replace(node, value=2 * node.value) if isinstance(node, expr.Const) else node

    whole = expr.Binary("+", ONE, expr.Unary("-", TWO, INT, AT), True, INT, AT)
    made = transform(whole, doubled)
    assert seen == [ONE, TWO, expr.Unary("-", replace(TWO, value=4), INT, AT), made]


def test_children_are_replaced_without_going_into_them() -> None:
    inner = expr.Unary("-", ONE, INT, AT)
    whole = expr.Binary("+", inner, ONE, True, INT, AT)
    assert map_children(whole, lambda node: TWO if node is ONE else node) == replace(whole, right=TWO)
    assert map_children(ONE, lambda node: TWO) is ONE


def test_a_rewritten_program_is_that_of_another_walk() -> None:
    """`rewritten` of the agreement tests copies every node."""
    program = compiled(LOOP)

    def change(node: Node) -> Node:
        return expr.Const(0.5, node.type, node.span) if isinstance(node, expr.Const) and node.value == 0.25 else node

    assert repr(transform(program, change)) == repr(rewritten(program, change)) != repr(program)
    assert {type(n.value) for n in walk(exact(program)) if isinstance(n, expr.Const)}.isdisjoint({float})


def test_statements_come_in_the_order_of_the_text() -> None:
    stop, leave, again, say = stmt.Stop(AT), stmt.Break(AT), stmt.Continue(AT), stmt.Emit("Log", "out", (), AT)
    loop = stmt.While(YES, (leave, again), AT, (stmt.LoopInvariant(YES, AT),))
    branch = stmt.If(YES, (say, loop), (stop,), AT)
    each = stmt.For(("x",), (INT,), ONE, (branch,), AT)
    assert [id(s) for s in statements((each, stop))] == [
        id(s) for s in (each, branch, say, loop, leave, again, stop, stop)
    ]


@pytest.mark.parametrize("program", [kitchen(), compiled(LOOP)], ids=["kitchen", "loop"])
def test_statements_are_those_of_a_walk(program: decl.Program) -> None:
    for block in (program.init, *[e.effect for e in program.events], *[f.block for f in program.functions]):
        kinds = stmt.Stmt.__args__
        assert [id(s) for s in statements(block)] == [id(n) for n in walk(block) if isinstance(n, kinds)]


TABLES = {"semantics": MEANINGS, "verifier": verifier, "prover": prover}


@pytest.mark.parametrize("table", TABLES)
def test_tables_by_class_have_all_expressions(table: str) -> None:
    """Where `match` would be too slow. A Range is no value of the prover: what runs over one asks for its bounds."""
    missing = {expr.Range} if table == "prover" else set()
    assert TABLES[table].keys() == set(expr.Expr.__args__) - missing
