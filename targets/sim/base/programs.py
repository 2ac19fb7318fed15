"""Programs of a bundle: its only program, or the applications of its fleet, with their properties."""

from __future__ import annotations

import importlib
from collections.abc import Collection
from pathlib import Path

from koordgen.runtime.agent.squad import Squad
from koordgen.runtime.program.fleet_program import FleetProgram
from koordgen.runtime.program.program import Program, Transaction
from koordgen.runtime.program.property import Properties, properties_of, without_properties

# A program with its properties, or all applications of a fleet with their properties by the application's name.
LoadedPrograms = tuple[Program, Properties] | tuple[FleetProgram, dict[str, Properties]]


class Unhosted:
    """Events of an application that hosts a squad's agent, where none runs. Implements HostEvents."""

    def may_claim(self, s: Transaction) -> bool:
        return False

    def claim(self, s: Transaction) -> None:
        """Do nothing."""

    def has_unwritten(self, s: Transaction) -> bool:
        return False

    def write(self, s: Transaction) -> None:
        """Do nothing."""


def with_outer(bundle: Path, fleet: FleetProgram, robots: int) -> FleetProgram:
    """Return the programs of a fleet with the application of the outer program, if the fleet is a squad.

    `bundle`: see load_programs. `robots`: number of robots of the outer fleet."""
    if not (bundle / "squad.py").is_file():
        return fleet
    squad: Squad = importlib.import_module("squad").SQUAD
    return squad.with_outer(fleet, robots, Unhosted())


def load_programs(bundle: Path, driven: Collection[str] = ()) -> LoadedPrograms:
    """Import the programs of a bundle, whose folder must be first in `sys.path`.

    `driven`: modules that the user's drivers serve. Raises whatever imports raise."""
    if not (bundle / "applications.py").is_file():
        program: Program = importlib.import_module("program").PROGRAM
        return program, properties_of(bundle, program, driven)
    fleet: FleetProgram = importlib.import_module("applications").FLEET
    found = {}
    for application in fleet.applications:
        module = f"properties_{application.name}"
        is_there = (bundle / f"{module}.py").is_file()
        found[application.name] = (
            importlib.import_module(module).PROPERTIES if is_there else without_properties(application.program, driven)
        )
    return fleet, found
