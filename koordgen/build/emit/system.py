"""Composition of a fleet -> text of `applications.py`, the module that names all applications for the agent."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from types import MappingProxyType

from koordgen.build.emit.expr import literal
from koordgen.build.emit.program import WIRE_FORMAT, digest, interface_hash, program_hash
from koordgen.lang.analyze.params import with_params
from koordgen.lang.ir.encoding import encode
from koordgen.lang.node import replace
from koordgen.lang.semantics.composition import Application, System

EQUAL_SHARES: Mapping[str, float] = MappingProxyType({})


def with_sizes(system: System) -> System:
    """Return the system with the number of the exporter's members as the value of each param `Name.N_SYS`."""
    applications = []
    for index, application in enumerate(system.applications):
        sizes = {
            each.size: len(system.applications[system.exporter(index, each)].members)
            for each in application.program.imports
        }
        applications.append(replace(application, program=with_params(application.program, sizes)))
    return replace(system, applications=tuple(applications))


def is_alone(system: System) -> bool:
    """Return whether the fleet has one application on all robots, so that its bundles are those of a program."""
    return len(system.applications) == 1 and len(system.applications[0].members) == system.robots


def system_hash(system: System, functions: Sequence[bytes] = ()) -> str:
    """Return a hash, 16 hexadecimal digits, of all applications: their names, programs, members and bindings.

    functions: content of each application's functions file; empty if no application has such a file.
    With one application on all robots, this is the hash of its program.
    """
    given = functions or [b""] * len(system.applications)
    hashes = [program_hash(a.program, f) for a, f in zip(system.applications, given, strict=True)]
    if is_alone(system):
        return hashes[0]
    parts = tuple([(a.name, h, a.members, a.bindings) for a, h in zip(system.applications, hashes, strict=True)])
    return digest(encode("system", system.robots, parts))


def system_interface_hash(system: System) -> str:
    """Return a hash, 16 hexadecimal digits, of the wire format and the shared variables of all applications."""
    if is_alone(system):
        return interface_hash(system.applications[0].program)
    parts = tuple(
        [
            (a.name, a.members, tuple([(v.name, v.kind, v.type) for v in system.own(index)]))
            for index, a in enumerate(system.applications)
        ]
    )
    return digest(encode("interface", WIRE_FORMAT, parts))


def module_of(application: Application) -> str:
    """Return the end of the names of an application's modules, such as `program_mapping`."""
    return re.sub(r"\W", "_", application.name)


def applications_text(
    system: System, functions: Sequence[bytes] = (), shares: Mapping[str, float] = EQUAL_SHARES
) -> str:
    """Return the text of `applications.py`, which defines FLEET.

    shares: name of an application -> part of the time for events that it may use. An application that is not named
        shares the rest equally with others.
    """
    names = "FleetApplication, FleetProgram, ImportBinding"
    if not any(application.program.imports for application in system.applications):
        names = "FleetApplication, FleetProgram"
    lines = ['"""Applications of this fleet: programs, members, and the bindings of their imports."""', ""]
    lines += [f"from koordgen.runtime.program.fleet_program import {names}", ""]
    lines += [f"import program_{module_of(application)}" for application in system.applications]
    lines += ["", "FLEET = FleetProgram(", "    applications=("]
    for index, application in enumerate(system.applications):
        own = functions[index] if functions else b""
        lines += _application(system, index, shares.get(application.name), program_hash(application.program, own))
    lines += [
        "    ),",
        f"    robots={system.robots},",
        f'    program_hash="{system_hash(system, functions)}",',
        f'    interface_hash="{system_interface_hash(system)}",',
        ")",
        "",
    ]
    return "\n".join(lines)


def _application(system: System, index: int, share: float | None, hash_: str) -> list[str]:
    application, locks = system.applications[index], system.locks()
    own = tuple([locks[index, lock] for lock in range(len(application.program.locks))])
    lines = [
        "        FleetApplication(",
        f"            name={literal(application.name)},",
        f"            program=program_{module_of(application)}.PROGRAM,",
        f"            members={application.members},",
    ]
    if application.program.imports:
        lines.append("            imports=(")
        for each in application.program.imports:
            bound = [str(system.exporter(index, each)), _tuple(each.variables), _tuple(each.written)]
            lines.append(f"                ImportBinding({', '.join([literal(each.name), *bound])}),")
        lines.append("            ),")
    lines += [f"            locks={own},", f"            share={share},", f'            program_hash="{hash_}",']
    return [*lines, "        ),"]


def _tuple(names: Sequence[str]) -> str:
    """Return the Python text of a tuple whose items are these texts."""
    return f"({', '.join(literal(name) for name in names)}{',' if len(names) == 1 else ''})"
