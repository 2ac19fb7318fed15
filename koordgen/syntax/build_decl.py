"""The nodes of sections and of what stands in them. See build.py."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

from koordgen.syntax import decl
from koordgen.syntax.build_base import Children, nodes, reach, token_span


def using_(c: Children) -> decl.Using:
    return decl.Using(c[1][1], nodes(c), reach(c[0], c[1]))


def ports(c: Children) -> decl.Ports:
    return decl.Ports("sensor" if c[0][1] == "sensors" else "actuator", nodes(c), token_span(c[0]))


def port(c: Children) -> decl.Port:
    return decl.Port(c[0], c[1][1], token_span(c[1]))


def bare_port(c: Children) -> decl.Ports:
    alone = port(c)
    return decl.Ports("", (alone,), alone.span)


def assume_(c: Children) -> decl.Assume:
    return decl.Assume(c[1], token_span(c[0]))


def param_(c: Children) -> decl.Param:
    capacities, default = _optional(c[3:])
    return decl.Param(c[1], c[2][1], capacities, default, token_span(c[2]))


def variables(c: Children) -> decl.Variables:
    return decl.Variables(c[0][1], nodes(c), token_span(c[0]))


def variable(c: Children) -> decl.Variable:
    capacities, initial = _optional(c[2:])
    return decl.Variable(c[0], c[1][1], None, capacities, initial, token_span(c[1]))


def array(c: Children) -> decl.Variable:
    capacities, initial = _optional(c[5:])
    return decl.Variable(c[0], c[1][1], c[3], capacities, initial, token_span(c[1]))


def _optional(c: Children) -> tuple[tuple[Any, ...], Any]:
    """The capacities and the initial value among what follows a variable's name and size."""
    found = nodes(c)
    if any(type(child) is tuple and child[0] == "=" for child in c):
        return found[:-1], found[-1]
    return found, None


def record(c: Children) -> decl.RecordDef:
    return decl.RecordDef(c[1][1], nodes(c), token_span(c[1]))


def function(c: Children) -> decl.Function:
    return decl.Function(c[1][1], _parameters(c), c[-3], c[-1], None, token_span(c[1]))


def old_function(c: Children) -> decl.Function:
    return decl.Function(c[2][1], _parameters(c), _result(c), c[-1], token_span(c[0]), token_span(c[2]))


def extern_function(c: Children) -> decl.ExternFunction:
    contracts = tuple(child for child in c if type(child) is decl.Contract)
    return decl.ExternFunction(c[2][1], _parameters(c), _result(c), contracts, token_span(c[2]))


def extern_type(c: Children) -> decl.ExternType:
    return decl.ExternType(c[2][1], token_span(c[2]))


def spec_function(c: Children) -> decl.SpecFunction:
    return decl.SpecFunction(c[2][1], _parameters(c), _result(c), token_span(c[2]))


def contract(c: Children) -> decl.Contract:
    return decl.Contract(c[0][1], nodes(c)[0], token_span(c[0]))


def parameter(c: Children) -> decl.Parameter:
    return decl.Parameter(c[0], c[1][1], c[3] if len(c) == 5 else None, token_span(c[1]))


def _parameters(c: Children) -> tuple[decl.Parameter, ...]:
    return tuple(child for child in c if type(child) is decl.Parameter)


def _result(c: Children) -> Any:
    """The type behind `->`, if there is one."""
    for mark, node in pairwise(c):
        if type(mark) is tuple and mark and mark[0] == "->":
            return node
    return None


def property_(c: Children) -> decl.Property:
    head = c[0] if c[1][0] == ":" else c[1]
    return decl.Property(c[0][1], "" if head is c[0] else head[1], nodes(c)[0], token_span(head))


def init_(c: Children) -> decl.Init:
    return decl.Init(c[2], token_span(c[0]))


def event(c: Children) -> decl.Event:
    return decl.Event(c[0][1], nodes(c[2:]), token_span(c[0]))


def priority_(c: Children) -> decl.Priority:
    return decl.Priority(nodes(c), token_span(c[0]))


def guard(c: Children) -> decl.Guard:
    return decl.Guard(nodes(c)[0], token_span(c[0]))


def effect(c: Children) -> decl.Effect:
    return decl.Effect(c[2], token_span(c[0]))
