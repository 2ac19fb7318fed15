"""Both checks of a program: the first resolves names and types and produces IR, the second analyses this IR.

The second check also runs after errors of the first, on the parts of the program that have a type. Rules that few
programs need are imported on demand, because importing them takes long compared with the time of a check.
"""

from __future__ import annotations

from koordgen.lang.analyze.events import analyze_events
from koordgen.lang.analyze.expressions import analyze_expression
from koordgen.lang.analyze.rules.analysis import Analysis
from koordgen.lang.analyze.rules.first_value import check_initial_value
from koordgen.lang.analyze.statements import analyze_block
from koordgen.lang.check.sections.program import resolve
from koordgen.lang.diagnostics import Diagnostic, in_order
from koordgen.lang.ir import decl
from koordgen.lang.ir.draft import Section
from koordgen.lang.ir.expr import Expr
from koordgen.lang.ir.types import BOOL, Type
from koordgen.lang.node import replace
from koordgen.lang.source import Source
from koordgen.lang.syntax import decl as ast
from koordgen.lang.syntax.walk import is_whole


def check(program: ast.Program, source: Source) -> tuple[decl.Program | None, list[Diagnostic]]:
    """Return the typed program, or None if there are errors, and all diagnostics in the order of the text."""
    draft, found = resolve(program, source)
    a = Analysis(source, draft)
    a.found = found
    checked = analyze(draft, program, a)
    ordered = in_order(a.found)
    return (None if any(d.severity == "error" for d in ordered) else checked), ordered


def analyze(program: decl.Program, text: ast.Program, a: Analysis) -> decl.Program:
    """Analyse a program that still has draft nodes (`ir.draft`), and return it without draft nodes."""
    records = tuple([_record(record, a) for record in program.records])
    params = tuple([replace(p, default=_initial_value(p.name, p.default, p.type, a)) for p in program.params])
    shared = tuple([replace(v, initial=_initial_value(v.name, v.initial, v.type, a)) for v in program.shared])
    locals_ = tuple([replace(v, initial=_initial_value(v.name, v.initial, v.type, a)) for v in program.locals])
    functions = tuple([_function(function, a) for function in program.functions])
    externs = tuple([_contract(function, a) for function in program.externs])
    a.enter("init")
    init = analyze_block(program.init, a)
    events, locks = _events(program.events, shared, a)
    properties = tuple([replace(p, formula=_formula(p.formula, "property", a)) for p in program.properties])
    modules = tuple([_module(module, a) for module in program.modules])
    exports = tuple([_export(export, a) for export in program.exports])
    checked = decl.Program(
        program.name, program.path, records, program.extern_types, functions, externs, program.specs, params, modules,
        shared, locals_, locks, init, events, properties, exports, program.imports,
        tuple([_provides(module, a) for module in program.provides]),
    )  # fmt: skip
    if any(variable.type is BOOL for variable in locals_):
        from koordgen.lang.analyze.rules.waiting import check_waiting

        check_waiting(checked, lambda: is_whole(text), a)
    return checked


def _events(
    written: tuple[decl.Event, ...], shared: tuple[decl.Shared, ...], a: Analysis
) -> tuple[tuple[decl.Event, ...], tuple[tuple[str, ...], ...]]:
    """Return the events, and the groups of shared variables that have a common lock."""
    analyzed = analyze_events(written, a)
    if all(atomic is None for _, atomic in analyzed):
        return tuple([event for event, _ in analyzed]), ()
    from koordgen.lang.analyze.locks import with_locks

    return with_locks(analyzed, shared, a)


def _initial_value(name: str, value: Expr, type_: Type, a: Analysis) -> Expr:
    """Analyse the initial value of a param, a variable or a field."""
    before = len(a.found)
    value = _formula(value, "constant", a)
    if not a.has_errors(before):
        check_initial_value(name, value, type_, a)
    return value


def _record(record: decl.Record, a: Analysis) -> decl.Record:
    fields = zip(record.type.fields, record.defaults, strict=True)
    return replace(record, defaults=tuple([_initial_value(name, value, type_, a) for (name, type_), value in fields]))


def _function(function: decl.Function, a: Analysis) -> decl.Function:
    a.enter("function")
    block = analyze_block(function.block, a)
    if a.path is not None:
        from koordgen.lang.analyze.rules.missing_return import check_end

        check_end(function, a)
    return replace(function, block=block)


def _contract(function: decl.ExternFunction, a: Analysis) -> decl.ExternFunction:
    a.enter("contract")
    requires = tuple([analyze_expression(formula, a) for formula in function.requires])
    return replace(
        function, requires=requires, ensures=tuple([analyze_expression(formula, a) for formula in function.ensures])
    )


def _module(module: decl.Module, a: Analysis) -> decl.Module:
    if not module.assumptions:
        return module
    assumed = [replace(item, formula=_formula(item.formula, "assume", a)) for item in module.assumptions]
    return replace(module, assumptions=tuple(assumed))


def _export(export: decl.Export, a: Analysis) -> decl.Export:
    guarantees = [replace(each, formula=_formula(each.formula, "guarantee", a)) for each in export.guarantees]
    return replace(export, guarantees=tuple(guarantees))


def _provides(module: decl.Provides, a: Analysis) -> decl.Provides:
    ports = [replace(each, value=_formula(each.value, "provided", a)) for each in module.ports]
    return replace(module, ports=tuple(ports))


def _formula(formula: Expr, place: Section, a: Analysis) -> Expr:
    a.enter(place)
    return analyze_expression(formula, a)
