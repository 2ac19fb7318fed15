"""Monitors of all instances of a robot: one `Monitors` for each application that the robot runs."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, Protocol

from msgspec.structs import replace

from koordgen.runtime.config.settings import Settings
from koordgen.runtime.monitor.monitor import Cpu, Monitors
from koordgen.runtime.program.fleet_program import FleetProgram
from koordgen.runtime.program.program import Effects
from koordgen.runtime.program.property import Properties
from koordgen.runtime.program.runner import Limit
from koordgen.runtime.trace.monitored import Change
from koordgen.runtime.trace.writer import RoundRecord
from koordgen.runtime.vehicle.safety import GO, SafetyVerdict


class ReportChange(Protocol):
    """Function that reports a change of a verdict. `application`: its application; "" if the fleet has only one."""

    def __call__(self, change: Change, application: str) -> None: ...


class RobotMonitors:
    """Monitors of a robot's instances, in the order of the instances.

    found: properties of the only application, or of each application by its name.
    looks: for each instance, the function that evaluates its invariants; see Monitors.look.
    The other parameters are those of Monitors. An application's monitors know its members as the fleet.
    """

    def __init__(
        self,
        fleet: FleetProgram,
        found: Mapping[str, Properties] | Properties | None,
        settings: Settings,
        report: ReportChange,
        limit: Limit,
        cpu: Cpu | None = None,
    ) -> None:
        self._all: list[Monitors] = []
        self._by_name: dict[str, Monitors] = {}
        for instance in fleet.of_robot(settings.pid):
            application = fleet.applications[instance.application]
            own = found.get(application.name) if isinstance(found, Mapping) else found
            peers = tuple([settings.peers[robot] for robot in application.members])
            seen, name = settings, ""
            if fleet.is_composed:
                name = application.name
                actions = {k.removeprefix(f"{name}."): v for k, v in settings.monitors.items() if _is_of(k, name)}
                seen = replace(settings, pid=instance.pid, peers=peers, monitors=actions)
            monitors = Monitors(own, seen, partial(report, application=name), limit, cpu)
            self._all.append(monitors)
            self._by_name[name] = monitors
        self.looks = tuple([monitors.look for monitors in self._all])

    @property
    def wanted(self) -> list[bool]:
        """For each instance, True if a property needs observations of its rounds."""
        return [monitors.wanted for monitors in self._all]

    @property
    def verdict(self) -> SafetyVerdict:
        """Reaction that violated properties require; a safe stop goes before a hold."""
        if len(self._all) == 1:
            return self._all[0].verdict
        found = GO
        for monitors in self._all:
            verdict = monitors.verdict
            if verdict is not GO and found.action != "stop" and (found is GO or verdict.action == "stop"):
                found = verdict
        return found

    def hear(self, record: RoundRecord) -> None:
        """Evaluate assumptions and contracts on the record of a committed round; see Monitors.hear."""
        self._by_name[record.application].hear(record)

    def ran(self, place: int, effects: Effects, event: str | None, round_: int, time: float) -> None:
        """Update the verdicts on loop invariants of the robot's instance number `place`; see Monitors.ran."""
        self._all[place].ran(effects, event, round_, time)

    def report(self) -> dict[str, Any]:
        """Return the number of properties with each verdict, and the violated properties, of all instances.

        With several applications, the name of a property begins with that of its application, as in the settings."""
        counts: dict[str, int] = {}
        violated: list[dict[str, Any]] = []
        for name, monitors in self._by_name.items():
            found = monitors.report()
            for outcome, count in found["counts"].items():
                counts[outcome] = counts.get(outcome, 0) + count
            violated += [{**each, "name": f"{name}.{each['name']}"} if name else each for each in found["violated"]]
        return {"counts": counts, "violated": violated}

    def summary(self) -> tuple[bool, str]:
        """Return whether a property was ever violated, and a text with all verdicts; "" without properties."""
        found = [(name, *monitors.summary()) for name, monitors in self._by_name.items()]
        texts = [f"{name}: {text}" if name else text for name, _, text in found if text]
        return any(broken for _, broken, _ in found), "; ".join(texts)


def _is_of(key: str, application: str) -> bool:
    """Return whether a key of the settings `monitors` is about an application: `NAME.property`, or `default`."""
    return key == "default" or key.startswith(f"{application}.")
