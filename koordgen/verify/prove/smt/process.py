"""Child process with pipes.

The module subprocess is not used, because its import takes longer than a query to the solver.
"""

from __future__ import annotations

import os
import resource
import select
import time
from collections.abc import Sequence
from contextlib import suppress

CHUNK = 1 << 16
KILLED = 9  # signal.SIGKILL as a number: the import of the module signal takes 0.6 ms


class ProcessEnded(Exception):
    """Raised if the child process has closed its output."""


def memory_limit(memory: int) -> int:
    """Return `memory` in megabytes, or the limit of this process if it is lower."""
    own = resource.getrlimit(resource.RLIMIT_AS)[0]
    return memory if own == resource.RLIM_INFINITY else min(memory, own >> 20)


class Process:
    """Child process.

    `unsent`: input that the process has not read yet.
    `read`: output of the process that the caller has not received yet.
    `times`: pairs of a length of `read` and the time when `read` reached this length."""

    def __init__(self, command: Sequence[str], memory: int) -> None:
        """Start the command with at most `memory` megabytes. Raises OSError if the command cannot start."""
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
        with suppress(AttributeError, OSError):  # some systems cannot limit the memory of another process
            resource.prlimit(self.pid, resource.RLIMIT_AS, (memory << 20, memory << 20))
        self.unsent = self.read = b""
        self.times: list[tuple[int, float]] = []

    def send(self, text: str) -> None:
        """Queue text, write as much as the pipe accepts, and read pending output. Raises ProcessEnded."""
        self.unsent += text.encode()
        while self.unsent and self.exchange(0.0):
            pass

    def exchange(self, wait: float) -> bool:
        """Write input or read output within `wait` seconds. Return whether a pipe was ready.

        Raises ProcessEnded."""
        ready = select.select([self.source], [self.sink] if self.unsent else [], [], wait)
        if ready[1]:
            try:
                self.unsent = self.unsent[os.write(self.sink, self.unsent[:CHUNK]) :]
            except BrokenPipeError:
                self.unsent = b""  # The process reads no more input, but its remaining output may explain why it ended.
        if ready[0]:
            some = os.read(self.source, CHUNK)
            if not some:
                raise ProcessEnded
            self.read += some
            self.times.append((len(self.read), time.monotonic()))
        return bool(ready[0] or ready[1])

    def came(self, word: str) -> list[float]:
        """Return the arrival time of each occurrence of a word in the output."""
        ends, at = [], -1
        while (at := self.read.find(word.encode(), at + 1)) >= 0:
            ends.append(at + len(word))
        return [next(when for count, when in self.times if count >= end) for end in ends]

    def receive(self, count: int) -> str:
        """Return the first `count` bytes of the output as text, and drop the remaining output."""
        output, self.read, self.times = self.read[:count], b"", []
        return output.decode(errors="replace").strip()

    def kill(self) -> None:
        with suppress(ProcessLookupError):
            os.kill(self.pid, KILLED)

    def end(self) -> int:
        """Kill the process if it still runs. Return its exit status; a signal's number is negative."""
        self.kill()
        return self.wait()

    def wait(self) -> int:
        os.close(self.sink)
        os.close(self.source)
        return os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
