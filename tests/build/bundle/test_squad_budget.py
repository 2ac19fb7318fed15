"""Sizes of the messages of a squad: as the agents' layout reckons them, and located errors."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from koordgen.build.bundle import squad_budget
from koordgen.build.bundle.budget import check_link, longest_event, traffic
from koordgen.build.bundle.plan_squads import used_ports
from koordgen.build.bundle.squad_budget import record_capacity, with_outer
from koordgen.build.bundle.system_budget import check_system_budget, entry_bytes, entry_sizes, store_total
from koordgen.build.emit.program import program_text
from koordgen.build.pipeline import check_file
from koordgen.fleet.medium import Medium
from koordgen.lang.ir.decl import Program
from koordgen.lang.semantics.composition import Application, System
from koordgen.lang.source import Span
from koordgen.runtime.agent import squad
from koordgen.runtime.agent.records import KEPT
from koordgen.runtime.agent.squad import Squad
from koordgen.runtime.net.layout import Layout
from tests.agree.both import Generated
from tests.agree.programs import random_program
from tests.build.squad_files import LINEFORM, TRIANGLE
from tests.composed.agents import fleet_program
from tests.lang.semantics.compositions import compiled

SPAN = Span(1, 1, 1, 2)
NAMES = ("ann", "bob", "cyd")
NO_EVENTS: Any = SimpleNamespace(may_claim=None, claim=None, has_unwritten=None, write=None)


def inner() -> System:
    return System((Application("triangle", compiled("triangle", TRIANGLE), (0, 1, 2)),), 3)


def hosting(outer: Program) -> System:
    """Return the inner system with the application of an outer program."""
    system = inner()
    ports = [each for _, each in used_ports(outer, system.applications[0].program)]
    return with_outer(system, 0, outer, 3, ports, SPAN)


def test_names_and_numbers_are_the_runtimes() -> None:
    assert squad_budget.KEPT == KEPT
    assert squad_budget.OUTER == squad.APPLICATION


def test_a_record_is_as_large_as_agents_make_it() -> None:
    for seed in range(8):
        program = random_program(seed)
        generated = Generated(program, program_text(program)).program
        assert record_capacity(program, 5) == squad.record_capacity(generated, 5), f"random_program({seed})"


def test_sizes_are_those_of_the_agents_layout() -> None:
    outer = check_file(str(LINEFORM)).program
    generated = Generated(outer, program_text(outer)).program
    agents = Squad(0, {}, {"Motion.target": "goal"}, generated).with_outer(fleet_program(inner()), 3, NO_EVENTS)
    layout, made = Layout.of(agents), hosting(outer)
    assert max(entry_bytes(made, r, entry_sizes(made, r)) for r in range(3)) == layout.entry_bytes
    assert store_total(made) == layout.snapshot_bytes
    assert check_system_budget(made, NAMES) == []


@pytest.mark.parametrize(("declared", "fits"), [("string s max 9000", True), ("string s max 19000", False)])
def test_the_record_must_fit_into_the_datagrams_of_the_inner_fleet(declared: str, fits: bool, tmp_path: Path) -> None:
    (tmp_path / "a.koord").write_text(f'local: {declared}\nGo:\n  pre: s == ""\n  eff: s = "x"\n')
    outer = check_file(str(tmp_path / "a.koord")).program
    found = check_system_budget(hosting(outer), NAMES)
    if fits:
        assert found == []
        return
    ((application, error),) = found
    assert (application, error.code, error.span) == (1, "B004", SPAN), "it points at the squad in the outer fleet file"
    assert "the record of the outer robot alone takes up to 17" in error.message


def test_each_address_of_a_squad_counts() -> None:
    program, calm = check_file(str(LINEFORM)).program, Medium(rate=6e6, loss=0.0, mtu=1500)
    plain = traffic(longest_event(program), 3, calm, to_all=False)
    assert traffic(longest_event(program), 3, calm, to_all=False, addresses=3) == plain
    assert traffic(longest_event(program), 3, calm, to_all=False, addresses=7).bytes * 3 == plain.bytes * 7
    slow = Medium(rate=8 * 5 * plain.bytes / 3, loss=0.0, mtu=1500)
    assert check_link(program, 3, 1.0, slow) == [] == check_link(program, 3, 1.0, slow, addresses=5)
    (found,) = check_link(program, 3, 1.0, slow, addresses=7)
    assert found.code == "B008" and "7 addresses of 3 robots x 2 senders x (" in found.message
