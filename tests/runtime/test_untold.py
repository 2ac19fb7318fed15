"""Usual datagrams may be taken where they arrive, so that no message tells of them: robots find what has come by what
they hold, and do the same at the same moments."""

from __future__ import annotations

import pytest

from koordgen.runtime.link import Heard, Link, Usuals
from koordgen.runtime.network import Conditions
from koordgen.runtime.rounds import Rounds
from tests.runtime.fleet import Fleet
from tests.runtime.gates import needs_gate
from tests.runtime.test_gate_fleet import CALM, ROUGH, told

pytestmark = needs_gate


def quiet(patch: pytest.MonkeyPatch, fleet: Fleet) -> list[int]:
    """Usual words go to the shared memory at once, and `receive` is silent about them; how many did."""
    taken, receive = [0], Link.receive

    def rounds_of(link: Link) -> Rounds | None:
        return next(r.agent._rounds for r in fleet.robots.values() if r.agent._link is link)

    def silent(link: Link) -> list[Heard]:
        left, rounds = list[Heard](), rounds_of(link)
        for message in receive(link):
            if isinstance(message, Usuals) and rounds is not None:
                taken[0] += len(message.rows)
                rounds.take([message])
            else:
                left.append(message)
        return left

    patch.setattr(Link, "receive", silent)
    return taken


@pytest.mark.parametrize("conditions", [CALM, ROUGH], ids=["calm", "rough"])
def test_nobody_needs_a_message_to_find_what_has_come(conditions: Conditions, monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    for silent in (False, True):
        with monkeypatch.context() as patch:
            fleet = Fleet(3, 7, conditions).boot_all()
            taken = quiet(patch, fleet) if silent else [0]
            fleet.run_rounds(60)
            fleet.run(1.0)
            found.append(told(fleet))
            assert (taken[0] > 100) == silent
    assert found[0] == found[1]
