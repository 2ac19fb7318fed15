"""Which of a round's transactions count."""

from __future__ import annotations

from collections.abc import Sequence

from koordgen.runtime.replication.log import Entry


def winner(contenders: Sequence[int], lock: int, round_: int, n_sys: int) -> int:
    """Whose commit counts, of those that would change what one lock protects in one round: the first place goes round,
    so everyone comes to it."""
    return min(contenders, key=lambda pid: (pid - round_ - lock) % n_sys)


def counting(entries: Sequence[Entry], round_: int, n_sys: int) -> tuple[list[Entry], list[Entry]]:
    """The entries of a round whose events count: the commits, and the others."""
    contenders: dict[int, list[int]] = {}
    for entry in entries:
        if entry.closing.lock >= 0:
            contenders.setdefault(entry.closing.lock, []).append(entry.closing.author)
    winners = {winner(pids, lock, round_, n_sys) for lock, pids in contenders.items()}
    commits = [e for e in entries if e.closing.lock >= 0 and e.closing.author in winners]
    return commits, [e for e in entries if e.closing.lock < 0]
