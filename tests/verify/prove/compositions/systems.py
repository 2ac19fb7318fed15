"""Small compositions with known verdicts: for each of the rules B, E, I, P and A one that holds and some that fail.

`counter` exports n, and `user` imports it. Both run on all of two robots, if nothing else is said.
"""

from __future__ import annotations

from typing import NamedTuple

from koordgen.lang.semantics.composition import Application, System
from tests.lang.semantics.compositions import compiled


class KnownComposition(NamedTuple):
    """Composition with its known verdicts.

    `counter`, `user`: the texts of both programs. `proved`: what is PROVED, as "user: Seen" and "counter: n.Positive",
    where the last is a guarantee as one application keeps it. `members`: the robots of each program.
    """

    counter: str
    user: str
    proved: str
    members: tuple[tuple[int, ...], tuple[int, ...]] = ((0, 1), (0, 1))

    def system(self) -> System:
        counter = Application("counter", compiled("counter", self.counter), self.members[0])
        user = compiled("user", self.user)
        bindings = (("Counter", "counter"),) if user.imports else ()
        return System((counter, Application("user", user, self.members[1], bindings)), 1 + max(map(max, self.members)))


COUNTER = """
export:
  write int n
{guarantees}allwrite: int n = {first}
local: int k
{more}Up:
  pre: n < 9
  eff: atomic: n += 1
"""
USER = """
import Counter:
  write int n
local:
  int k
  bool done
{more}"""
IDLE = "Go:\n  pre: k < 3\n  eff: k += 1\n"
SEEN = "Look:\n  pre: n > k\n  eff: k = n\ninvariant Seen: forall i in ID: k[i] <= n\n"
POSITIVE = "    guarantee Positive: n >= 1\n"
RISING = "    guarantee Rising: n <= n'\n"
NEAR = "    guarantee Near: n' <= n + 1 and n <= n' + 1\n"
GROWING = "    guarantee Growing: n < n'\n"


def counter(guarantees: str = "", first: str = "1", more: str = "") -> str:
    return COUNTER.format(guarantees=guarantees, first=first, more=more)


def user(more: str = IDLE) -> str:
    return USER.format(more=more)


def effect(line: str, guard: str = "n < 9") -> str:
    return f"Put:\n  pre: {guard}\n  eff: {line}\n"


SENSOR = """
using Motion:
  sensors: float speed
  assume {assumed}
local: int k
Go:
  pre: k < 3
  eff: k += 1
invariant Few: forall i in ID: k[i] <= 3
"""
DRIVES = """
using Motion:
  sensors: bool reached
  actuators: Point target clears reached
local: int k
Go:
  pre: k < 3
  eff:
    k += 1
    Motion.target = Point(k, 0, 0)
invariant Few: forall i in ID: k[i] <= 3
"""
READS = """
using Motion:
  sensors: bool reached
  assume reached' == reached
local: bool seen
Look:
  pre: Motion.reached
  eff: seen = True
invariant Seen: forall i in ID: {claim}
"""

KNOWN: dict[str, KnownComposition] = {
    # B: first values and each init establish the state guarantees
    "first values that satisfy a guarantee": KnownComposition(
        counter(POSITIVE), user(), "counter: Positive"),
    "first values that do not satisfy a guarantee": KnownComposition(
        counter(POSITIVE, first="start", more="param int start = 0\n"), user(), ""),
    "an importer's init that establishes a guarantee": KnownComposition(
        counter(POSITIVE), user("init:\n  n = pid + 1\n" + IDLE), "counter: Positive, user: Positive"),
    "an importer's init that breaks a guarantee": KnownComposition(
        counter(POSITIVE, more="invariant Low: n >= 1\n"), user("init:\n  n = pid\n" + IDLE), ""),
    "an importer's init breaks an invariant": KnownComposition(
        counter(RISING, more="invariant Low: n >= 0\n"), user("init:\n  n = -3\n" + IDLE), "counter: Rising"),
    "an invariant that a state guarantee protects at the start": KnownComposition(
        counter(POSITIVE + RISING, more="invariant Low: n >= 0\n"), user("init:\n  n = 3\n" + IDLE),
        "counter: Low, counter: Positive, counter: Rising, user: Positive"),
    # E: each event keeps the guarantees of what it writes
    "an importer's event that keeps a guarantee": KnownComposition(
        counter(POSITIVE), user(effect("n = 3")), "counter: Positive, user: Positive"),
    "an importer's event that breaks a guarantee": KnownComposition(
        counter(POSITIVE, more="invariant Low: n >= 0\n"), user(effect("n = -1")), ""),
    "a transaction keeps a step guarantee": KnownComposition(
        counter(RISING), user(effect("atomic: n += 1")), "counter: Rising, user: Rising"),
    "a plain write breaks a step guarantee": KnownComposition(
        counter(RISING), user(effect("n += 1")), ""),
    "a transaction keeps both guarantees": KnownComposition(
        counter(POSITIVE + RISING), user(effect("atomic: n += n")),
        "counter: Positive, counter: Rising, user: Positive, user: Rising"),
    "a path that does not write": KnownComposition(
        counter(RISING), user("Put:\n  pre: n < 9\n  eff:\n    if k > 3: n = n\n    k = 1\n"), ""),
    # I: invariants survive the steps of other applications
    "an invariant about an imported variable without a guarantee": KnownComposition(
        counter(), user(IDLE + "invariant Low: n >= 1\n"), ""),
    "an invariant about an imported variable with a guarantee": KnownComposition(
        counter(POSITIVE), user(IDLE + "invariant Low: n >= 1\n"), "counter: Positive, user: Low"),
    "an exporter's invariant that an importer breaks": KnownComposition(
        counter(more="invariant Low: n >= 1\n"), user(effect("n = 0")), ""),
    "an importer's invariant that the exporter breaks": KnownComposition(
        counter(POSITIVE, more="Reset:\n  pre: n > 3\n  eff: atomic: n = 1\n"),
        user(SEEN.replace("k = n", "atomic: k = n")),
        "counter: Positive"),
    "an exporter's invariant that a guarantee protects": KnownComposition(
        counter(POSITIVE, more="invariant Low: n >= 0\n"), user(effect("n = 1")),
        "counter: Low, counter: Positive, user: Positive"),
    "a value that was seen is still below": KnownComposition(
        counter(RISING + POSITIVE), user(SEEN),
        "counter: Rising, counter: Positive, user: Seen"),
    "a value that was seen without a step guarantee": KnownComposition(
        counter(POSITIVE), user(SEEN),
        "counter: Positive"),
    # P: step guarantees are reflexive and transitive
    "a guarantee that is not transitive": KnownComposition(
        counter(NEAR), user(effect("n = n")), ""),
    "a guarantee that is not reflexive": KnownComposition(
        counter(GROWING + "    guarantee Natural: n >= 0\n"),
        user("init:\n  k = -1\nLook:\n  pre: n > 0\n  eff: k = n\ninvariant Older: forall i in ID: k[i] < n\n"),
        "counter: Natural"),
    # A: the assumptions of all applications hold together
    "assumptions that contradict one another": KnownComposition(
        SENSOR.format(assumed="speed' > 1"), SENSOR.format(assumed="speed' < 0"), ""),
    "assumptions that agree": KnownComposition(
        SENSOR.format(assumed="speed' > 1"), SENSOR.format(assumed="speed' < 2"), "counter: Few, user: Few"),
    "assumptions that contradict one another on one robot": KnownComposition(
        SENSOR.format(assumed="speed' == pid"), SENSOR.format(assumed="speed' == pid"), "", ((0, 1), (1, 2))),
    "assumptions about pids that agree": KnownComposition(
        SENSOR.format(assumed="speed' == pid"), SENSOR.format(assumed="speed' == pid + N_SYS"),
        "counter: Few, user: Few", ((0, 1), (1,))),
    # Sensors that another application clears
    "a sensor that another application clears": KnownComposition(
        DRIVES, READS.format(claim="not seen[i] or Motion.reached[i]"), "counter: Few"),
    "a sensor that was cleared stays so": KnownComposition(
        DRIVES, READS.replace("Motion.reached\n", "not Motion.reached\n").format(
            claim="not seen[i] or not Motion.reached[i]"), "counter: Few, user: Seen"),
}  # fmt: skip
