"""Checks of functions: first all signatures, so that functions may stand in any order, then bodies and contracts."""

from __future__ import annotations

from collections.abc import Iterable

from koordgen.lang.check.base import condition
from koordgen.lang.check.context import Context, Temp
from koordgen.lang.check.graph import topological_order
from koordgen.lang.check.names import enter, is_owner, is_reserved, unique
from koordgen.lang.check.statements.stmt import check_block
from koordgen.lang.check.types import is_fleet_size, resolve
from koordgen.lang.diagnostics import Edit, Label
from koordgen.lang.ir import decl, expr
from koordgen.lang.ir.types import POISON, PerRobot, Type
from koordgen.lang.source import Span
from koordgen.lang.syntax import decl as ast
from koordgen.lang.syntax import expr as tree
from koordgen.lang.syntax.walk import nodes

Signature = tuple[tuple[decl.Parameter, ...], Type]


def signature(node: ast.Function | ast.ExternFunction | ast.SpecFunction, c: Context) -> Signature:
    """Define a function and return its parameters and result type.

    The result type is POISON if the declared type is wrong, or if only a check of the body can tell the type.
    """
    parameters = tuple([decl.Parameter(p.name, _parameter_type(p, c)) for p in node.parameters])
    result = POISON if node.result is None else resolve(node.result, c)
    entity: decl.Function | decl.ExternFunction | decl.SpecFunction
    match node:
        case ast.Function():
            entity = decl.Function(node.name, parameters, result, (), node.span)
        case ast.ExternFunction():
            entity = decl.ExternFunction(node.name, parameters, result, (), (), node.span)
        case ast.SpecFunction():
            entity = decl.SpecFunction(node.name, parameters, result, node.span)
    known = node.result is None or result != POISON
    enter(node.name, node, entity if known else None, c)
    return parameters, result


def _parameter_type(node: ast.Parameter, c: Context) -> Type:
    type_ = resolve(node.type, c)
    if node.size is None or type_ == POISON or isinstance(node.size, tree.Broken):
        return type_
    if not is_fleet_size(node.size, c):
        message = f"only N_SYS is a size: {node.name} has one value for each robot, or {node.name} is a list"
        c.error("K017", message, node.size.span, f"write {type_} {node.name}[N_SYS], or List<{type_}> {node.name}")
        return POISON
    return PerRobot(type_)


def specs(sections: Iterable[ast.SpecFunction], c: Context) -> tuple[decl.SpecFunction, ...]:
    found = []
    for node in sections:
        parameters, result = signature(node, c)
        seen: dict[str, Span] = {}
        for parameter in node.parameters:
            unique(parameter.name, f"parameters of {node.name}", parameter.span, seen, c)
        found.append(decl.SpecFunction(node.name, parameters, result, node.span))
    return tuple(found)


Signed = list[tuple[ast.Function, Signature]]


def check_bodies(signed: Signed, c: Context) -> tuple[decl.Function, ...]:
    """Check the bodies of functions. Returns the functions, each after the functions that it calls."""
    signed = _callees_first(signed, c)
    checked = {}
    for node, known in signed:
        function = _body(node, known, c)
        enter(node.name, node, function, c)
        checked[node.name] = function
    order, cycles = topological_order({name: sorted(c.calls.get(name, ())) for name in checked})
    for cycle in cycles:
        if len(cycle) == 1:
            message = f"the function {cycle[0]} calls itself"
        else:
            message = f"the function {cycle[0]} calls itself: {cycle[0]} calls {', which calls '.join(cycle[1:])}"
            message += f", which calls {cycle[0]}"
        c.error("K026", message, checked[cycle[0]].span, "use a loop instead of recursion")
    return tuple([checked[name] for name in order])


def _callees_first(signed: Signed, c: Context) -> Signed:
    """Return the functions in the order in which they are checked.

    Functions of the 2020 dialect declare no result types. If the program has such functions, each function comes after
    the functions that it calls, so that a result type is known before it is used.
    """
    if all(node.result is not None for node, _ in signed):
        return signed
    by_name = {node.name: (node, known) for node, known in signed if is_owner(node.name, node, c)}
    calls = {name: _called(node) for name, (node, _) in by_name.items()}
    return [by_name[name] for name in topological_order(calls)[0]] + [
        s for s in signed if not is_owner(s[0].name, s[0], c)
    ]


def _called(node: ast.Function) -> list[str]:
    calls = (part.function for part in nodes(node.block) if isinstance(part, tree.Call))
    return [function.name for function in calls if isinstance(function, tree.Name)]


def _body(node: ast.Function, known: Signature, c: Context) -> decl.Function:
    parameters, result = known
    c.enter("function")
    c.function = node.name
    c.result = None if node.result is None else result
    parameters = _temps(node.parameters, parameters, c)
    block = check_block(node.block, c)
    result = POISON if c.result is None else c.result
    if node.def_span is not None:
        _modernise(node, result, c)
    return decl.Function(node.name, parameters, result, block, node.span)


def _temps(
    written: tuple[ast.Parameter, ...], parameters: tuple[decl.Parameter, ...], c: Context
) -> tuple[decl.Parameter, ...]:
    """Declare the parameters in the scope of the section; return them with their unique names in the IR.

    A parameter may have the name of a variable or module, because functions cannot read variables and modules.
    """
    scope = c.scopes[0]
    kept = []
    for node, (name, type_) in zip(written, ((p.name, p.type) for p in parameters), strict=True):
        entity = c.entities.get(name)
        first = scope.get(name) or (None if isinstance(entity, (decl.Local, decl.Shared, decl.Module)) else entity)
        if is_reserved(name):
            c.error("K011", f"{name} is predefined", node.span, "choose another name")
            scope[name] = Temp(c.mint(name), type_, node.span)
        elif first is not None:
            label = Label(first.span, "declared here first")
            c.error("K011", f"{name} is declared already", node.span, "choose another name", (label,))
        else:
            temp = scope[name] = Temp(c.mint(name), type_, node.span)
            kept.append(decl.Parameter(temp.unique, type_))
    return tuple(kept)


def _modernise(node: ast.Function, result: Type, c: Context) -> None:
    """Suggest the modern head of a function: `def fun f(pos a):` becomes `fun f(pos a) -> Point:`."""
    start = node.def_span
    assert start is not None
    edits = [Edit(Span(start.line, start.column, node.span.line, node.span.column), "fun ")]
    new = "fun"
    if node.result is None and result != POISON:
        new = f"fun ... -> {result}"
        close = _parameters_end(node, c)
        edits.append(Edit(Span(close.line, close.column, close.line, close.column), f" -> {result}"))
    c.report_old_spelling("def fun", new, start, tuple(edits))


def _parameters_end(node: ast.Function, c: Context) -> Span:
    """Return the position after the bracket that ends the parameters."""
    last = node.parameters[-1].span if node.parameters else node.span
    line, column = last.end_line, last.end_column
    while True:
        code = c.source.line(line).partition("#")[0]
        found = code.find(")", column - 1)
        if found >= 0:
            return Span(line, found + 2, line, found + 2)
        line, column = line + 1, 1


def externs(sections: Iterable[ast.ExternFunction], c: Context) -> tuple[decl.ExternFunction, ...]:
    """Check the contracts of extern functions.

    The formulas of contracts may call functions, so the functions must be defined before this check.
    """
    return tuple([_extern(node, c) for node in sections])


def _extern(node: ast.ExternFunction, c: Context) -> decl.ExternFunction:
    c.enter("contract")
    entity = c.entities.get(node.name)
    if not isinstance(entity, decl.ExternFunction) or not is_owner(node.name, node, c):
        return decl.ExternFunction(node.name, (), POISON, (), (), node.span)
    parameters = _temps(node.parameters, entity.parameters, c)
    requires = _formulas(node, "requires", c)
    for parameter in node.parameters:
        if parameter.name == "result" and node.contracts:
            message = "in a contract, the name result denotes the function's result"
            c.error("K011", message, parameter.span, "choose another name")
    c.scopes.append({"result": Temp(c.mint("result"), entity.result, node.span)})
    ensures = _formulas(node, "ensures", c)
    return decl.ExternFunction(node.name, parameters, entity.result, requires, ensures, node.span)


def _formulas(node: ast.ExternFunction, kind: str, c: Context) -> tuple[expr.Expr, ...]:
    return tuple([condition(part.formula, c, f"'{kind}'") for part in node.contracts if part.kind == kind])
