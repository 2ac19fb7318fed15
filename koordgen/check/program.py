"""A whole program: declarations in any order, then init, then the events in the order of their writing."""

from __future__ import annotations

import os

from koordgen.check import bounds, linear
from koordgen.check.context import PREDEFINED, Context, Entity
from koordgen.check.decide import unsat
from koordgen.check.expr import check_expr, condition, fitting
from koordgen.check.facts import Flow, formula, term
from koordgen.check.stmt import check_block, default
from koordgen.diagnostics import Diagnostic, Label, in_order
from koordgen.ir import decl, expr
from koordgen.ir.stmt import Block
from koordgen.ir.types import BOOL, INT, POISON
from koordgen.source import Source, Span
from koordgen.syntax import decl as ast
from koordgen.syntax import expr as tree


def check(program: ast.Program, source: Source) -> tuple[decl.Program | None, list[Diagnostic]]:
    """The typed program, or None where there are errors; and all that was found, in the order of the text."""
    c = Context(source)
    modules = _modules(program, c)
    params = [_param(s, c) for s in program.sections if isinstance(s, ast.Param)]
    shared, locals_ = _variables(program, c)
    init = tuple(s for section in program.sections if isinstance(section, ast.Init) for s in _init(section, c))
    written = [s for s in program.sections if isinstance(s, ast.Event)]
    if not written:
        c.error("K019", "the program has no event", Span(1, 1, 1, 1), "write 'Name:' with 'pre:' and 'eff:' under it")
    events = _events(written, c)
    found = in_order(c.found)
    if any(d.severity == "error" for d in found):
        return None, found
    path = os.path.basename(source.path)
    checked = decl.Program(
        os.path.splitext(path)[0], path, tuple(params), modules, tuple(shared), tuple(locals_), init, tuple(events)
    )
    return checked, found


def _declared(name: str, span: Span, c: Context) -> bool:
    """Whether a name is free; a second declaration is reported and leaves the first."""
    if name in PREDEFINED:
        c.error("K011", f"{name} is predefined", span, "choose another name")
        return False
    if name in c.entities:
        first = c.entities[name]
        labels = (Label(first.span, "declared here first"),) if first is not None else ()
        c.error("K011", f"{name} is declared twice", span, "choose another name", labels)
        return False
    return True


def _enter(name: str, entity: Entity, c: Context) -> None:
    """Make a declaration known; one of a wrong type is known as wrong."""
    wrong = not isinstance(entity, decl.Module) and entity.type == POISON
    c.entities[name] = None if wrong else entity


def _modules(program: ast.Program, c: Context) -> tuple[decl.Module, ...]:
    """Modules of one name are one."""
    modules: dict[str, decl.Module] = {}
    for section in program.sections:
        if not isinstance(section, ast.Using):
            continue
        known = modules.get(section.name)
        if known is None and not _declared(section.name, section.span, c):
            continue
        ports = list(known.ports) if known else []
        for group in section.groups:
            for port in group.ports:
                first = next((p for p in ports if p.name == port.name), None)
                if first is not None:
                    label = Label(first.span, "declared here first")
                    c.error(
                        "K011", f"the port {section.name}.{port.name} is declared twice", port.span, labels=(label,)
                    )
                    continue
                type_ = c.type_named(port.type, port.type_span)
                ports.append(decl.Port(port.name, type_, group.direction, port.span))
        modules[section.name] = decl.Module(section.name, tuple(ports), known.span if known else section.span)
        c.entities[section.name] = modules[section.name]
    return tuple(modules.values())


def _param(node: ast.Param, c: Context) -> decl.Param:
    free = _declared(node.name, node.span, c)
    type_ = c.type_named(node.type, node.type_span)
    value = _constant(node.default, c, "a param's default cannot depend on another param")
    value = fitting(value, type_, node.name, c)
    param = decl.Param(node.name, type_, value, node.span)
    if free:
        _enter(node.name, param, c)
        known = term(value, Flow()) if value.type == INT else None
        if known is not None and not known.terms:
            c.defaults[f"param {node.name}"] = known.constant
    return param


def _constant(node: tree.Expr, c: Context, no_params: str = "") -> expr.Expr:
    """An initial value: literals, builtins, and params unless a message says why not."""
    c.enter("constant")
    for name in _names(node) if no_params else ():
        if isinstance(c.entities.get(name.name), decl.Param):
            return c.error("K025", no_params, name.span)
    return check_expr(node, c)


def _names(node: tree.Expr) -> list[tree.Name]:
    found: list[tree.Name] = []
    pending: list[object] = [node]
    while pending:
        item = pending.pop()
        if isinstance(item, tree.Name):
            found.append(item)
        elif isinstance(item, tuple):
            pending.extend(item)
        elif isinstance(item, tree.Expr):
            pending.extend(getattr(item, f) for f in type(item).__match_args__)
    return found


def _variables(program: ast.Program, c: Context) -> tuple[list[decl.Shared], list[decl.Local]]:
    shared: list[decl.Shared] = []
    locals_: list[decl.Local] = []
    for section in program.sections:
        if not isinstance(section, ast.Variables):
            continue
        for node in section.variables:
            free = _declared(node.name, node.span, c)
            type_ = c.type_named(node.type, node.type_span)
            _check_size(node, section.kind, c)
            initial = default(type_, node.span) if node.initial is None else _constant(node.initial, c)
            initial = fitting(initial, type_, node.name, c)
            entity: decl.Shared | decl.Local
            if section.kind == "local":
                entity = decl.Local(node.name, type_, initial, node.span)
                locals_.append(entity)
            else:
                entity = decl.Shared(node.name, section.kind, type_, initial, node.span)
                shared.append(entity)
            if free:
                _enter(node.name, entity, c)
    return shared, locals_


def _check_size(node: ast.Variable, kind: str, c: Context) -> None:
    per_robot = isinstance(node.size, tree.Name) and node.size.name == "N_SYS"
    if kind == "allread" and not per_robot:
        span = node.size.span if node.size is not None else node.span
        message = f"an allread variable has one value for each robot: {node.name}[N_SYS]"
        c.error("K017", message, span, f"write {node.type} {node.name}[N_SYS]")
    if kind != "allread" and node.size is not None:
        c.error("K003", f"an array under '{kind}:' is not supported by this version yet", node.size.span)


def _init(section: ast.Init, c: Context) -> Block:
    c.enter("init")
    return check_block(section.block, c)


def _events(written: list[ast.Event], c: Context) -> list[decl.Event]:
    events: list[decl.Event] = []
    names: dict[str, Span] = {}
    hiding: ast.Event | None = None
    for node in written:
        if node.name in names:
            labels = (Label(names[node.name], "here first"),)
            c.error("K011", f"there are two events called {node.name}", node.span, "choose another name", labels)
        names.setdefault(node.name, node.span)
        event, always = _event(node, hiding, c)
        if event is not None:
            events.append(event)
        if always and hiding is None:
            hiding = node
    return events


def _event(node: ast.Event, hiding: ast.Event | None, c: Context) -> tuple[decl.Event | None, bool]:
    """The event, and whether its guard always holds."""
    guards = [g for g in node.clauses if isinstance(g, ast.Guard)]
    effects = [e for e in node.clauses if isinstance(e, ast.Effect)]
    for clauses, word in ((guards, "pre"), (effects, "eff")):
        if len(clauses) != 1:
            many = "no" if not clauses else "more than one"
            span = clauses[1].span if clauses else node.span
            c.error("K019", f"the event {node.name} has {many} '{word}:'", span, f"each event has one '{word}:'")
    if not guards or not effects:
        return None, False
    c.enter("guard")
    assert c.flow is not None
    guard = condition(guards[0].condition, c, "a guard")
    known = formula(guard, c.flow) if guard.type == BOOL else linear.UNKNOWN
    sound, always = not c.refuted, False
    if hiding is not None:
        labels = (Label(hiding.span, "always enabled, and earlier"),)
        c.warn(
            "K042",
            f"the event {node.name} can never run: {hiding.name} is always chosen first",
            node.span,
            labels=labels,
        )
    elif guard.type == BOOL and known != linear.UNKNOWN:
        if unsat((known,)):
            c.warn("K041", f"the event {node.name} can never run: its guard never holds", guards[0].condition.span)
        always = unsat((linear.negate(known),))
    c.place = "effect"
    c.poisoned = guard.type != BOOL
    c.sites, c.refuted = [], []
    c.guard = known
    c.guard_text = c.text(guards[0].condition.span)
    c.flow = c.flow.knowing(known)
    effect = check_block(effects[0].block, c)
    if sound:
        bounds.help_by_negation(c)
    return decl.Event(node.name, guard, effect, node.span), always
