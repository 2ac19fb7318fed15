"""Checks of `export:` and `import Name:`, which connect the applications of a fleet.

To the rest of the compiler an importing program is an ordinary one. An imported variable is an allwrite variable; an
imported allread variable, which has a slot for each of the exporter's members, is a list that nobody writes. Two names
describe the members: the param `Name.N_SYS` is their number, the local variable `Name.pid` is this robot's place among
them, or -1. The composition of a fleet connects these names to the exporter.
"""

from __future__ import annotations

from collections.abc import Iterable

from koordgen.lang.check.base import condition, with_article
from koordgen.lang.check.context import Context, Entity, Temp
from koordgen.lang.check.names import enter, unique
from koordgen.lang.check.sections.declare import ImportedNames
from koordgen.lang.check.sections.function import specs
from koordgen.lang.check.types import resolve, with_capacities
from koordgen.lang.diagnostics import Label
from koordgen.lang.ir import decl
from koordgen.lang.ir.expr import Const
from koordgen.lang.ir.types import INT, MOST_ROBOTS, POISON, PerRobot, Sequence, Type
from koordgen.lang.source import Span
from koordgen.lang.syntax import decl as ast
from koordgen.lang.syntax import expr as tree
from koordgen.lang.syntax.types import BrokenType


def imports(sections: Iterable[ast.Import], c: Context) -> ImportedNames:
    """Define the names that all imports declare, in the order of the text."""
    found = ImportedNames()
    for section in sections:
        variables = [item for item in section.items if isinstance(item, ast.Imported)]
        typed = {node.name: (node, shared) for node in variables if (shared := _variable(node, section.name, c))}
        declared = specs([item for item in section.items if isinstance(item, ast.SpecFunction)], c)
        imported = decl.Import(
            section.name,
            tuple(typed),
            tuple([name for name, (node, _) in typed.items() if node.size is not None]),
            tuple([name for name, (node, _) in typed.items() if node.is_written]),
            tuple([spec.name for spec in declared]),
            section.span,
        )
        enter(section.name, section, imported, c)
        c.imported.update(dict.fromkeys(typed, imported))
        size = decl.Param(imported.size, INT, Const(1, INT, section.span), section.span)
        pid = decl.Local(imported.pid, INT, Const(-1, INT, section.span), section.span)
        found = ImportedNames(
            (*found.imports, imported),
            (*found.shared, *(shared for _, shared in typed.values())),
            (*found.specs, *declared),
            (*found.sizes, size),
            (*found.pids, pid),
        )
    return found


def _variable(node: ast.Imported, application: str, c: Context) -> decl.Shared | None:
    """Define an imported variable. Returns None if its declaration is wrong."""
    if isinstance(node.type, BrokenType):
        return None  # the parser only guessed the variable's name
    type_ = with_capacities(resolve(node.type, c), node.capacities, False, c)
    if type_ is not POISON and node.size is not None:
        type_ = Sequence("List", type_, MOST_ROBOTS) if _is_size_of(node, application, c) else POISON
    shared = decl.Shared(node.name, "allwrite", type_, c.poison(node.span), node.span)
    enter(node.name, node, None if type_ is POISON else shared, c)
    return shared if c.entities.get(node.name) is shared else None


def _is_size_of(node: ast.Imported, application: str, c: Context) -> bool:
    """Return whether the size of an imported variable is the number of the exporter's members; report other sizes."""
    size = node.size
    match size:
        case None | tree.Broken():
            return False
        case tree.Attribute(tree.Name(name), "N_SYS") if name == application:
            return True
    text = f"{application}.N_SYS"
    message = f"an imported allread variable has one value for each robot that runs {application}: {node.name}[{text}]"
    c.error("K060", message, size.span, f"write {text}")
    return False


def exports(sections: Iterable[ast.Export], c: Context) -> tuple[decl.Export, ...]:
    """Check the exported variables and their guarantees; return them in the order of the text."""
    found, seen, names = [], dict[str, Span](), dict[str, Span]()
    for section in sections:
        for node in section.variables:
            if isinstance(node.type, BrokenType):
                continue
            shared = _exported(node, c)
            is_first = unique(node.name, "exports", node.span, seen, c)
            guarantees = []
            for guarantee in node.guarantees:
                unique(guarantee.name, "guarantees", guarantee.span, names, c)
                if shared is not None:
                    guarantees.append(_guarantee(guarantee, shared, c))
            if shared is not None and is_first:
                found.append(decl.Export(node.name, node.is_written, tuple(guarantees), node.span))
    return tuple(found)


def _exported(node: ast.Exported, c: Context) -> decl.Shared | None:
    """Return the shared variable that is exported. Report an error if there is none, or its declaration differs."""
    type_ = resolve(node.type, c)
    shared = c.entities.get(node.name)
    if node.name in c.imported:
        message = f"{node.name} is imported from {c.imported[node.name].name} and cannot be exported"
        c.error("K060", message, node.span, "let other applications import it from the application that declares it")
        return None
    if not isinstance(shared, decl.Shared):
        if node.name not in c.entities and node.name not in c.broken:
            what = f"{c.text(node.type.span)} {node.name}"
            message = f"the exported variable {node.name} is not declared"
            c.error("K060", message, node.span, f"declare it: '{what}' under 'allwrite:' or 'allread:'")
        elif shared is not None:
            help = "only allread and allwrite variables can be exported"
            c.error("K060", f"{node.name} is not a shared variable", node.span, help, (_declared(shared),))
        return None
    if type_ is POISON or shared.type is POISON:
        return None
    if type_ != shared.type:
        message = f"the exported {node.name} is {with_article(shared.type)}, not {with_article(type_)}"
        c.error("K060", message, node.type.span, f"write {shared.type}", (_declared(shared),))
        return None
    return shared if _agrees_in_size(node, shared, c) else None


def _agrees_in_size(node: ast.Exported, shared: decl.Shared, c: Context) -> bool:
    """Return whether an export has a size if and only if its variable is allread; report an error otherwise."""
    is_allread = shared.kind == "allread"
    if node.is_written and is_allread:
        message = f"{node.name} is allread: a robot writes only its own slot, so no other application can write it"
        c.error("K060", message, node.span, "leave out 'write'", (_declared(shared),))
        return False
    if isinstance(node.size, tree.Broken):
        return False
    if is_allread and not (isinstance(node.size, tree.Name) and node.size.name == "N_SYS"):
        message = f"the exported {node.name} is allread: it has a value for each robot"
        span = node.span if node.size is None else node.size.span
        c.error("K060", message, span, f"write {shared.type} {node.name}[N_SYS]", (_declared(shared),))
        return False
    if node.size is not None and not is_allread:
        message = f"the exported {node.name} is allwrite: it has one value"
        c.error("K060", message, node.size.span, f"write {shared.type} {node.name}", (_declared(shared),))
        return False
    return True


def _declared(entity: Entity) -> Label:
    return Label(entity.span, "declared here")


def _guarantee(node: ast.Guarantee, shared: decl.Shared, c: Context) -> decl.Guarantee:
    """Check a guarantee. It reads its variable as a temp, and the value after a write as a second one."""
    c.enter("guarantee")
    c.guaranteed = shared.name
    type_: Type = PerRobot(shared.type) if shared.kind == "allread" else shared.type
    before, after = (Temp(c.mint(name), type_, shared.span) for name in (shared.name, f"{shared.name}'"))
    c.scopes[0] |= {before.unique: before, after.unique: after}
    formula = condition(node.formula, c, f"the guarantee {node.name}")
    return decl.Guarantee(node.name, before.unique, after.unique, formula, node.span)
