"""Assumptions of an outer program about its robots, as properties of the inner program whose fleet each robot is.

An assumption relates the ports of a module at the start of an outer round and at its end. In the inner program a sensor
is the expression that the program provides, an actuator the variable that takes its commands. Two properties of the
inner program together give the assumption (ADR 0056):

- *at once*: it holds with the present values for both times, also if commands have cleared sensors;
- *kept*: with the values at some earlier time, which are rigid, each inner step keeps it. Commands are left out: with
  a command a new outer round begins.

By induction over the inner rounds, the assumption holds from the inner round in which a command is applied until the
next command.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from koordgen.lang.ir import decl
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import map_children, walk
from koordgen.lang.ir.types import BOOL, INT
from koordgen.lang.node import replace
from koordgen.lang.source import Span

START = "@start"  # suffix of the names of sensors' values at the start of an outer round
OUTER = "outer."  # prefix of the names that belong to the outer program
LINES = 10_000_000  # offset of the outer program's line numbers, so that they differ from those of the inner program


class Unprovable(Exception):
    """Raised if an assumption cannot be stated about the inner program. The message gives the reason."""


class ProvidedAssumption(NamedTuple):
    """Assumption of the outer program about a module.

    `once`, `kept`: the properties of the inner program; `once` has one for each set of sensors that commands may have
        cleared. Without them `why` gives the reason."""

    module: str
    assumption: decl.Assumption
    once: tuple[decl.Property, ...] = ()
    kept: decl.Property | None = None
    why: str = ""


class ProvidedModules:
    """Assumptions of an outer program about the modules that an inner program provides.

    `assumptions`: in the order of the outer program."""

    def __init__(self, inner: decl.Program, outer: decl.Program, params: Mapping[str, ir.Expr]) -> None:
        self.inner, self.outer = inner, outer
        self._provided = {m.name: {p.port.name: p for p in m.ports} for m in inner.provides}
        self._params = params
        self.assumptions = [
            self._stated(module, assumption) for module in outer.modules for assumption in module.assumptions
        ]

    def program(self, properties: tuple[decl.Property, ...]) -> decl.Program:
        """Return the inner program with other properties, which may read names of the outer program."""
        called = {f.name for each in self.assumptions if each.kept for f in self._called(each.assumption.formula)}
        used = [f for f in self.outer.functions if f.name in called]  # in their order: callees come first
        functions = tuple([self._renamed(replace(f, name=_outer(f.name))) for f in used])
        return replace(
            self.inner,
            params=(*self.inner.params, *self._outer_params(), *self._rigid()),
            records=tuple({r.type.name: r for r in (*self.outer.records, *self.inner.records)}.values()),
            functions=(*functions, *self.inner.functions),
            properties=properties,
        )

    def fixed(self) -> dict[str, ir.Expr]:
        """Return the values of the outer program's fixed params, by their names in the inner program."""
        return {_outer(name): value for name, value in self._params.items()}

    def _outer_params(self) -> list[decl.Param]:
        at = Span(1, 1, 1, 1)
        own = [
            decl.Param(_outer("pid"), INT, ir.Const(0, INT, at), at),
            decl.Param(_outer("N_SYS"), INT, ir.Const(1, INT, at), at),
        ]
        return own + [replace(p, name=_outer(p.name)) for p in self.outer.params]

    def _rigid(self) -> list[decl.Param]:
        """Return a param for the value of each provided sensor at the start of an outer round: it never changes."""
        return [
            decl.Param(f"{module}.{p.port.name}{START}", p.port.type, ir.Const(0, INT, p.port.span), p.port.span)
            for module, ports in self._provided.items()
            for p in ports.values()
            if p.port.direction == "sensor"
        ]

    def _stated(self, module: decl.Module, assumption: decl.Assumption) -> ProvidedAssumption:
        name, formula, span = f"{module.name} line {assumption.span.line}", assumption.formula, _raised(assumption.span)
        try:
            self._check(module, assumption)
        except Unprovable as reason:
            return ProvidedAssumption(module.name, assumption, why=str(reason))
        once = [
            decl.Property("invariant", f"{name}, at once {number}", self._moved(formula, False, cleared), span)
            for number, cleared in enumerate(self._cleared(module, formula))
        ]
        kept = decl.Property("invariant", f"{name}, kept", self._moved(formula, True), span)
        return ProvidedAssumption(module.name, assumption, tuple(once), kept)

    def _cleared(self, module: decl.Module, formula: ir.Expr) -> list[frozenset[str]]:
        """Return each set of a formula's sensors that commands of the outer round may have cleared, also the empty one.

        A sensor that a command clears is false from the command on, whatever the inner program provides."""
        found = {frozenset[str]()}
        for cleared in [frozenset(port.meaning.clears) for port in module.ports]:
            found |= {cleared | other for other in found}
        read = {n.port for n in walk(formula) if isinstance(n, ir.PortRead) and not n.primed}
        return sorted({cleared & read for cleared in found}, key=sorted)

    def _check(self, module: decl.Module, assumption: decl.Assumption) -> None:
        """Raise Unprovable if the inner program does not provide what an assumption reads."""
        path, provided = self.inner.path, self._provided.get(module.name)
        if provided is None:
            raise Unprovable(f"{path} does not provide {module.name}")
        declared = {port.name: port for port in module.ports}
        for record in self.outer.records:
            namesake = next((r for r in self.inner.records if r.type.name == record.type.name), record)
            if namesake.type != record.type:
                raise Unprovable(f"the record {record.type.name} has other fields in {path}")
        for node in walk((assumption.formula, self._called(assumption.formula))):
            match node:
                case ir.PortCall(_, port):
                    raise Unprovable(f"{module.name}.{port} is called, and a fleet cannot provide a callable port")
                case ir.Ids():
                    raise Unprovable("it is about all robots of the outer fleet")
                case ir.ExternCall(name):
                    raise Unprovable(f"{name} is an extern function")
                case ir.PortRead(_, port) if port not in provided:
                    raise Unprovable(f"{path} does not provide {module.name}.{port}")
                case ir.PortRead(_, port):
                    theirs, ours = provided[port].port, declared[port]
                    if (theirs.type, theirs.direction) != (ours.type, ours.direction):
                        mine, its = f"{ours.direction} of type {ours.type}", f"{theirs.direction} of type {theirs.type}"
                        raise Unprovable(f"{module.name}.{port} is a {mine} here, and a {its} in {path}")
        if decl.goals(assumption):
            raise Unprovable("it is about all arguments of a callable port")

    def _moved(self, node: Any, rigid: bool, cleared: frozenset[str] = frozenset()) -> Any:
        """Return a formula about ports as one about the inner program's state.

        `rigid`: the unprimed sensors have their values at the start of the outer round, which are arbitrary.
        `cleared`: unprimed sensors that are false."""

        def moved(child: Any) -> Any:
            return self._moved(child, rigid, cleared)

        match node:
            case ir.PortRead(module, port, primed, type_, span):
                provided = self._provided[module][port]
                if primed or provided.port.direction != "sensor":
                    return provided.value
                if port in cleared:
                    return ir.Const(False, BOOL, _raised(span))
                return ir.ParamRead(f"{module}.{port}{START}", type_, _raised(span)) if rigid else provided.value
            case ir.Pid(type_, span):
                return ir.ParamRead(_outer("pid"), type_, _raised(span))
            case ir.NSys(type_, span):
                return ir.ParamRead(_outer("N_SYS"), type_, _raised(span))
            case ir.ParamRead(name):
                return replace(node, name=_outer(name), span=_raised(node.span))
            case ir.Call(name):
                return map_children(replace(node, name=_outer(name), span=_raised(node.span)), moved)
        found = map_children(node, moved)
        return replace(found, span=_raised(found.span)) if hasattr(found, "span") else found

    def _called(self, formula: ir.Expr) -> tuple[decl.Function, ...]:
        """Return the functions that a formula calls, directly or not."""
        known = {function.name: function for function in self.outer.functions}
        found: dict[str, decl.Function] = {}
        pending: list[ir.Expr | decl.Function] = [formula]
        while pending:
            for node in walk(pending.pop()):
                if isinstance(node, ir.Call) and node.name in known and node.name not in found:
                    found[node.name] = known[node.name]
                    pending.append(known[node.name])
        return tuple(found.values())

    def _renamed(self, node: Any) -> Any:
        """Return a function of the outer program with its names in the inner one."""
        match node:
            case ir.ParamRead(name):
                return replace(node, name=_outer(name))
            case ir.Call(name):
                return map_children(replace(node, name=_outer(name)), self._renamed)
        return map_children(node, self._renamed)


def _outer(name: str) -> str:
    return f"{OUTER}{name}"


def _raised(span: Span) -> Span:
    if span.line > LINES:
        return span
    return Span(span.line + LINES, span.column, span.end_line + LINES, span.end_column)
