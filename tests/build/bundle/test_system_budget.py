"""Sizes of the messages of several applications: as the agents' layout reckons them, and located errors."""

from __future__ import annotations

import pytest

from koordgen.build.bundle.budget import check_budget
from koordgen.build.bundle.system_budget import (
    check_system_budget,
    check_system_link,
    entry_bytes,
    entry_sizes,
    store_total,
)
from koordgen.fleet.medium import Medium
from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.semantics.composition import Application, System
from koordgen.runtime.net.layout import Layout
from tests.composed.agents import fleet_program
from tests.lang.semantics.compositions import compiled, random_system

NAMES = ("alice", "bert", "cleo")
GO = "Go:\n  pre: True\n  eff: {}\n"


def system(*texts: str, members: tuple[tuple[int, ...], ...] = ((0, 1, 2), (1, 2))) -> System:
    programs = [compiled(name, text) for name, text in zip(("first", "second"), texts, strict=True)]
    return System(tuple([Application(p.name, p, m) for p, m in zip(programs, members, strict=True)]), 3)


def only(found: list[tuple[int, Diagnostic]]) -> tuple[int, Diagnostic]:
    (one,) = found
    return one


@pytest.mark.parametrize("seed", range(12))
def test_sizes_are_those_of_the_agents_layout(seed: int) -> None:
    made = random_system(seed)
    layout = Layout.of(fleet_program(made))
    assert max(entry_bytes(made, r, entry_sizes(made, r)) for r in range(3)) == layout.entry_bytes
    assert store_total(made) == layout.snapshot_bytes
    assert check_system_budget(made, NAMES) == []


def test_two_applications_that_fit_alone_may_not_fit_together() -> None:
    half = "allwrite: string {0} max 70000\n" + GO.format('{0} = "x"')
    made = system(half.format("a"), half.format("b"))
    assert not any(check_budget(a.program, 3) for a in made.applications)
    index, found = only(check_system_budget(made, NAMES))
    assert (index, found.code, found.span.line) == (0, "B004", 1)
    assert found.message.startswith("shared writes of one round of all applications of bert take up to 140")
    apart = system(half.format("a"), half.format("b"), members=((0,), (1, 2)))
    assert check_system_budget(apart, NAMES) == [], "no robot writes both"


def test_the_state_transfer_counts_the_slots_of_members_only() -> None:
    slots = "allread: string x[N_SYS] max 63000\n" + GO.format('x[pid] = "x"')
    cell = "allwrite: string a max 63000\n" + GO.format('a = "x"')
    assert check_system_budget(system(slots, cell, members=((0, 1), (1,))), NAMES) == []
    index, found = only(check_system_budget(system(slots, cell, members=((0, 1, 2), (1,))), NAMES))
    assert (index, found.code) == (0, "B004") and "all applications together take up to 252" in found.message


def test_inits_of_all_applications_share_a_datagram() -> None:
    begins = 'allwrite: string {0} max 600\ninit:\n  {0} = "x"\n' + GO.format("pass")
    made = system(begins.format("a"), begins.format("b"))
    _, found = only(check_system_budget(made, NAMES))
    assert found.code == "B004" and "writes of `init`" in found.message and "bert" in found.message


def test_the_link_carries_the_writes_of_all_applications() -> None:
    text = "allwrite: string {0} max 400\n" + GO.format('{0} = "x"')
    made = system(text.format("a"), text.format("b"))
    fast, slow = Medium(rate=1e6, loss=0.0, mtu=1500), Medium(rate=6e4, loss=0.0, mtu=1500)
    assert check_system_link(made, NAMES, 0.1, fast) == [] == check_system_link(made, NAMES, 0.1, None)
    index, found = only(check_system_link(made, NAMES, 0.1, slow))
    assert (index, found.code) == (0, "B008") and "carries 750 bytes" in found.message and "bert" in found.message


def test_writes_of_one_round_that_need_several_datagrams_are_a_warning() -> None:
    texts = (f"allwrite: string {v} max 900\n{GO.format(f'{v} = {v}')}" for v in "ab")
    made, fast = system(*texts), Medium(rate=1e9)
    index, found = only(check_system_link(made, NAMES, 0.1, fast))
    assert (index, found.code, found.severity, found.span.line) == (0, "B009", "warning", 1)
    assert "all applications of bert" in found.message and "need 3 datagrams" in found.message
    texts = (f"allwrite: string {v} max 300\n{GO.format(f'{v} = {v}')}" for v in "ab")
    assert check_system_link(system(*texts), NAMES, 0.1, fast) == []


def test_a_robot_that_writes_nothing_is_not_the_one_to_report() -> None:
    """Alice, whose two applications write nothing, has a longer entry than bert with one short write."""
    programs = [compiled(name, f"local: int k\n{GO.format('k = 1')}") for name in ("x", "y")]
    programs.append(compiled("z", f"allwrite: bool b\n{GO.format('b = True')}"))
    members = ((0,), (0,), (1,))
    made = System(tuple([Application(p.name, p, m) for p, m in zip(programs, members, strict=True)]), 2)
    assert check_system_link(made, NAMES, 0.1, Medium(rate=1e9)) == []
    index, found = only(check_system_link(made, NAMES, 0.1, Medium(rate=100)))
    assert (index, found.code) == (2, "B008") and "the writes of bert alone" in found.message


def test_one_application_is_checked_as_its_program() -> None:
    program = compiled("first", "allwrite: string a max 140000\n" + GO.format('a = "x"'))
    made = System((Application("first", program, (0, 1, 2)),), 3)
    assert check_system_budget(made, NAMES) == [(0, d) for d in check_budget(program, 3)] != []
