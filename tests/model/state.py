"""What the model's three robots can know at one moment, how far it is explored, and which rules it goes by."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from koordgen.runtime.net.wire import View
from koordgen.runtime.replication.messages import Vote
from koordgen.runtime.replication.views import Report

N = 3
SKIP, PLAIN, COMMIT = 0, 1, 2
KINDS = ("nothing", "a plain event with an output", "a commit with an output")
FIRST = View(0, 1, (0,) * N)

Event = tuple[int, int, int]  # author, incarnation, round


class Violation(Exception):
    """A property does not hold; the message says which and how."""


class Robot(NamedTuple):
    """`base`: the view it knew when it lost its store. `ballot`: of its own proposal, 0: none. `pending`: the round of
    its event whose outputs wait, 0: none. `said`: the last round it keeps to have announced."""

    store: bool = True
    view: int = 0
    applied: int = 0
    base: int = 0
    vote: Vote = Vote()
    ballot: int = 0
    pending: int = 0
    said: int = 0
    held: int = 0  # it has everyone's entries up to here, also of rounds that it may not apply


class Life(NamedTuple):
    """The entries of one incarnation from round `first` on; others can get those of the first `heard` rounds."""

    incarnation: int
    first: int
    kinds: tuple[int, ...] = ()
    heard: int = 1 << 20


class State(NamedTuple):
    """`words[p]`: for each view the last round that p announced in it. `histories[w]`: for each round, who counted, by
    author and incarnation, for those who go by view w. `promises`: (number, ballot, pid, word); `puts`: (number,
    ballot, value); `votes`: (number, ballot, pid). `final`: events whose outputs have left."""

    robots: tuple[Robot, ...] = (Robot(),) * N
    lives: tuple[tuple[Life, ...], ...] = ((Life(0, 1),),) * N
    words: tuple[tuple[int, ...], ...] = ((0,),) * N
    histories: tuple[tuple[tuple[tuple[int, int], ...], ...], ...] = ((),)
    decided: tuple[View, ...] = (FIRST,)
    promises: frozenset[tuple[int, int, int, Report]] = frozenset()
    puts: frozenset[tuple[int, int, View]] = frozenset()
    votes: frozenset[tuple[int, int, int]] = frozenset()
    final: frozenset[Event] = frozenset()
    crashes: int = 0


@dataclass(frozen=True)
class Bounds:
    rounds: int = 2
    views: int = 1
    ballots: int = 1  # of one proposer for one view
    crashes: int = 1
    proposers: tuple[int, ...] = (0, 1, 2)
    kinds: tuple[int, ...] = (PLAIN, COMMIT)
    actors: tuple[int, ...] = (0, 1, 2)  # who runs events
    rivals: bool = False  # ballots go on after a view is decided: matters to P5 alone


@dataclass(frozen=True)
class Rules:
    """What the runtime does beyond the functions that are shared; each can be broken, to see that it is missed."""

    freezes: bool = True  # who has promised applies no further round
    refuses: bool = True  # ... and takes no store
    waits: bool = True  # outputs wait until their round is stable
    forgets_vote: bool = False  # at a restart
    forgets_said: bool = False
    again: bool = False  # an event in a round that is applied already
    holders: bool = True  # who has a store votes only for a view whose earlier rounds it has or can gather first
    stays: bool = True  # ... and in which it keeps that store


AS_THEY_ARE = Rules()
Step = tuple[str, State]


def changed(items: tuple[Any, ...], index: int, item: Any) -> tuple[Any, ...]:
    return (*items[:index], item, *items[index + 1 :])
