"""Wires in memory between simulated devices and agents that live in the same process.

A device's end is a `ports.Port` or a `ports.Terminal`; the agent's is opened by the number or the name that the device
has told, as a real one is, and is dead from the moment at which its agent has crashed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from koordgen.runtime.vehicle.platform import Unready

# What a socket's buffer of Linux holds of such datagrams: what comes beyond it is lost.
MOST_WAITING = 256
EPOCH = 1_750_000_000.0  # the time of day, in seconds since 1970, at which every run in lockstep begins
ROOM = 4096  # bytes that a serial line holds


class Line:
    """A device's port and what is under way on it: `targets.sim.base.ports.Port`."""

    def __init__(self, number: int) -> None:
        self.number = number
        self._to_agent: deque[bytes] = deque()
        self._to_device: list[bytes] = []
        self._end: LineEnd | None = None

    def receive(self) -> list[bytes]:
        if not self._to_device:
            return []
        taken, self._to_device = self._to_device, []
        return taken

    def send(self, data: bytes) -> None:
        if self._end is not None and len(self._to_agent) < MOST_WAITING:
            self._to_agent.append(data)

    def close(self) -> None:
        self._end = None

    def opened(self) -> LineEnd:
        """A new end for the agent. Raises Unready when another has it."""
        if self._end is not None:
            raise Unready(f"port {self.number} is in use")
        self._to_agent.clear()
        self._end = LineEnd(self)
        return self._end

    def left(self, end: LineEnd) -> None:
        if self._end is end:
            self._end = None

    def taken(self, end: LineEnd) -> bytes | None:
        return self._to_agent.popleft() if self._end is end and self._to_agent else None

    def given(self, data: bytes) -> bool:
        if len(self._to_device) >= MOST_WAITING:
            return False
        self._to_device.append(data)
        return True


class LineEnd:
    """Implements `koordgen.runtime.vehicle.inside.Exchange`. It can be written to after the agent's death, as
    CableEnd."""

    def __init__(self, line: Line) -> None:
        self._line = line

    def receive(self) -> bytes | None:
        return self._line.taken(self)

    def send(self, data: bytes) -> bool:
        return self._line.given(data)

    def close(self) -> None:
        self._line.left(self)


class Cable:
    """A serial line: `targets.sim.base.ports.Terminal`, and the agent's `koordgen.runtime.vehicle.inside.Stream` by
    `opened`."""

    def __init__(self, device: str) -> None:
        self.device = device
        self._to_agent = b""
        self._to_device = b""
        self._end: CableEnd | None = None

    def read(self) -> bytes:
        data, self._to_device = self._to_device, b""
        return data

    def write(self, data: bytes) -> int:
        taken = data[: ROOM - len(self._to_agent)]
        self._to_agent += taken
        return len(taken)

    def close(self) -> None:
        self._end = None

    def opened(self) -> CableEnd:
        """A new end for the agent. What an agent before it did not read is still there, as on a real line. Raises
        Unready when another has it."""
        if self._end is not None:
            raise Unready(f"cannot open {self.device}: another program has it")
        self._end = CableEnd(self)
        return self._end

    def left(self, end: CableEnd) -> None:
        if self._end is end:
            self._end = None

    def taken(self, end: CableEnd) -> bytes:
        if self._end is not end:
            return b""
        data, self._to_agent = self._to_agent, b""
        return data

    def given(self, data: bytes) -> int:
        taken = data[: ROOM - len(self._to_device)]
        self._to_device += taken
        return len(taken)


class CableEnd:
    """Implements `koordgen.runtime.vehicle.inside.Stream`. It can be written to after the agent's death: its watchdog
    holds it, too."""

    def __init__(self, cable: Cable) -> None:
        self._cable = cable

    def read(self) -> bytes:
        return self._cable.taken(self)

    def write(self, data: bytes) -> int:
        return self._cable.given(data)

    def fileno(self) -> int:
        return -1

    def close(self) -> None:
        self._cable.left(self)


class Hub:
    """All wires of a run: `targets.sim.base.ports.Wiring`, and what agents open. Numbers count from 1, in the order in
    which devices are made."""

    def __init__(self) -> None:
        self._lines: dict[int, Line] = {}
        self._cables: dict[str, Cable] = {}

    def port(self) -> Line:
        line = Line(len(self._lines) + 1)
        self._lines[line.number] = line
        return line

    def terminal(self) -> Cable:
        cable = Cable(f"memory{len(self._cables) + 1}")
        self._cables[cable.device] = cable
        return cable

    def line(self, url: str) -> Line:
        """The device's port that "udp:HOST:PORT" or "udpin:HOST:PORT" names. Raises Unready."""
        number = url.rpartition(":")[2]
        if not number.isdecimal() or int(number) not in self._lines:
            raise Unready(f"no simulated device is at {url}")
        return self._lines[int(number)]

    def cable(self, device: str) -> Cable:
        """Raises Unready."""
        if device not in self._cables:
            raise Unready(f"there is no simulated device {device}")
        return self._cables[device]


class Surroundings:
    """Implements `koordgen.runtime.vehicle.inside.Inside` for one start of one agent. `steps` are called with each step
    of the world."""

    def __init__(self, hub: Hub, clock: Callable[[], float], seed: int, iterations: int) -> None:
        self._hub = hub
        self._clock = clock
        self.seed, self.iterations = seed, iterations
        self.steps: list[Callable[[float], None]] = []
        self._opened: list[LineEnd | CableEnd] = []

    def now(self) -> float:
        return self._clock()

    def today(self) -> float:
        return EPOCH + self._clock()

    def exchange(self, url: str) -> LineEnd:
        end = self._hub.line(url).opened()
        self._opened.append(end)
        return end

    def stream(self, device: str) -> CableEnd:
        end = self._hub.cable(device).opened()
        self._opened.append(end)
        return end

    def beside(self, step: Callable[[float], None]) -> None:
        self.steps.append(step)

    def cut(self) -> None:
        """The agent is gone: what it had opened is free."""
        for end in self._opened:
            end.close()
