"""A program that runs beside us, and the ends of its pipes. Importing subprocess takes longer than a query."""

from __future__ import annotations

import os
import resource
import select
import time
from collections.abc import Sequence
from contextlib import suppress

CHUNK = 1 << 16
KILLED = 9  # signal.SIGKILL: to import signal takes 0.6 ms


class Ended(Exception):
    """It has closed its output."""


def allowed(memory: int) -> int:
    """So many megabytes, or as many as we have ourselves where those are fewer."""
    own = resource.getrlimit(resource.RLIMIT_AS)[0]
    return memory if own == resource.RLIM_INFINITY else min(memory, own >> 20)


class Process:
    """What it is told waits in `unsent` until it reads; what it said, in `read`, and in `times` how much of that had
    come when."""

    def __init__(self, command: Sequence[str], memory: int) -> None:
        """Starts it, with so many megabytes at most. Raises OSError where that cannot be."""
        theirs_in, self.sink = os.pipe()
        self.source, theirs_out = os.pipe()
        silent = os.open(os.devnull, os.O_WRONLY)
        actions = [(os.POSIX_SPAWN_DUP2, end, number) for number, end in enumerate((theirs_in, theirs_out, silent))]
        try:
            self.pid = os.posix_spawnp(command[0], list(command), os.environ, file_actions=actions)
        except OSError:
            os.close(self.sink)
            os.close(self.source)
            raise
        finally:
            for end in (theirs_in, theirs_out, silent):
                os.close(end)
        os.set_blocking(self.sink, False)
        os.set_blocking(self.source, False)
        with suppress(AttributeError, OSError):  # where a process' memory cannot be limited from outside
            resource.prlimit(self.pid, resource.RLIMIT_AS, (memory << 20, memory << 20))
        self.unsent = self.read = b""
        self.times: list[tuple[int, float]] = []

    def send(self, text: str) -> None:
        """Queues some text; what the pipe takes at once goes out, and what came is read. Raises Ended."""
        self.unsent += text.encode()
        while self.unsent and self.exchange(0.0):
            pass

    def exchange(self, wait: float) -> bool:
        """Sends and reads something, as soon as that goes within so many seconds; whether it did. Raises Ended."""
        ready = select.select([self.source], [self.sink] if self.unsent else [], [], wait)
        if ready[1]:
            try:
                self.unsent = self.unsent[os.write(self.sink, self.unsent[:CHUNK]) :]
            except BrokenPipeError:
                self.unsent = b""  # its last words may tell why
        if ready[0]:
            some = os.read(self.source, CHUNK)
            if not some:
                raise Ended
            self.read += some
            self.times.append((len(self.read), time.monotonic()))
        return bool(ready[0] or ready[1])

    def came(self, word: str) -> list[float]:
        """When it said a word, each time."""
        ends, at = [], -1
        while (at := self.read.find(word.encode(), at + 1)) >= 0:
            ends.append(at + len(word))
        return [next(when for count, when in self.times if count >= end) for end in ends]

    def take(self, count: int) -> str:
        """So many bytes of what it said; the rest is let go."""
        said, self.read, self.times = self.read[:count], b"", []
        return said.decode(errors="replace").strip()

    def kill(self) -> None:
        with suppress(ProcessLookupError):
            os.kill(self.pid, KILLED)

    def end(self) -> int:
        """Kills it if it still runs; its exit status, negative for a signal."""
        self.kill()
        return self.wait()

    def wait(self) -> int:
        os.close(self.sink)
        os.close(self.source)
        return os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
