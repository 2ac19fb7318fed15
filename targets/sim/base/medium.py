"""Communication medium of the fleet, for both clocks.

In memory (lockstep) and through the relay (real time)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec

from koordgen.runtime.net.network import Conditions
from targets.sim.base.schedule import Schedule


class Medium(msgspec.Struct, frozen=True):
    """Conditions of all links between robots.

    `links` (sender, receiver) override `all`. No datagram passes between robots of different `groups` (group number by
    pid; empty: no partition), nor between the robots of a pair in `cuts` (lower pid first)."""

    all: Conditions = Conditions()
    links: tuple[tuple[int, int, Conditions], ...] = ()
    groups: tuple[int, ...] = ()
    cuts: tuple[tuple[int, int], ...] = ()

    def by_link(self) -> Mapping[tuple[int, int], Conditions]:
        """Return the conditions of `links` by sender and receiver."""
        return {(sender, receiver): conditions for sender, receiver, conditions in self.links}

    def among(self, places: Sequence[int]) -> Medium:
        """Return the medium of some of the robots only, which are numbered by their places in `places`."""
        number = {place: k for k, place in enumerate(places)}
        return Medium(
            self.all,
            tuple((number[a], number[b], c) for a, b, c in self.links if a in number and b in number),
            tuple(self.groups[place] for place in places) if self.groups else (),
            tuple((number[a], number[b]) for a, b in self.cuts if a in number and b in number),
        )

    def cut(self, sender: int, receiver: int) -> bool:
        """Return whether no datagram passes from one pid to another."""
        apart = bool(self.groups) and self.groups[sender] != self.groups[receiver]
        return apart or (bool(self.cuts) and (min(sender, receiver), max(sender, receiver)) in self.cuts)


def medium(schedule: Schedule, names: Sequence[str]) -> Medium:
    """Return the medium of a schedule before any partition; `names` are the robots by pid."""
    pids = {name: pid for pid, name in enumerate(names)}
    whole = schedule.network or Conditions()
    return Medium(whole, tuple((pids[link.sender], pids[link.receiver], link.over(whole)) for link in schedule.links))


def partition(whole: Medium, groups: Sequence[Sequence[str]], names: Sequence[str]) -> Medium:
    """Partition the medium: robots reach only their own group. A robot in no group reaches nobody."""
    number = {name: k for k, group in enumerate(groups) for name in group}
    alone = {name: len(groups) + pid for pid, name in enumerate(names)}
    return msgspec.structs.replace(whole, groups=tuple(number.get(name, alone[name]) for name in names))
