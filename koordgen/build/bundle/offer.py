"""Whether the targets offer the ports that a program uses: told at the `using` line, before anything is built."""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator

from koordgen.fleet.manifest import Target
from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.ir.decl import Module, Port, Program
from koordgen.lang.ir.ports import NO_MEANING, spelled
from koordgen.lang.node import replace


def check_ports(program: Program, targets: Iterable[Target], driven: Container[str] = ()) -> list[Diagnostic]:
    """One diagnostic for each module or port that an agent target lacks or offers as something else; modules that are
    `driven` have drivers, and streams are everyone's."""
    agents = [t for t in targets if t.kind == "agent"]
    modules = [m for m in program.modules if m.name not in driven and any(p.direction != "stream" for p in m.ports)]
    return [d for module in modules for target in agents for d in _module(module, target)]


def _module(module: Module, target: Target) -> Iterator[Diagnostic]:
    if module.name not in target.modules:
        offered = ", ".join(sorted(target.modules))
        message = f"target {target.name} offers no module {module.name}"
        help = f"it offers: {offered}; a driver for another is named under 'modules:' in the fleet file"
        yield Diagnostic("B001", "error", message, module.span, help=help)
        return
    for port in module.ports:
        if port.direction == "stream":
            continue
        yield from _port(module, port, target)


def _meaning(module: Module, port: Port, target: Target) -> Iterator[Diagnostic]:
    """What the program does not declare may be cleared or not."""
    offered, known = target.meanings[f"{module.name}.{port.name}"], {p.name for p in module.ports}
    meant, wanted = (
        replace(meaning, clears=tuple(sorted([name for name in meaning.clears if name in known])))
        for meaning in (port.meaning, offered)
    )
    if meant != wanted:
        message = f"target {target.name} offers {port.type} {module.name}.{port.name} {spelled(wanted)}".rstrip()
        help = f"behind its name stands '{spelled(meant)}' here" if meant != NO_MEANING else "here nothing is said"
        yield Diagnostic("B010", "error", message, port.span, help=help)


_KINDS = {"sensor": "a sensor", "actuator": "an actuator", "callable": "a callable port"}


def _port(module: Module, port: Port, target: Target) -> Iterator[Diagnostic]:
    name, kind = f"{module.name}.{port.name}", _KINDS[port.direction]
    tables = {"sensor": target.sensors, "actuator": target.actuators, "callable": target.callables}
    same = tables.pop(port.direction)
    other = next((direction for direction, table in tables.items() if name in table), None)
    if name in same and same[name] == str(port.type):
        yield from _meaning(module, port, target)
        return
    if name in same:
        message = f"{name} is of type {same[name]} on target {target.name}, not {port.type}"
        yield Diagnostic("B003", "error", message, port.span)
    elif other is not None:
        message = f"{name} is {_KINDS[other]} on target {target.name}, not {kind}"
        yield Diagnostic("B002", "error", message, port.span)
    else:
        offered = ", ".join(sorted(n for n in same if n.startswith(f"{module.name}."))) or "none"
        message = f"target {target.name} offers no {kind.partition(' ')[2]} {name}"
        yield Diagnostic("B002", "error", message, port.span, help=f"it offers: {offered}")
