"""What the network between robots is like, for both clocks: in memory (lockstep/) and through the relay (relay.py)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec

from koordgen.runtime.net.network import Conditions
from targets.sim.base.schedule import Schedule


class Medium(msgspec.Struct, frozen=True):
    """All links but those of `links` (sender, receiver) are as `all`; between robots of different `groups`, by pid,
    nothing goes (empty: everything does), nor between the two of a pair of `cuts`, the lower pid first."""

    all: Conditions = Conditions()
    links: tuple[tuple[int, int, Conditions], ...] = ()
    groups: tuple[int, ...] = ()
    cuts: tuple[tuple[int, int], ...] = ()

    def by_link(self) -> Mapping[tuple[int, int], Conditions]:
        """The conditions of `links` by sender and receiver."""
        return {(sender, receiver): conditions for sender, receiver, conditions in self.links}

    def cut(self, sender: int, receiver: int) -> bool:
        """Whether nothing goes from one pid to another."""
        apart = bool(self.groups) and self.groups[sender] != self.groups[receiver]
        return apart or (bool(self.cuts) and (min(sender, receiver), max(sender, receiver)) in self.cuts)


def medium(schedule: Schedule, names: Sequence[str]) -> Medium:
    """Before any partition; `names` are the robots by pid."""
    pids = {name: pid for pid, name in enumerate(names)}
    whole = schedule.network or Conditions()
    return Medium(whole, tuple((pids[link.sender], pids[link.receiver], link.over(whole)) for link in schedule.links))


def parted(whole: Medium, groups: Sequence[Sequence[str]], names: Sequence[str]) -> Medium:
    """Robots hear those of their own group; one that is in none hears nobody."""
    number = {name: k for k, group in enumerate(groups) for name in group}
    alone = {name: len(groups) + pid for pid, name in enumerate(names)}
    return msgspec.structs.replace(whole, groups=tuple(number.get(name, alone[name]) for name in names))
