"""Interfaces of the expression encoder.

`Scope` gives values to the names in an expression. `ExprEncoder` lists the encoder's methods that the modules for
builtins, sums and quantifiers call.
"""

from __future__ import annotations

from typing import Protocol

from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.types import Type
from koordgen.verify.prove.encode.context import ProofContext
from koordgen.verify.prove.encode.geometry import Geometry
from koordgen.verify.prove.encode.lists import Lists
from koordgen.verify.prove.encode.values import FleetValue, Val
from koordgen.verify.prove.smt.term import Term


class Scope(Protocol):
    """Values of the variables, ports and names that an expression can read at one program point."""

    pid: Term
    temps: dict[str, Val]

    def slot(self, name: str, index: Term) -> Val: ...
    def slots(self, name: str) -> FleetValue: ...
    def cell(self, name: str) -> Val: ...
    def local(self, name: str) -> Val: ...
    def port(self, name: str, primed: bool) -> Val: ...
    def local_of(self, name: str, robot: Term) -> Val: ...
    def port_of(self, name: str, robot: Term) -> Val: ...
    def ask(self, node: ir.PortCall, args: tuple[Val, ...]) -> Val: ...


class ExprEncoder(Protocol):
    """Interface of the expression encoder for the modules of builtins, sums and quantifiers.

    `strict`: whether a quantifier demands that all its instances have values."""

    context: ProofContext
    lists: Lists
    geometry: Geometry
    strict: bool

    def value(self, node: ir.Expr, scope: Scope) -> Val: ...
    def term(self, node: ir.Expr, scope: Scope) -> Term: ...
    def parts(self, node: ir.Expr, scope: Scope) -> tuple[Term, Term]: ...
    def apply(self, name: str, symbol: str, args: tuple[Val, ...], type_: Type) -> Val: ...
