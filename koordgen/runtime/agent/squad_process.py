"""Set-up of the host of an outer robot in the process of an inner robot's agent."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from koordgen.runtime.agent.squad import Squad
from koordgen.runtime.agent.squad_host import HostSurroundings, SquadHost
from koordgen.runtime.config.settings import BadSettings, Settings
from koordgen.runtime.ops.journal import Emit
from koordgen.runtime.ops.set_up import open_key, open_trace, open_transport
from koordgen.runtime.program.fleet_program import FleetProgram
from koordgen.runtime.program.runner import Limit
from koordgen.runtime.values.clock import Clock


class AgentProcess(NamedTuple):
    """Objects that all agents of one process share. `boot`: id of this start of the process, 8 random bytes."""

    clock: Clock
    emit: Emit
    limit: Limit
    boot: bytes


def open_host(squad: Squad, inner: FleetProgram, own: Settings, outer: Settings, process: AgentProcess) -> SquadHost:
    """Return the host of an outer robot, with its key and transport.

    own: settings of the inner robot. outer: settings of the outer robot.
    Raises BadSettings, BadKey, CannotOpen and BadExtern.
    """
    if outer.application_id == own.application_id:
        raise BadSettings(f"{squad.settings}: its application_id must differ from that of settings.json")
    if squad.program.library is not None:
        squad.program.library.load()
    key, warn = open_key(outer), _warnings(process.emit)
    around = HostSurroundings(
        outer, key, own.robot, process.boot, process.clock, open_transport(outer), partial(open_trace, outer, warn),
        process.emit, process.limit, polls=True,
    )  # fmt: skip
    return SquadHost(squad, inner, own.pid, own.delta, around)


def _warnings(emit: Emit) -> Callable[[str], None]:
    return lambda text: emit("warning", f"warning: {text}")
