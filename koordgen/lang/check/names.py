"""Assignment of names to their declarations, with errors for names that are declared twice or predefined.

Variables, params, modules, imports, functions, records and extern types share one namespace.
"""

from __future__ import annotations

from koordgen.lang.check.context import PREDEFINED, Context, Entity
from koordgen.lang.diagnostics import Label
from koordgen.lang.ir.builtins import FUNCTIONS
from koordgen.lang.source import Span
from koordgen.lang.syntax import decl as ast
from koordgen.lang.syntax.types import BrokenType

Owner = (
    ast.Variable | ast.Param | ast.Using | ast.RecordDef | ast.ExternType | ast.Function | ast.ExternFunction
    | ast.SpecFunction | ast.Import | ast.Imported
)  # fmt: skip


def claim_names(program: ast.Program, c: Context) -> None:
    """Assign each name to its first declaration in the text, and report every further declaration of the name.

    If two declarations of a name differ, or the name is predefined, uses of the name are ambiguous, and no errors about
    them are reported.
    """
    kinds: dict[str, str] = {}  # name of a variable -> its kind: local, allread or allwrite
    for section in program.sections:
        match section:
            case ast.Variables(kind, variables):
                for variable in variables:
                    if not isinstance(variable.type, BrokenType):  # else the name is only the parser's guess
                        _claim(variable.name, variable, kind, kinds, c)
            case ast.Using(name):
                if not isinstance(c.owners.get(name), ast.Using):
                    _claim(name, section, "", kinds, c)
            case ast.Event(name):
                c.owners[f"event {name}"] = section  # an event and a variable may have the same name
            case ast.Priority(events):
                for event in events:
                    c.owners[f"event {event.name}"] = event
            case ast.Import(name, items):
                _claim(name, section, "", kinds, c)
                for item in items:
                    if not (isinstance(item, ast.Imported) and isinstance(item.type, BrokenType)):
                        _claim(item.name, item, "imported", kinds, c)
            case (
                ast.Init()
                | ast.Property()
                | ast.Export()
                | ast.Provides()
                | ast.BrokenSection()
                | ast.Param(BrokenType())
            ):
                pass
            case _:
                _claim(section.name, section, "", kinds, c)


def _claim(name: str, node: Owner, kind: str, kinds: dict[str, str], c: Context) -> None:
    if is_reserved(name):
        c.error("K011", f"{name} is predefined", node.span, "choose another name")
        c.entities[name] = None
        return
    first = c.owners.setdefault(name, node)
    if first is node:
        kinds[name] = kind
        return
    label = Label(first.span, "declared here first")  # type: ignore[attr-defined]
    c.error("K011", f"{name} is declared twice", node.span, "choose another name", (label,))
    alike = isinstance(first, ast.Variable) and isinstance(node, ast.Variable) and first.type == node.type
    if not (alike and kinds[name] == kind):
        c.entities[name] = None


def is_reserved(name: str) -> bool:
    """Return whether a name is reserved: no declaration may have it.

    Names of builtin functions are not reserved, as in Python, because programs of the 2020 dialect have variables
    called `sum`. Names of types are reserved, even if they are called like functions, as `Point` is.
    """
    return name in PREDEFINED and not (name in FUNCTIONS and name.islower())


def is_owner(name: str, node: Owner, c: Context) -> bool:
    """Return whether a name belongs to this declaration, and not to an earlier one."""
    return c.owners.get(name) is node


def enter(name: str, node: Owner, entity: Entity | None, c: Context) -> None:
    """Record the entity that a declaration defines, if the name belongs to this declaration.

    The entity is None if the declaration is wrong.
    """
    if c.owners.get(name) is node and c.entities.get(name, c) is not None:
        c.entities[name] = entity


def unique(name: str, what: str, span: Span, seen: dict[str, Span], c: Context) -> bool:
    """Add a name to `seen`, such as a field of a record, and return whether the name is new.

    Reports a name that is already in `seen`.
    """
    first = seen.setdefault(name, span)
    if first is span:
        return True
    labels = (Label(first, "here first"),)
    c.error("K011", f"there are two {what} called {name}", span, "choose another name", labels)
    return False
