"""Checks of names in a fleet file against the programs: variables, properties, params, classes of the user."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

from koordgen.build.bundle.drivers import own_class
from koordgen.fleet.settings import DriverClass, NameChecks, ValueCheck
from koordgen.lang.analyze.params import BadParam, Value, with_params
from koordgen.lang.ir.decl import Program, is_step, own_shared
from koordgen.lang.ir.stmt import LoopInvariant
from koordgen.lang.ir.tree import walk
from koordgen.lang.ir.types import POINT, RecordType, list_of
from koordgen.lang.ir.types import Sequence as SequenceType


def name_checks(programs: Mapping[str, Program], folders: Sequence[Path]) -> NameChecks:
    """Return the functions that check the names in a fleet file.

    `programs`: the fleet's only program under the name "", or the program of each application. Names of variables and
    properties of an application begin with the application's name and a dot. `folders`: where the user's classes are
    searched.
    """
    shared = {_named(prefix, s.name): s for prefix, program in programs.items() for s in own_shared(program)}

    def unpublished(name: str) -> str:
        known = [n for n, s in shared.items() if s.kind == "allread" and s.type in (POINT, list_of(POINT))]
        if name in known:
            return ""
        possible = f"; possible values: {', '.join(known)}" if known else ""
        return f"avoid is {name!r}: there is no allread variable {name} of type Point or List<Point>{possible}"

    def unmarked(name: str, position: str) -> str:
        found = shared[name].type if name in shared else None
        element = found.element if isinstance(found, SequenceType) else None
        places = [field for field, type_ in element.fields if type_ == POINT] if isinstance(element, RecordType) else []
        if position in places or (element == POINT and not position):
            return ""
        field = f"whose elements have a Point {position!r}" if position else "of Points"
        possible = f"; possible positions: {', '.join(places)}" if places else ""
        return f"marker_list.variable is {name!r}: there is no shared list {name} {field}{possible}"

    @cache  # inspect a class once: most robots name the same class, and an inspection starts a process
    def unfit(module: str, name: str, methods: tuple[str, ...]) -> str:
        driver, folders_ = DriverClass(module, name), list(folders)
        return next(filter(None, (own_class(driver, methods, p, folders_) for p in programs.values())), "")

    own = tuple(_named(prefix, name) for prefix, program in programs.items() for name in _properties(program))
    return NameChecks(unpublished, unmarked, lambda d, methods: unfit(d.module, d.name, methods), own)


def _named(prefix: str, name: str) -> str:
    return f"{prefix}.{name}" if prefix else name


def _properties(program: Program) -> list[str]:
    """Return the names of a program's properties as `monitors` in a fleet file names them."""
    own = [p.name for p in program.properties if p.kind == "invariant" and p.name]
    own += [g.name for export in program.exports for g in export.guarantees if not is_step(g)]
    own += [f"assume {module.name}" for module in program.modules if module.assumptions]
    own += [f"requires {f.name}" for f in program.externs if f.requires]
    own += [f"ensures {f.name}" for f in program.externs if f.ensures]
    if any(isinstance(node, LoopInvariant) for node in walk((program.init, program.events, program.functions))):
        own.append("loop invariants")
    return own


def param_check(program: Program, name: str) -> ValueCheck:
    """Return a check of a param's value: it returns the reason why the value does not fit, or ""."""

    def misfit(value: Value) -> str:
        try:
            with_params(program, {name: value})
        except BadParam as bad:
            return str(bad)
        return ""

    return misfit
