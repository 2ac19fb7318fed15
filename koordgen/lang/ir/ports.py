"""Meaning of ports, for all back ends: own position, values before a command, sensors that it clears.

A port's meaning is part of its declaration (`decl.Meaning`). USUAL has it for ports that declare none. Functions here
take and return names of the form "Module.port".
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import Final

from koordgen.lang.ir.decl import Meaning, Module, Port, Program
from koordgen.lang.ir.types import BOOL, POINT

NO_MEANING: Final = Meaning(False, "", ())
_DECLARED: Final = re.compile(r"(.*?)( as position)?(?: at (\w+))?(?: clears (\w+(?:, \w+)*))?")
USUAL: Final = {
    ("sensor", "position"): Meaning(True, "", ()),
    ("actuator", "target"): Meaning(False, "position", ("reached",)),
    ("actuator", "path"): Meaning(False, "", ("reached",)),
}


def usual(port: Port, module: Iterable[Port]) -> Meaning:
    """Return the meaning of a port that declares none: by its name, as far as the types fit."""
    found = USUAL.get((port.direction, port.name), NO_MEANING)
    sensors = {p.name: p.type for p in module if p.direction == "sensor"}
    held = found.held if port.type == POINT and sensors.get(found.held, POINT) == POINT else ""
    clears = tuple([name for name in found.clears if sensors.get(name, BOOL) == BOOL])
    return Meaning(found.is_position and port.type == POINT, held, clears)


def declared(text: str) -> tuple[str, Meaning]:
    """Return type and meaning of a port from a declaration as in a program, but without the port's name."""
    found = _DECLARED.fullmatch(text)
    assert found is not None, "each text fits"
    type_, place, held, clears = found.groups()
    return type_, Meaning(place is not None, held or "", tuple((clears or "").split(", ")) if clears else ())


def spelled(meaning: Meaning) -> str:
    """Return a meaning as a program writes it after a port's name."""
    parts = ["as position"] if meaning.is_position else []
    parts += [f"at {meaning.held}"] if meaning.held else []
    parts += [f"clears {', '.join(meaning.clears)}"] if meaning.clears else []
    return " ".join(parts)


def ports(program: Program) -> Iterator[tuple[str, Module, Port]]:
    """Yield each port under its full name, with its module."""
    for module in program.modules:
        for port in module.ports:
            yield f"{module.name}.{port.name}", module, port


def positions(program: Program) -> tuple[str, ...]:
    """Return the sensors that are the robot's own position."""
    return tuple([name for name, _, port in ports(program) if port.meaning.is_position])


def position_beside(program: Program, name: str) -> str:
    """Return the sensor of the robot's position in the module of a port; "" if the module has none."""
    module = name.partition(".")[0]
    return next((place for place in positions(program) if place.partition(".")[0] == module), "")


def held(program: Program) -> dict[str, str]:
    """Return the actuators that hold at a sensor's value, with that sensor.

    The program need not declare it.
    """
    return {name: f"{m.name}.{port.meaning.held}" for name, m, port in ports(program) if port.meaning.held}


def clears(program: Program) -> dict[str, tuple[str, ...]]:
    """Return the sensors that a command makes false, for each actuator that has such sensors."""
    known = {name for name, _, port in ports(program) if port.direction == "sensor"}
    found = {}
    for name, module, port in ports(program):
        cleared = tuple([s for each in port.meaning.clears if (s := f"{module.name}.{each}") in known])
        if cleared:
            found[name] = cleared
    return found


def clearable(program: Program) -> frozenset[str]:
    """Return the sensors that commands make false. They are true before the first command."""
    return frozenset([sensor for cleared in clears(program).values() for sensor in cleared])
