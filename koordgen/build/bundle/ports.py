"""Port check: reports ports of the program that a target does not offer, at their `using` block."""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator

from koordgen.fleet.manifest import Target
from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.ir.decl import Module, Port, Program
from koordgen.lang.ir.ports import NO_MEANING, spelled
from koordgen.lang.node import replace


def check_ports(program: Program, targets: Iterable[Target], driven: Container[str] = ()) -> list[Diagnostic]:
    """Return a diagnostic for each module or port that an agent target does not offer in the declared form.

    Not checked: modules in `driven`, which have drivers, and streams, which every target offers.
    """
    agents = [t for t in targets if t.kind == "agent"]
    modules = [m for m in program.modules if m.name not in driven and any(p.direction != "stream" for p in m.ports)]
    return [d for module in modules for target in agents for d in _module(module, target)]


def _module(module: Module, target: Target) -> Iterator[Diagnostic]:
    if module.name not in target.modules:
        offered = ", ".join(sorted(target.modules))
        message = f"target {target.name} offers no module {module.name}"
        help = f"it offers: {offered}; for another module, name a driver under 'modules:' in the fleet file"
        yield Diagnostic("B001", "error", message, module.span, help=help)
        return
    for port in module.ports:
        if port.direction == "stream":
            continue
        yield from _port(module, port, target)


def _meaning(module: Module, port: Port, target: Target) -> Iterator[Diagnostic]:
    """Compare the meaning of a port in the program with that of the target.

    Sensors that the program does not declare are left out of the target's `clears` before the comparison.
    """
    offered, known = target.meanings[f"{module.name}.{port.name}"], {p.name for p in module.ports}
    meant, wanted = (
        replace(meaning, clears=tuple(sorted([name for name in meaning.clears if name in known])))
        for meaning in (port.meaning, offered)
    )
    if meant != wanted:
        message = f"target {target.name} declares {port.type} {module.name}.{port.name} {spelled(wanted)}".rstrip()
        written = f"'{spelled(meant)}'" if meant != NO_MEANING else "nothing"
        if wanted == NO_MEANING:
            help = f"the program has {written} after the port's name: remove it"
        else:
            help = f"the program has {written} after the port's name: write '{spelled(wanted)}' there"
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
        message = f"{name} has type {same[name]} on target {target.name}, but {port.type} in the program"
        yield Diagnostic("B003", "error", message, port.span, help=f"declare it as {same[name]}")
    elif other is not None:
        message = f"{name} is {_KINDS[other]} on target {target.name}, but {kind} in the program"
        yield Diagnostic("B002", "error", message, port.span, help=f"declare it as {_KINDS[other]}")
    else:
        offered = ", ".join(sorted(n for n in same if n.startswith(f"{module.name}."))) or "none"
        message = f"target {target.name} offers no {kind.partition(' ')[2]} {name}"
        yield Diagnostic("B002", "error", message, port.span, help=f"it offers: {offered}")
