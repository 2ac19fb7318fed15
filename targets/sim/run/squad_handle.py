"""Agent handle of a squad: its agent runs on one of its robots, and moves to another one if that robot fails."""

from __future__ import annotations

from collections.abc import Sequence

from targets.sim.run.run_interface import AgentHandle


class SquadHandle(AgentHandle):
    """Agent handle of a squad. It lives while one of its robots does.

    To end or crash it, end or crash its robots: no fault names a squad, and the run kills each of its robots."""

    _members: Sequence[AgentHandle] = ()

    def consist_of(self, members: Sequence[AgentHandle]) -> None:
        """Set the robots of the squad."""
        self._members = members

    @property
    def alive(self) -> bool:
        return any(member.alive for member in self._members)

    @property
    def status(self) -> int | None:
        """0 once all robots of the squad have ended normally; otherwise None: failures are those of its robots."""
        return 0 if all(member.status == 0 for member in self._members) else None

    def request_end(self) -> None:
        self.asked_to_end = True

    def kill(self) -> None:
        """Do nothing."""

    def crash(self) -> None:
        """Do nothing."""

    def restart(self) -> None:
        """Do nothing."""

    def freeze(self, seconds: float) -> None:
        """Do nothing."""

    @property
    def frozen(self) -> bool:
        return False

    def thaw(self) -> None:
        """Do nothing."""

    def _failed(self, status: int) -> str | None:
        return None
