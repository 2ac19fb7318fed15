"""Numbers of UDP ports for agents to bind: nobody else is given one in the seconds until they do."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from targets.sim.base import ports
from targets.sim.base.ports import BLOCK, PortNumbers

FIRST = 9_984  # where no run that happens to go on takes its numbers


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[PortNumbers, PortNumbers]]:
    """Two runs on one host."""
    monkeypatch.setattr(ports, "FIRST", FIRST)
    made = PortNumbers(), PortNumbers()
    yield made
    for numbers in made:
        numbers.close()


def test_two_runs_never_give_out_one_number(runs: tuple[PortNumbers, PortNumbers]) -> None:
    one, other = runs
    one._blocks, other._blocks = [3, 2, 1], [3, 2, 1]  # the same luck
    first = [one.allocate() for _ in range(BLOCK + 1)]
    assert set(first).isdisjoint({other.allocate() for _ in range(BLOCK)})
    assert len(set(first)) == len(first) and all(FIRST + BLOCK <= n < FIRST + 3 * BLOCK for n in first)
    with pytest.raises(OSError, match="no UDP port"):
        other.allocate()


def test_a_number_is_passed_over_when_somebody_has_bound_it(runs: tuple[PortNumbers, PortNumbers]) -> None:
    one, _ = runs
    first = one.allocate()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as somebody:
        somebody.bind(("127.0.0.1", first + 1))
        assert one.allocate() == first + 2


def test_a_number_that_was_given_back_is_given_last(runs: tuple[PortNumbers, PortNumbers]) -> None:
    one, _ = runs
    one._blocks = [5]
    first = one.allocate()
    one.give_back(first)
    assert [one.allocate() for _ in range(BLOCK)][-1] == first


def test_a_port_gives_its_number_back_once(
    monkeypatch: pytest.MonkeyPatch, runs: tuple[PortNumbers, PortNumbers]
) -> None:
    one, _ = runs
    one._blocks = [7]
    monkeypatch.setattr(ports, "NUMBERS", one)
    port = ports.UdpPort()
    port.close()
    port.close()
    assert len({one.allocate() for _ in range(BLOCK)}) == BLOCK
    with pytest.raises(OSError, match="no UDP port"):
        one.allocate()
