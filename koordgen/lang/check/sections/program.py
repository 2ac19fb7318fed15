"""First check of a whole program: names, then types and signatures, then initial values and bodies.

Because of this order, sections may stand anywhere in the text. `init` and the events are checked in the order of the
text.
"""

from __future__ import annotations

import os
from typing import Any, NamedTuple

from koordgen.lang.check.context import Context
from koordgen.lang.check.names import claim_names
from koordgen.lang.check.sections.declare import (
    ImportedNames,
    extern_types,
    param_defaults,
    param_types,
    record_defaults,
    record_types,
    variable_initials,
    variable_types,
)
from koordgen.lang.check.sections.events import events, in_text_order, lone_priorities
from koordgen.lang.check.sections.modules import assumptions, modules
from koordgen.lang.check.statements.stmt import check_block
from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.ir import decl
from koordgen.lang.ir.stmt import Block
from koordgen.lang.source import Source, Span
from koordgen.lang.syntax import decl as ast


class ResolvedProgram(NamedTuple):
    """Result of the first check: a program with resolved names and types that still has draft nodes (`ir.draft`)."""

    program: decl.Program
    found: list[Diagnostic]


def resolve(program: ast.Program, source: Source) -> ResolvedProgram:
    """Resolve names and types: the first of the two checks of a program."""
    c = Context(source, program)
    return ResolvedProgram(_program(program, c), c.found)


def _program(program: ast.Program, c: Context) -> decl.Program:
    sections: dict[type, list[Any]] = {}
    for section in program.sections:
        sections.setdefault(type(section), []).append(section)

    def of(kind: type) -> list[Any]:
        return sections.get(kind, [])

    claim_names(program, c)
    opaque = extern_types(of(ast.ExternType), c)
    fields = record_types(of(ast.RecordDef), c)
    param_types(of(ast.Param), c)
    typed = variable_types(of(ast.Variables), c)
    ports = modules(of(ast.Using), c)
    imported = _imports(of(ast.Import), c)
    functions: tuple[decl.Function, ...] = ()
    externs: tuple[decl.ExternFunction, ...] = ()
    specs = imported.specs
    written = of(ast.Function), of(ast.ExternFunction), of(ast.SpecFunction)
    if any(written):
        from koordgen.lang.check.sections import function

        specs = (*function.specs(written[2], c), *specs)
        for node in written[1]:
            function.signature(node, c)
        signed = [(node, function.signature(node, c)) for node in written[0]]
    records = record_defaults(fields, c)
    params = param_defaults(of(ast.Param), c)
    shared, locals_ = variable_initials(typed, imported, c)
    if any(written):
        functions = function.check_bodies(signed, c)
        externs = function.externs(written[1], c)
    init = _init(of(ast.Init), c)
    if not sections.keys() & {ast.Event, ast.Priority, ast.BrokenSection}:
        c.error("K019", "the program has no event", Span(1, 1, 1, 1), "write 'Name:' with 'pre:' and 'eff:' under it")
    lone_priorities(of(ast.Priority), c)
    acting = events(in_text_order(program.sections), c)
    properties: tuple[decl.Property, ...] = ()
    if ast.Property in sections:
        from koordgen.lang.check.property import properties as check_properties

        properties = check_properties(of(ast.Property), c)
    assuming = assumptions(of(ast.Using), ports, c)
    exports: tuple[decl.Export, ...] = ()
    if ast.Export in sections:
        from koordgen.lang.check.sections.interface import exports as check_exports

        exports = check_exports(of(ast.Export), c)
    provides: tuple[decl.Provides, ...] = ()
    if ast.Provides in sections:
        from koordgen.lang.check.sections.provides import provides as check_provides

        provides = check_provides(of(ast.Provides), c)
    path = os.path.basename(c.source.path)
    return decl.Program(
        os.path.splitext(path)[0], path, records, opaque, functions, externs, specs, (*params, *imported.sizes),
        assuming, shared, locals_, (), init, acting, properties, exports, imported.imports, provides,
    )  # fmt: skip


def _imports(sections: list[ast.Import], c: Context) -> ImportedNames:
    """Define the names that imports declare. Few programs have imports, so their check is loaded on demand."""
    if not sections:
        return ImportedNames()
    from koordgen.lang.check.sections.interface import imports

    return imports(sections, c)


def _init(sections: list[ast.Init], c: Context) -> Block:
    """Check all `init` sections and join them into one block, in the order of the text."""
    c.enter("init")
    return tuple([statement for section in sections for statement in check_block(section.block, c)])
