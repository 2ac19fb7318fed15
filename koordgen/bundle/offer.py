"""Whether the targets offer the ports that a program uses: told at the `using` line, before anything is built."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from koordgen.diagnostics import Diagnostic
from koordgen.ir.decl import Module, Port, Program
from koordgen.manifest import Target


def check_ports(program: Program, targets: Iterable[Target]) -> list[Diagnostic]:
    """One diagnostic for each module or port that an agent target lacks or offers as something else."""
    agents = [t for t in targets if t.kind == "agent"]
    return [d for module in program.modules for target in agents for d in _module(module, target)]


def _module(module: Module, target: Target) -> Iterator[Diagnostic]:
    if module.name not in target.modules:
        offered = ", ".join(sorted(target.modules))
        message = f"target {target.name} offers no module {module.name}"
        yield Diagnostic("B001", "error", message, module.span, help=f"it offers: {offered}")
        return
    for port in module.ports:
        yield from _port(module, port, target)


def _port(module: Module, port: Port, target: Target) -> Iterator[Diagnostic]:
    name = f"{module.name}.{port.name}"
    same, other = (
        (target.sensors, target.actuators) if port.direction == "sensor" else (target.actuators, target.sensors)
    )
    if name in same and same[name] == str(port.type):
        return
    if name in same:
        message = f"{name} is of type {same[name]} on target {target.name}, not {port.type}"
        yield Diagnostic("B003", "error", message, port.span)
    elif name in other:
        right = "an actuator" if port.direction == "sensor" else "a sensor"
        yield Diagnostic(
            "B002", "error", f"{name} is {right} on target {target.name}, not a {port.direction}", port.span
        )
    else:
        offered = ", ".join(sorted(n for n in same if n.startswith(f"{module.name}."))) or "none"
        message = f"target {target.name} offers no {port.direction} {name}"
        yield Diagnostic("B002", "error", message, port.span, help=f"it offers: {offered}")
