"""The real objects under thousands of random schedules: what the model promises, the code keeps."""

from __future__ import annotations

from contextlib import suppress

import pytest

from koordgen.runtime.agent.output_commit import OutputCommit
from koordgen.runtime.replication import replica, state_machine, views
from tests.model.lab import Violation
from tests.model.schedules import Schedule


def run(seeds: range, n: int = 3) -> tuple[int, int]:
    """The number of outputs and of view changes in all of them."""
    outputs = changes = 0
    for seed in seeds:
        try:
            fleet = Schedule(seed, n=n).run()
        except Violation as violation:
            raise Violation(f"seed {seed}: {violation}") from None
        outputs += len(fleet.finals)
        changes += max(fleet.views)
    return outputs, changes


def test_schedules_keep_what_is_promised() -> None:
    outputs, changes = run(range(60))
    assert outputs > 2400
    assert changes > 30


@pytest.mark.slow
@pytest.mark.parametrize(("n", "seeds"), [(2, range(1000)), (3, range(1000, 5000)), (5, range(1000))])
def test_many_schedules_keep_what_is_promised(n: int, seeds: range) -> None:
    print(run(seeds, n))


@pytest.mark.parametrize("seed", [6035, 8918])
def test_a_member_rejoins_that_lacks_entries_that_nobody_has_any_more(seed: int) -> None:
    """Their author has died, and those that have applied them got them in a snapshot. The seeds once ended so."""
    run(range(seed, seed + 1))


BROKEN = {
    "promises freeze nobody": (views.Views, "is_frozen", property(lambda self: False)),
    "one's own word is enough": (replica, "commit_index", lambda peers, view, applied: applied),
    "every commit counts": (state_machine, "arbitrate", lambda entries, round_, n_sys: (list(entries), [])),
    "one vote decides": (views, "majority", lambda n_sys: 1),
    "who comes back goes on where it was": (
        OutputCommit, "settle", lambda self, acted: (self.life, [w.record for w in self._waiting]),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_broken_is_missed(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(*BROKEN[name])
    with pytest.raises(Violation):
        for seed in range(300):
            with suppress(IndexError):  # of a quorum that is none: a crash does not count as found
                run(range(seed, seed + 1))
