"""Traffic of a fleet on its link: arithmetic, diagnostics, and that the bound holds for real robots."""

from __future__ import annotations

import re

import pytest

from benchmarks.fixtures.fleet import Fleet
from koordgen.build.bundle.budget import check_link, on_the_medium, overhead, round_bytes
from koordgen.fleet.medium import Medium
from koordgen.lang.ir.decl import Program
from koordgen.runtime.net.network import Conditions
from tests.build.bundle.test_budget import checked, generated

CALM = Medium(loss=0.0)


def writing(characters: int) -> Program:
    """Return a program in which each robot writes all its shared variables in every round, with new text each time."""
    return checked(f"""
allread: string text[N_SYS] max {characters}
allwrite: List<float> numbers max 3
local: bool flip
Write:
  pre: True
  eff:
    if flip:
      text[pid] = "{"x" * characters}"
    else:
      text[pid] = "{"y" * characters}"
    numbers = [0.1, 0.2, 0.3]
    flip = not flip
""")


def sent_by_round(program: Program, n: int, conditions: Conditions, rounds: range) -> list[int]:
    """Return the bytes on the link in each round, headers included."""
    fleet = Fleet(n=n, program=generated(program), conditions=conditions)
    sent: dict[int, int] = {}
    send = fleet.network.send

    def counted(sender: int, receiver: int, datagram: bytes) -> None:
        round_ = fleet.robots[sender].agent.round
        sent[round_] = sent.get(round_, 0) + on_the_medium(len(datagram), CALM.mtu)
        send(sender, receiver, datagram)

    fleet.network.send = counted  # type: ignore[method-assign]
    fleet.boot_all().run_rounds(rounds.stop)
    return [sent[r] for r in rounds]


@pytest.mark.parametrize("n", [2, 5, 8])
def test_robots_send_no_more_than_the_bound_and_not_much_less(n: int) -> None:
    program = writing(400)
    bound = round_bytes(program, n, CALM)
    sent = sent_by_round(program, n, Conditions(delay=0.001, jitter=0.004), range(5, 40))
    assert bound / 4 <= min(sent) <= max(sent) <= bound


def test_with_losses_too_on_average() -> None:
    program, n = writing(400), 5
    sent = sent_by_round(program, n, Conditions(loss=0.1, delay=0.001, jitter=0.004), range(5, 100))
    assert sum(sent) / len(sent) <= round_bytes(program, n, Medium(loss=0.1))


def test_packets_of_a_datagram() -> None:
    assert on_the_medium(1200, 1500) == 1200 + 8 + 20 + 38
    assert on_the_medium(1472, 1500) == 1500 + 38
    assert on_the_medium(1473, 1500) == 1473 + 8 + 2 * 58
    assert on_the_medium(1200, 576) == 1200 + 8 + 3 * 58


def test_the_arithmetic_of_a_round() -> None:
    program = writing(400)
    entry = overhead(5) + 38 + 5 + 403 + 5 + 28 + 66
    acknowledgement = overhead(5) + 66
    assert round_bytes(program, 5, CALM) == 5 * 4 * (entry + acknowledgement)
    assert round_bytes(program, 5, CALM, to_all=True) == 5 * (entry + acknowledgement)
    assert round_bytes(program, 5, Medium(loss=0.5)) == 2 * round_bytes(program, 5, CALM)
    (found,) = check_link(program, 5, 0.02, Medium(6e6, 0.1, 1500))
    total = round_bytes(program, 5, Medium())
    assert (found.code, found.severity, found.span.line) == ("B008", "error", 2)
    assert found.message == (
        f"a round may send {total} bytes: 5 robots x 4 receivers x ({entry} for 479 of writes in one datagram + "
        f"{acknowledgement} for the acknowledgement) / (1 - 0.1 loss); a round of 0.02 s at 6e+06 bit/s carries "
        "15000 bytes"
    )


def test_only_the_event_that_writes_most_counts() -> None:
    both = "allwrite:\n  string a max 300\n  string b max 500\nlocal: bool l\n"
    one = 'E:\n  pre: l\n  eff: a = ""\n'
    other = 'F:\n  pre: not l\n  eff:\n    if l:\n      b = ""\n    else:\n      l = True\n'
    loop = 'G:\n  pre: not l\n  eff:\n    for i in range(2):\n      a = ""\n      b = ""\n'
    sizes = [round_bytes(checked(both + events), 2, CALM) for events in (one, other, one + other, one + other + loop)]
    assert sizes[1] - sizes[0] == 2 * 200
    assert sizes[2] == sizes[1]
    assert sizes[3] - sizes[2] == 2 * (5 + 303)


def test_no_link_no_verdict() -> None:
    assert check_link(writing(400), 5, 0.005, None) == []
    assert check_link(writing(400), 1, 0.005, Medium(rate=1000.0)) == [], "alone it sends nothing"


@pytest.mark.parametrize(("n", "to_all"), [(2, False), (5, False), (5, True), (40, True)])
def test_what_help_names_fits_and_hardly_less_does_not(n: int, to_all: bool) -> None:
    source = "allread: List<Point> path[N_SYS] max MAX\nE:\n  pre: True\n  eff: path[pid] = []\n"
    program, link, delta = checked(source.replace("MAX", "500")), Medium(rate=2e6), 0.1
    (found,) = check_link(program, n, delta, link, to_all)
    assert found.code == "B008"

    def verdicts(program: Program, delta: float, link: Medium) -> set[str]:
        return {d.code for d in check_link(program, n, delta, link, to_all)}

    enough = float(re.findall(r"a delta of ([\d.]+) s", found.help)[0])
    assert "B008" not in verdicts(program, enough, link)
    assert "B008" in verdicts(program, enough * 0.98, link)
    rate = float(re.findall(r"a link of ([\d.]+) bit/s", found.help)[0])
    assert "B008" not in verdicts(program, delta, Medium(rate=rate))
    assert "B008" in verdicts(program, delta, Medium(rate=rate * 0.98))
    for most in map(int, re.findall(r"or `max (\d+)`", found.help)):
        assert "B008" not in verdicts(checked(source.replace("MAX", str(most))), delta, link)
        assert "B008" in verdicts(checked(source.replace("MAX", str(most + 1))), delta, link)
    assert ("or `max" in found.help) == (n < 40)


def test_a_delta_that_no_fleet_may_have_is_no_help() -> None:
    (found,) = check_link(writing(400), 128, 0.02, Medium(rate=1e6))
    assert "a delta" not in found.help
    assert "a link of" in found.help


@pytest.mark.parametrize("delta", [0.005, 0.1, 2.0, 60.0])
def test_rates_are_told_in_digits(delta: float) -> None:
    program = writing(400)
    (found,) = check_link(program, 2, delta, Medium(rate=1e3 if delta < 60 else 100.0))
    rate = float(re.findall(r"a link of (\d+) bit/s", found.help)[0])
    needed = round_bytes(program, 2, Medium()) * 8 / delta
    assert needed <= rate <= needed * 1.01


def test_a_entry_in_fragments_is_told() -> None:
    (found,) = check_link(writing(3000), 2, 0.1, Medium())
    assert (found.code, found.severity) == ("B009", "warning")
    assert "up to 3079 bytes and need 5 datagrams" in found.message
    (most,) = re.findall(r"`max (\d+)`", found.help)
    assert check_link(writing(int(most)), 2, 0.1, Medium()) == []
    assert check_link(writing(int(most) + 1), 2, 0.1, Medium()) != []
