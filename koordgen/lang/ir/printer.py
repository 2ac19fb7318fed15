"""Printer of the IR with types, for `koordgen dump --after check`.

The same program gives the same text.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import assert_never

from koordgen.lang.ir import decl, expr, stmt
from koordgen.lang.ir.types import MapOf, Sequence, Sized, TupleOf, Type


def show(program: decl.Program) -> str:
    """Return a program as text, one declaration or statement a line.

    `?` after an index, a slice or an operator marks a check at run time, `int -> float` a widened value, `max` a
    variable's capacities.
    """
    lines = [f"program {program.name} ({program.path})"]
    lines += [f"extern type {type_.name}" for type_ in program.extern_types]
    for record in program.records:
        lines.append(f"record {record.type.name}")
        fields = zip(record.type.fields, record.defaults, strict=True)
        lines += [f"  {_variable(name, type_)} = {expression(value)}" for (name, type_), value in fields]
    for param in program.params:
        lines.append(f"param {_variable(param.name, param.type)} = {expression(param.default)}")
    for function in program.functions:
        lines += [f"fun {_signature(function)}", *_block(function.block, "  ")]
    for extern in program.externs:
        lines.append(f"extern fun {_signature(extern)}")
        lines += [f"  requires {expression(formula)}" for formula in extern.requires]
        lines += [f"  ensures {expression(formula)}" for formula in extern.ensures]
    lines += [f"spec fun {_signature(spec)}" for spec in program.specs]
    for module in program.modules:
        lines.append(f"module {module.name}")
        lines += [f"  {port.direction} {_variable(port.name, port.type)}" for port in module.ports]
        lines += [f"  assume {_assumption(assumption)}" for assumption in module.assumptions]
    for shared in program.shared:
        size = "[N_SYS]" if shared.kind == "allread" else ""
        lines.append(f"{shared.kind} {_variable(shared.name, shared.type, size)} = {expression(shared.initial)}")
    for local in program.locals:
        lines.append(f"local {_variable(local.name, local.type)} = {expression(local.initial)}")
    lines += [f"lock {index}: {', '.join(group)}" for index, group in enumerate(program.locks)]
    if program.init:
        lines.append("init")
        lines += _block(program.init, "  ")
    for event in program.events:
        lock = "" if event.lock is None else f" under lock {event.lock}"
        block = "" if event.priority is None else f" in priority block {event.priority}"
        lines += [f"event {event.name}{lock}{block}", f"  when {expression(event.guard)}", *_block(event.effect, "  ")]
    for property_ in program.properties:
        lines.append(f"{' '.join((property_.kind, property_.name)).strip()}: {expression(property_.formula)}")
    for export in program.exports:
        lines.append(f"export {'write ' if export.is_written else ''}{export.variable}")
        lines += [f"  guarantee {g.name}: {expression(g.formula)}" for g in export.guarantees]
    for provides in program.provides:
        lines.append(f"provides {provides.name}")
        for provided in provides.ports:
            port = provided.port
            lines.append(f"  {port.direction} {_variable(port.name, port.type)} = {expression(provided.value)}")
    for imported in program.imports:
        names = [f"{'write ' if name in imported.written else ''}{name}" for name in imported.variables]
        lines.append(f"import {imported.name}: {', '.join(names)}")
    return "\n".join(lines) + "\n"


def _assumption(assumption: decl.Assumption) -> str:
    goals = ", ".join(f"{name}: {type_}" for name, type_ in decl.goals(assumption).items())
    return f"{f'for all {goals}: ' if goals else ''}{expression(assumption.formula)}"


def _variable(name: str, type_: Type, size: str = "") -> str:
    most = list(capacities(type_))
    return f"{name}: {type_}{size}{' max ' if most else ''}{', '.join(map(str, most))}"


def capacities(type_: Type) -> Iterator[int]:
    """Yield the capacities of a type in the order of `max`: pre-order."""
    match type_:
        case Sized(_, capacity):
            yield capacity
        case Sequence(_, element, capacity):
            yield capacity
            yield from capacities(element)
        case MapOf(key, value, capacity):
            yield capacity
            yield from capacities(key)
            yield from capacities(value)
        case TupleOf(items):
            for item in items:
                yield from capacities(item)
        case _:
            pass


def _signature(function: decl.Function | decl.ExternFunction | decl.SpecFunction) -> str:
    parameters = ", ".join(f"{p.name}: {p.type}" for p in function.parameters)
    return f"{function.name}({parameters}) -> {function.result}"


def _block(block: stmt.Block, indent: str) -> Iterator[str]:
    for statement in block:
        match statement:
            case stmt.Assign(place, value):
                yield f"{indent}{_place(place)} := {expression(value)}"
            case stmt.Let(name, type_, value):
                yield f"{indent}let {name}: {type_} = {expression(value)}"
            case stmt.If():
                yield from _if(statement, indent)
            case stmt.For(names, types, values, inner):
                declared = ", ".join(f"{name}: {type_}" for name, type_ in zip(names, types, strict=True))
                yield f"{indent}for {declared} in {expression(values)}"
                yield from _invariants(statement, indent + "  ")
                yield from _block(inner, indent + "  ")
            case stmt.While(condition, inner):
                yield f"{indent}while {expression(condition)}"
                yield from _invariants(statement, indent + "  ")
                yield from _block(inner, indent + "  ")
            case stmt.Return(value):
                yield f"{indent}return {expression(value)}"
            case stmt.Emit(module, port, items):
                yield f"{indent}{module}.{port} << {_list(items)}"
            case stmt.Break():
                yield f"{indent}break"
            case stmt.Continue():
                yield f"{indent}continue"
            case stmt.Stop():
                yield f"{indent}stop"
            case _:
                assert_never(statement)


def _invariants(loop: stmt.For | stmt.While, indent: str) -> Iterator[str]:
    for invariant in loop.invariants:
        yield f"{indent}invariant {expression(invariant.formula)}"


def _if(statement: stmt.If, indent: str) -> Iterator[str]:
    word = "if"
    while True:
        yield f"{indent}{word} {expression(statement.condition)}"
        yield from _block(statement.then, indent + "  ")
        if len(statement.orelse) == 1 and isinstance(statement.orelse[0], stmt.If):
            statement, word = statement.orelse[0], "elif"
            continue
        if statement.orelse:
            yield f"{indent}else"
            yield from _block(statement.orelse, indent + "  ")
        return


def _place(place: stmt.Place) -> str:
    match place:
        case stmt.OwnSlot(name):
            return f"{name}[pid]"
        case stmt.PortPlace(module, port):
            return f"{module}.{port}"
        case stmt.LocalPlace(name) | stmt.SharedPlace(name) | stmt.TempPlace(name):
            return name
        case _:
            assert_never(place)


def _list(items: Iterable[expr.Expr]) -> str:
    return ", ".join([expression(item) for item in items])


def expression(node: expr.Expr) -> str:
    """Return an expression as text, with parentheses around every operator."""
    match node:
        case expr.Const(value):
            return repr(value)
        case (
            expr.ParamRead(name)
            | expr.LocalRead(name)
            | expr.TempRead(name)
            | expr.SharedRead(name)
            | expr.SlotsRead(name)
        ):
            return name
        case expr.Pid():
            return "pid"
        case expr.NSys():
            return "N_SYS"
        case expr.Ids():
            return "ID"
        case expr.SlotRead(name, index, proved):
            return f"{name}[{expression(index)}]{_check_mark(proved)}"
        case expr.PortRead(module, port, primed):
            return f"{module}.{port}{_prime(primed)}"
        case expr.LocalOf(name, robot):
            return f"{name}[{expression(robot)}]"
        case expr.PortOf(module, port, robot):
            return f"{module}.{port}[{expression(robot)}]"
        case expr.Widen(operand):
            return f"(int -> float {expression(operand)})"
        case expr.Unary(op, operand):
            return f"({op}{' ' if op == 'not' else ''}{expression(operand)})"
        case expr.Binary(op, left, right, proved):
            return f"({expression(left)} {op}{_check_mark(proved)} {expression(right)}: {node.type})"
        case expr.Compare(op, left, right) | expr.Logic(op, left, right):
            return f"({expression(left)} {op} {expression(right)})"
        case expr.Contains(item, values):
            return f"({expression(item)} in {expression(values)})"
        case expr.Conditional(condition, then, orelse):
            return f"({expression(then)} if {expression(condition)} else {expression(orelse)}: {node.type})"
        case expr.Quantified(kind, name, domain, body):
            return f"({kind} {name} in {expression(domain)}: {expression(body)})"
        case expr.Range(start, stop, step):
            return f"range({expression(start)}, {expression(stop)}, {step})"
        case _:
            return _compound(node)


def _compound(
    node: expr.Make | expr.Field | expr.Item | expr.At | expr.Slice | expr.With | expr.Builtin
    | expr.Call | expr.ExternCall | expr.PortCall,
) -> str:  # fmt: skip
    """Return the text of a call, or of a value that consists of parts."""
    match node:
        case expr.Make(items, type_):
            return f"{type_}{{{_list(items)}}}"
        case expr.Field(operand, name):
            return f"{expression(operand)}.{name}"
        case expr.Item(operand, index):
            return f"{expression(operand)}[{index}]"
        case expr.At(operand, index, proved):
            return f"{expression(operand)}[{expression(index)}]{_check_mark(proved)}"
        case expr.Slice(operand, start, stop, proved):
            bounds = ":".join("" if bound is None else expression(bound) for bound in (start, stop))
            return f"{expression(operand)}[{bounds}]{_check_mark(proved)}"
        case expr.With(operand, name, value):
            return f"({expression(operand)} with {name} = {expression(value)})"
        case expr.Builtin(name, args):
            # The names of these builtins do not determine the type of the result.
            several = name in ("abs", "min", "max", "sum", "first", "last", "map_at", "get")
            return f"({name}({_list(args)}): {node.type})" if several else f"{name}({_list(args)})"
        case expr.Call(name, args) | expr.ExternCall(name, args):
            return f"{name}({_list(args)})"
        case expr.PortCall(module, port, args):
            return f"{module}.{port}({_list(args)})"
        case _:
            assert_never(node)


def _check_mark(proved: bool) -> str:
    return "" if proved else "?"


def _prime(primed: bool) -> str:
    return "'" if primed else ""
