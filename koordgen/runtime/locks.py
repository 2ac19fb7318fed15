"""Who may run an atomic event in a round: the right to each lock goes round robin, one robot a round.

So of one lock's transactions at most one commits in a round, based on the store as it was at the round's start, and
none overwrites another unseen. A round lost to the network costs its holder a turn, never an update.
"""

from __future__ import annotations


def holder(lock: int, round_: int, n_sys: int) -> int:
    """The pid that alone may commit under a lock in a round."""
    return (round_ + lock) % n_sys
