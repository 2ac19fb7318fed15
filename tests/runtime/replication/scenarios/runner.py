"""Runner of scenarios: reads a script, carries out its commands one by one, and compares what it shows.

A script that is wrong, and one whose expectation fails, raises `ScriptError` with the file, the line, and the messages
of the last slots. The runner knows the protocol core only by `tests.runtime.replication.core`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from pathlib import Path
from textwrap import shorten

from tests.runtime.replication.core import KINDS, STORE, TICKS, Event, Fleet, Sent, Violation
from tests.runtime.replication.scenarios.network import ROUNDS_OF_TALK, Link, Network

FOLDER = Path(__file__).parent
RECENT, WIDTH = 12, 150  # lines of messages in an error, and how long they are
INDENT = "    "  # of the output of `show`; commands have none


class ScriptError(Exception):
    """The message begins with the place: FILE:LINE."""


class Failure(Exception):
    """A command cannot be carried out, or its expectation does not hold."""


def scripts() -> list[Path]:
    return sorted(FOLDER.glob("*.txt"))


def run(path: Path) -> str:
    """Run a script; returns its text with the output that its `show` commands have now. Raises ScriptError."""
    return run_text(path.read_text(), path.name)


def run_text(text: str, name: str, rewrite: bool = False) -> str:
    """As `run`; `rewrite`: output that differs is no error."""
    lines, done, scenario, at = text.splitlines(), list[str](), Scenario(), 0
    while at < len(lines):
        line, place = lines[at], f"{name}:{at + 1}"
        done.append(line)
        at += 1
        try:
            if line.startswith(INDENT) and line.strip():
                raise Failure("an indented line is the output of `show`, and there is none before it")
            shown = scenario.do(line.split("#")[0].split())
        except (Failure, Violation) as failure:
            raise ScriptError(f"{place}: {failure}\n  {line.strip()}{_recent(scenario)}") from None
        except Exception as error:
            raise ScriptError(f"{place}: {error!r}\n  {line.strip()}{_recent(scenario)}") from error
        if shown is None:
            continue
        stands = list[str]()
        while at < len(lines) and lines[at].startswith(INDENT):
            stands.append(lines[at].removeprefix(INDENT))
            at += 1
        if stands != shown and not rewrite:
            what = "\n".join([f"  - {x}" for x in stands] + [f"  + {x}" for x in shown])
            raise ScriptError(f"{place}: the output differs (- stands, + is)\n{what}{_recent(scenario)}")
        done += [INDENT + line for line in shown]
    return "\n".join(done) + "\n"


def _recent(scenario: Scenario) -> str:
    lines = told(scenario.network.sent)
    more = [f"    ... {len(lines) - RECENT} lines before"] if len(lines) > RECENT else []
    found = "\n".join([*more, *[f"    {shorten(line, WIDTH, placeholder=' ...')}" for line in lines[-RECENT:]]])
    return f"\n  messages since the last step:\n{found}" if found else ""


def told(messages: Iterable[Sent]) -> list[str]:
    """Messages in words, the same one to several robots in one line."""
    groups: list[tuple[Sent, set[int]]] = []
    for m in messages:
        first, to = groups[-1] if groups else (m, {m.to})
        if (first.sender, first.kind, first.text) == (m.sender, m.kind, m.text) and m.to not in to:
            to.add(m.to)
        else:
            groups.append((m, {m.to}))
    return [f"{m.sender}->{_set(to)} {m.kind}: {m.text}" for m, to in groups]


def _set(pids: Iterable[int]) -> str:
    return "{" + ",".join(map(str, sorted(pids))) + "}"


def number(word: str) -> int:
    try:
        return int(word)
    except ValueError:
        raise Failure(f"{word!r} is no number") from None


class Scenario:
    """The state of one script: a fleet, its network, the present slot."""

    def __init__(self) -> None:
        self.network = Network()
        self.slot = 0  # slots that have begun
        self.crashed: set[int] = set()
        self.paused: set[int] = set()
        self._made: Fleet | None = None
        self._settings: dict[str, int] = {}
        self._late = 0.0

    @property
    def fleet(self) -> Fleet:
        if self._made is None:
            raise Failure("a script begins with `robots N`")
        return self._made

    def do(self, words: list[str]) -> list[str] | None:
        """Carry out a command; returns the output of `show`. Raises Failure."""
        if not words:
            return None
        name, rest = words[0], words[1:]
        if name == "show":
            return self._show(rest)
        command = COMMANDS.get(name)
        if command is None:
            raise Failure(f"no command {name!r}: there are {', '.join(sorted({*COMMANDS, 'show'}))}")
        command(self, rest)
        return None

    # Words of a command.

    def pid(self, word: str) -> int:
        pid = number(word)
        if not 0 <= pid < self.fleet.n:
            raise Failure(f"no robot {word}: there are 0 to {self.fleet.n - 1}")
        return pid

    def pids(self, word: str) -> frozenset[int]:
        """Read `2`, `{0,1}`, or `*` for all."""
        if word == "*":
            return frozenset(range(self.fleet.n))
        inner = word[1:-1] if word.startswith("{") and word.endswith("}") else word
        return frozenset(self.pid(each) for each in inner.split(",") if each)

    def link(self, words: list[str]) -> Link:
        """Read `0->1`, `0-1` (both ways) or `*` (all), and perhaps a kind of message."""
        if not words or len(words) > 2:
            raise Failure("expected LINK [KIND], for example 0->1 nack")
        place, kind = words[0], words[1] if len(words) == 2 else None
        if kind is not None and kind not in KINDS:
            raise Failure(f"no kind of message {kind!r}: there are {', '.join(KINDS)}")
        both = "->" not in place
        left, found, right = place.partition("-" if both else "->")
        if not found and left != "*":
            raise Failure(f"{place!r} is no link: expected 0->1, 0-1 or *")
        senders, receivers = self.pids(left), self.pids(right or "*")
        pairs = {(a, b) for a in senders for b in receivers if a != b}
        return Link(frozenset(pairs | ({(b, a) for a, b in pairs} if both else set())), kind)

    def present(self, words: list[str]) -> list[int]:
        """Read which robots are meant; without a word all that run."""
        if len(words) > 1:
            raise Failure(f"too many words: {' '.join(words[1:])}")
        if words:
            return sorted(self.pids(words[0]))
        return [p for p in range(self.fleet.n) if p not in self.crashed]

    # The course of time.

    def tick(self, slots: int) -> None:
        """In each slot all robots that run do what is due, and hear what was sent, until nothing is in flight."""
        self.network.sent.clear()
        for _ in range(slots):
            self.slot += 1
            self._settle()

    def _settle(self) -> None:
        """Let robots hear what waits, do what is due, and talk until nothing is in flight."""
        arrived = self._arriving()
        for _ in range(ROUNDS_OF_TALK):
            self._hear(arrived)
            self._poll()
            arrived = self._arriving()
            if not arrived:
                return
        raise Failure(f"robots still talk after {ROUNDS_OF_TALK} passes in one slot")

    def _arriving(self) -> list[Sent]:
        """Take what arrives; what is for a robot that sleeps waits for it."""
        network = self.network
        waiting = [m for m in network.flying if m.to in self.paused]
        network.flying = [m for m in network.flying if m.to not in self.paused]
        arrived = network.arriving()
        network.flying += waiting
        return arrived

    def _poll(self) -> None:
        for pid in range(self.fleet.n):
            if pid not in self.crashed | self.paused:
                self.network.send(self.fleet.poll(pid, self.slot - 1))

    def _hear(self, messages: Collection[Sent]) -> None:
        for message in messages:
            if message.to not in self.crashed:
                self.network.send(self.fleet.deliver(message))

    # Commands.

    def robots(self, words: list[str]) -> None:
        if self._made is not None or len(words) != 1:
            raise Failure("expected `robots N`, once, after `timeout` and `room`")
        self._made = Fleet(number(words[0]), **self._settings)

    def setting(self, name: str, words: list[str]) -> None:
        if self._made is not None or len(words) != 1:
            raise Failure(f"expected `{name} N` before `robots`")
        self._settings[name] = number(words[0])

    def round(self, words: list[str]) -> None:
        rounds = number(words[0]) if words else 1
        end = (self.slot // TICKS + rounds) * TICKS
        self.tick(end - self.slot)

    def until(self, words: list[str]) -> None:
        """Go on to the beginning of a round."""
        begins = (number(words[0]) - 1) * TICKS if words else 0
        if begins < self.slot:
            raise Failure(f"expected `until ROUND`, a later round than {self.slot // TICKS + 1}")
        self.tick(begins - self.slot)

    def deliver(self, words: list[str]) -> None:
        """Deliver what is delayed; then everyone answers as far as that is not delayed, too."""
        link = self.link(words or ["*"])
        self.network.sent.clear()
        self._hear(self.network.take_delayed(link.covers))
        self._settle()

    def rule(self, name: str, words: list[str]) -> None:
        self.network.rules.append((name, self.link(words)))

    def cut(self, words: list[str]) -> None:
        """Drop everything between two groups of robots, in both directions."""
        if len(words) != 2:
            raise Failure("expected `cut ROBOTS ROBOTS`, for example cut 0 {1,2}")
        self.rule("drop", [f"{words[0]}-{words[1]}"])

    def heal(self, words: list[str]) -> None:
        self.network.heal()

    def reorder(self, words: list[str]) -> None:
        self.network.newest_first = True

    def crash(self, words: list[str]) -> None:
        for pid in self.present(words):
            self.crashed.add(pid)
            self.network.lose(pid)

    def restart(self, words: list[str]) -> None:
        for pid in self.present(words):
            self.network.lose(pid)
            self.fleet.restart(pid)
            self.crashed.discard(pid)

    def forget(self, words: list[str]) -> None:
        for pid in self.present(words):
            self.fleet.forget(pid)

    def leave(self, words: list[str]) -> None:
        for pid in self.present(words):
            self.fleet.leave(pid)

    def pause(self, words: list[str]) -> None:
        self.paused |= set(self.present(words))

    def resume(self, words: list[str]) -> None:
        self.paused -= set(self.present(words))

    def event(self, words: list[str]) -> None:
        """Set the event that robots run from now on, in each round in which they can."""
        if len(words) < 2 or words[1] not in ("none", "plain", "atomic"):
            raise Failure("expected `event ROBOTS none|plain|atomic [once] [quiet] [stop] [lock=N] [VARIABLE=N]`")
        made: dict[str, int] = {}
        for word in words[2:]:
            name, found, value = word.partition("=")
            if found and name not in ("lock", *STORE):
                raise Failure(f"no variable {name!r}: there are {', '.join(STORE)}")
            if not found and name not in ("once", "quiet", "stop"):
                raise Failure(f"{word!r} is nothing of an event")
            made[name] = number(value) if found else 1
        lock = made.pop("lock", 0) if words[1] == "atomic" else -1
        flags = {name: name in made for name in ("once", "quiet", "stop")}
        writes = {name: value for name, value in made.items() if name in STORE}
        event = Event(lock, not flags["quiet"], flags["stop"], flags["once"], writes)
        for pid in self.pids(words[0]):
            self.fleet.set_event(pid, None if words[1] == "none" else event)

    def expect(self, words: list[str]) -> None:
        check = EXPECTATIONS.get(words[0]) if words else None
        if check is None:
            raise Failure(f"expected one of: expect {', '.join(sorted(EXPECTATIONS))}")
        check(self, words[1:])

    # Expectations.

    def expect_view(self, words: list[str]) -> None:
        """`view NUMBER MEMBERS [from ROUND] [ROBOTS]`"""
        if len(words) < 2:
            raise Failure("expected `expect view NUMBER MEMBERS [from ROUND] [ROBOTS]`")
        since = number(words[3]) if words[2:3] == ["from"] and len(words) > 3 else None
        for pid in self.present(words[4:] if since is not None else words[2:]):
            view = self.fleet.view(pid)
            good = (view.number, view.robots) == (number(words[0]), self.pids(words[1]))
            if not good or since not in (None, view.since):
                raise Failure(f"robot {pid} goes by view {view.number} {_set(view.robots)} from {view.since}")

    def each(self, words: list[str], name: str, see: Callable[[int], object]) -> None:
        """`NAME VALUE [ROBOTS]`"""
        if not words:
            raise Failure(f"expected `expect {name} VALUE [ROBOTS]`")
        for pid in self.present(words[1:]):
            if (seen := see(pid)) is not None and str(seen) != words[0]:
                raise Failure(f"{name} of robot {pid} is {seen}")
            if seen is None and words[0] != "none":
                raise Failure(f"robot {pid} has no {name}")

    def expect_store(self, words: list[str]) -> None:
        """`store VARIABLE VALUE [ROBOTS]`; the slots of an allread variable as (1,2,3)."""
        if len(words) < 2 or words[0] not in STORE:
            raise Failure(f"expected `expect store VARIABLE VALUE [ROBOTS]`, a variable of {', '.join(STORE)}")

        def see(pid: int) -> str | None:
            store = self.fleet.store(pid)
            return None if store is None else str(store[words[0]]).replace(" ", "")

        self.each(words[1:], words[0], see)

    def expect_skipped(self, words: list[str]) -> None:
        """`skipped ROBOTS REASON`: a part of the reason; `no`: no reason."""
        if len(words) < 2:
            raise Failure("expected `expect skipped ROBOTS REASON`")
        for pid in self.pids(words[0]):
            reason, wanted = self.fleet.skipped(pid), " ".join(words[1:])
            if (wanted not in (reason or "")) if wanted != "no" else reason is not None:
                raise Failure(f"robot {pid} skipped its last round for: {reason}")

    def expect_sent(self, words: list[str]) -> None:
        """`sent KIND LINK [COUNT] [saying TEXT]`: since the last step; COUNT is one for each receiver."""
        text = " ".join(words[words.index("saying") + 1 :]) if "saying" in words else None
        words = words[: words.index("saying")] if text is not None else words
        if not 2 <= len(words) <= 3:
            raise Failure("expected `expect sent KIND LINK [COUNT] [saying TEXT]`")
        link = self.link([words[1], words[0]])
        found = [m for m in self.network.sent if link.covers(m) and (text is None or text in m.text)]
        if (len(found) != number(words[2])) if len(words) == 3 else not found:
            raise Failure(f"{len(found)} such messages were sent")
        missing = link.pairs - {(m.sender, m.to) for m in found}
        if len(words) < 3 and missing and words[1] != "*":
            raise Failure(f"none was sent on {', '.join(f'{a}->{b}' for a, b in sorted(missing))}")

    # What is shown.

    def _show(self, words: list[str]) -> list[str]:
        what, rest = words[:1], words[1:]
        if what == ["state"]:
            return [self._state(pid) for pid in self.present(rest)]
        if what == ["messages"]:
            link = self.link(rest or ["*"])
            return told([m for m in self.network.sent if link.covers(m)]) or ["none"]
        raise Failure("expected `show state [ROBOTS]` or `show messages [LINK [KIND]]`")

    def _state(self, pid: int) -> str:
        fleet, view = self.fleet, self.fleet.view(pid)
        parts = [f"{pid}: round {fleet.round(pid)}, {fleet.role(pid)}"]
        if pid in self.crashed:
            return f"{pid}: crashed"
        parts.append(f"view {view.number} {_set(view.robots)} from {view.since}{', frozen' * fleet.is_frozen(pid)}")
        if (store := fleet.store(pid)) is not None:
            parts.append(f"applied {fleet.applied(pid)}")
            parts.append(" ".join(f"{name}={str(store[name]).replace(' ', '')}" for name in STORE))
        return ", ".join(parts)


Command = Callable[[Scenario, list[str]], None]

COMMANDS: dict[str, Command] = {
    "robots": Scenario.robots,
    "timeout": lambda s, words: s.setting("timeout", words),
    "room": lambda s, words: s.setting("room", words),
    "tick": lambda s, words: s.tick(number(words[0]) if words else 1),
    "round": Scenario.round,
    "until": Scenario.until,
    "deliver": Scenario.deliver,
    "drop": lambda s, words: s.rule("drop", words),
    "delay": lambda s, words: s.rule("delay", words),
    "duplicate": lambda s, words: s.rule("duplicate", words),
    "reorder": Scenario.reorder,
    "cut": Scenario.cut,
    "heal": Scenario.heal,
    "crash": Scenario.crash,
    "restart": Scenario.restart,
    "forget": Scenario.forget,
    "leave": Scenario.leave,
    "pause": Scenario.pause,
    "resume": Scenario.resume,
    "event": Scenario.event,
    "expect": Scenario.expect,
}


def _joined(values: Iterable[object]) -> str:
    return ",".join(map(str, values)) or "none"


EXPECTATIONS: dict[str, Command] = {
    "view": Scenario.expect_view,
    "store": Scenario.expect_store,
    "skipped": Scenario.expect_skipped,
    "sent": Scenario.expect_sent,
    "applied": lambda s, words: s.each(words, "applied", s.fleet.applied),
    "settled": lambda s, words: s.each(words, "settled", s.fleet.settled),
    "kept": lambda s, words: s.each(words, "kept", lambda pid: len(s.fleet.kept_rounds(pid))),
    "role": lambda s, words: s.each(words, "role", s.fleet.role),
    "round": lambda s, words: s.each(words, "round", s.fleet.round),
    "frozen": lambda s, words: s.each(words, "frozen", lambda pid: "yes" if s.fleet.is_frozen(pid) else "no"),
    "stopped": lambda s, words: s.each(words, "stopped", lambda pid: "yes" if s.fleet.is_stopped(pid) else "no"),
    "over": lambda s, words: s.each(words, "over", lambda pid: "yes" if s.fleet.is_over(pid) else "no"),
    "holds": lambda s, words: s.each(words, "holds", lambda pid: "yes" if s.fleet.holding(pid) else "no"),
    "output": lambda s, words: s.each(words, "output", lambda pid: next(reversed(s.fleet.outputs(pid)), None)),
    "lost-contention": lambda s, words: s.each(words, "lost-contention", s.fleet.lost_contention),
}
