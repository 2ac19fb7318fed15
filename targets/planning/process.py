"""Planner interface for platforms, with two implementations.

`Beside` runs the planner in a child process, `Inside` in the agent's own process.
"""

from __future__ import annotations

import os
import re
import select
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path as FilePath
from typing import Protocol

import msgspec

from koordgen.runtime.values.points import Point, transmissible
from koordgen.runtime.vehicle.platform import Unready
from koordgen.runtime.vehicle.simulator_services import SimulatorServices as Surroundings
from targets.planning.ask import BadPlanner, Judge, judging
from targets.planning.pipe import Answer, Order, Question, Unframed, framed
from targets.planning.world import Path, Scene, World

JUDGE = "targets.planning.ask:PlannerJudge"  # default class that calls a planner and checks its paths
SHARE = 0.7  # share of the time budget that the planner gets; the rest is for pipes and for the check of the path
PATIENCE = 1.0  # seconds without an answer after which a planner's process is killed and restarted
STARTING = 30.0  # seconds within which a planner must be created; a slow computer needs some seconds to load packages
PAUSE = 1.0  # minimum seconds between two starts of the planner's process


class Planning(Protocol):
    """Interface of a planner to a platform.

    The platform calls `start`, then `poll` often, then `plan` or `ask` once `ready` is set, and finally `close`."""

    ready: bool

    @property
    def waiting(self) -> bool:
        """Return whether a question to the planner has no answer yet."""
        ...

    def start(self) -> None: ...

    def poll(self) -> None:
        """Process the planner's answers without blocking.

        Raises Unready if the planner could not be created at the start."""
        ...

    def plan(self, start: Point, goal: Point, scene: Scene, more: bytes = b"") -> Path:
        """Return the planned path. Return () if there is no path, or the planner is late or not running.

        `log_lines` gives the reason."""
        ...

    def ask(self, start: Point, goal: Point, scene: Scene, more: bytes, seconds: float) -> bool:
        """Send a question without waiting for the answer. Return False if the planner is busy or not running.

        An answer to an earlier question is dropped."""
        ...

    def answer(self) -> Answer | None:
        """Return the last answer to `ask` or `plan`, once; None if there is no new answer."""
        ...

    def log_lines(self) -> list[str]:
        """Return problems since the last call, for the log."""
        ...

    def close(self) -> None: ...


def made(planning: Planning, sleep: Callable[[float], None]) -> None:
    """Start a planner and wait until it is ready. Raises Unready."""
    planning.start()
    for _ in range(round(STARTING / 0.05)):
        planning.poll()
        if planning.ready:
            return
        sleep(0.05)
    raise Unready(f"the planner was not ready within {STARTING:.0f} s")


class PlannerLog:
    """Log lines of a planner. A reason for failed calls is logged once, until another call succeeds.

    Reasons that differ only in their numbers count as one reason."""

    def __init__(self) -> None:
        self._lines: list[str] = []
        self._known: set[str] = set()

    def add(self, line: str) -> None:
        self._lines.append(line)

    def called(self, reason: str) -> None:
        """Record a call of the planner. `reason`: why the call failed; "" if it succeeded."""
        kind = re.sub(r"[-\d.]+", "", reason)
        if not reason:
            self._known.clear()
        elif kind not in self._known:
            self._known.add(kind)
            self._lines.append(f"no path: {reason}")

    def drain(self) -> list[str]:
        told, self._lines = self._lines, []
        return told


class Inside:
    """Planner in the agent's own process, for tests and for simulators that control time.

    Such a simulator limits the planner's work by iterations."""

    def __init__(self, name: str, world: World, budget: float, judge: str = JUDGE) -> None:
        self._name, self._world, self._budget, self._judge = name, world, budget, judge
        self._asked: Judge | None = None
        self._answer: Answer | None = None
        self._log = PlannerLog()
        self.ready = self.waiting = False

    def start(self) -> None:
        try:
            self._asked = judging(self._judge, self._name, self._world)
        except BadPlanner as error:
            raise Unready(str(error)) from None
        self.ready = True

    def poll(self) -> None:
        """Do nothing, because each call of the planner completes at once."""

    def plan(self, start: Point, goal: Point, scene: Scene, more: bytes = b"") -> Path:
        if not self.ask(start, goal, scene, more, SHARE * self._budget) or self._answer is None:
            return ()
        self._log.called(self._answer.reason)
        return self._answer.path

    def ask(self, start: Point, goal: Point, scene: Scene, more: bytes, seconds: float) -> bool:
        if self._asked is None:
            return False
        self._answer = self._asked.serve(Question(0, start, goal, scene, seconds, more))
        return True

    def answer(self) -> Answer | None:
        told, self._answer = self._answer, None
        return told

    def log_lines(self) -> list[str]:
        return self._log.drain()

    def close(self) -> None:
        self.ready = False


def bounded(inside: Surroundings, name: str, world: World, budget: float, judge: str = JUDGE) -> Inside:
    """Return a deterministic planner for a simulator.

    The planner has a seed, and a limit of iterations instead of time."""
    world = msgspec.structs.replace(world, seed=inside.seed, iterations=inside.iterations)
    return Inside(name, world, budget, judge)


class Beside:
    """Planner in a child process.

    A call waits for `budget` seconds at most; a later answer is dropped. The child is restarted if it has died, or has
    not answered for PATIENCE seconds. `folders`: folders in which the child searches for modules."""

    def __init__(
        self,
        name: str,
        world: World,
        budget: float,
        judge: str = JUDGE,
        folders: tuple[FilePath, ...] = (FilePath(__file__).resolve().parents[2],),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._order, self._budget = Order(name, world, judge), budget
        self._folders, self._clock = folders, clock
        self._child: subprocess.Popen[bytes] | None = None
        self._killed: list[subprocess.Popen[bytes]] = []  # killed children that have not ended yet
        self._incoming = Unframed()
        self._outgoing = b""  # bytes that are not yet written to the child
        self._into = self._from = -1  # descriptors of the child's standard input and output
        self._begun = 0.0  # time at which the present child was started
        self._made = False  # whether a planner was created once; if so, a child that dies is replaced
        self._number = 0
        self._asked_at: float | None = None  # time at which the pending question was sent; None if there is none
        self._answer: Answer | None = None
        self._log = PlannerLog()
        self.ready = False

    @property
    def pid(self) -> int:
        """Process id of the child; 0 if there is none."""
        return self._child.pid if self._child is not None else 0

    @property
    def waiting(self) -> bool:
        """Return whether a question to the child has no answer yet."""
        return self._asked_at is not None

    def start(self) -> None:
        """Start the child process, which is ready once it has loaded its packages and created the planner."""
        child = FilePath(__file__).with_name("child.py")
        command = [sys.executable, "-B", str(child), *map(str, self._folders)]
        self._begun = self._clock()
        try:
            # The child gets its own session, so that Ctrl-C in the agent's terminal reaches the agent only.
            self._child = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True, bufsize=0
            )
        except OSError as error:
            self._lose(f"cannot be started: {error.strerror or error}")
            return
        self._incoming, self._asked_at = Unframed(), None
        assert self._child.stdin is not None and self._child.stdout is not None
        self._into, self._from = self._child.stdin.fileno(), self._child.stdout.fileno()
        for end in (self._into, self._from):
            os.set_blocking(end, False)
        self._outgoing = framed(self._order)
        self._send()

    def poll(self) -> None:
        """Process the child's answers, end a child that hangs, and replace a child that has ended."""
        self._killed = [child for child in self._killed if child.poll() is None]
        if self._child is None:
            if self._made and self._clock() - self._begun > PAUSE:
                self.start()
            return
        self._send()
        self._receive()
        now = self._clock()
        if self._asked_at is not None and now - self._asked_at > PATIENCE:
            self._lose(f"has not answered for {PATIENCE:g} s")
        elif self.pid and not self.ready and now - self._begun > STARTING:
            self._lose(f"was not ready within {STARTING:.0f} s")

    def plan(self, start: Point, goal: Point, scene: Scene, more: bytes = b"") -> Path:
        """Ask the child for a path, and wait for it `budget` seconds at most; () if there is no path."""
        deadline = self._clock() + self._budget
        try:
            if not self.ask(start, goal, scene, more, SHARE * self._budget):
                self._log.called("the planner is " + ("still at the last question" if self.ready else "not running"))
                return ()
            while self._unanswered() and (left := deadline - self._clock()) > 0:
                select.select([self._from], [self._into] if self._outgoing else [], [], left)
                self._send()
                self._receive()
        except BaseException:  # an event that is out of time is interrupted at any place, perhaps within a message
            self._lose("was interrupted in a call")
            raise
        return self._judged(self._answer, start, goal)

    def ask(self, start: Point, goal: Point, scene: Scene, more: bytes, seconds: float) -> bool:
        """Send a question to the child. Return False if the child is busy or not ready."""
        self.poll()
        if not self.ready or self.waiting:
            return False
        self._number += 1
        self._answer, self._asked_at = None, self._clock()
        self._outgoing = framed(Question(self._number, start, goal, scene, seconds, more))
        self._send()
        return True

    def answer(self) -> Answer | None:
        """Return the child's last answer, once; None if there is no new answer."""
        told, self._answer = self._answer, None
        return told

    def _judged(self, answer: Answer | None, start: Point, goal: Point) -> Path:
        if answer is None:
            if self._child is not None:
                self._log.called(f"the planner did not answer within {self._budget * 1e3:.0f} ms")
            return ()
        path = answer.path
        if path and not (transmissible(path) and len(path) > 1 and path[0] == start and path[-1] == goal):
            self._log.called("the planner's answer is no path from the start to the goal")
            return ()
        self._log.called(answer.reason)
        return path

    def log_lines(self) -> list[str]:
        """Return log lines on failed calls and on lost children since the last call."""
        return self._log.drain()

    def close(self) -> None:
        """End the child process. Idempotent."""
        self._end()
        for child in self._killed:
            with suppress(subprocess.TimeoutExpired):
                child.wait(timeout=0.5)
        self._killed.clear()

    def _unanswered(self) -> bool:
        return self._asked_at is not None and self._answer is None

    def _send(self) -> None:
        """Write as many of the pending bytes as the child's pipe accepts now."""
        while self._outgoing:
            try:
                self._outgoing = self._outgoing[os.write(self._into, self._outgoing) :]
            except BlockingIOError:
                return
            except OSError:
                self._lose("ended by itself")

    def _receive(self) -> None:
        """Process the child's answers that have arrived, without waiting."""
        while self._child is not None:
            try:
                data = os.read(self._from, 1 << 16)
            except BlockingIOError:
                return
            if not data:
                self._lose("ended by itself")
                return
            try:
                for message in self._incoming.feed(data):
                    self._accept(msgspec.msgpack.decode(message, type=Answer))
            except (ValueError, RecursionError):  # errors of msgspec are ValueErrors, too
                self._lose("answered with a malformed message")

    def _accept(self, answer: Answer) -> None:
        if answer.number == 0 and not self.ready:
            if answer.reason:
                self._lose(answer.reason)
            else:
                self.ready = self._made = True
        elif answer.number == self._number:
            self._answer, self._asked_at = answer, None

    def _lose(self, why: str) -> None:
        """End a failed child process, which `poll` replaces later.

        Raises Unready if no planner was ever created."""
        self._end()
        if not self._made:
            raise Unready(why if "planner" in why else f"the planner {self._order.name} {why}")
        self._log.add(f"the planner {why}; it is started again")

    def _end(self) -> None:
        self.ready, self._asked_at, self._outgoing = False, None, b""
        child, self._child = self._child, None
        if child is None:
            return
        with suppress(OSError):
            child.kill()
        for end in (child.stdin, child.stdout):
            if end is not None:
                with suppress(OSError):
                    end.close()
        self._killed.append(child)  # `poll` later waits for the child's end, so that the agent does not block
