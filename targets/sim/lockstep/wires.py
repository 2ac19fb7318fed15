"""Connections in memory between simulated devices and agents of the same process.

The device's end is a `ports.Port` or a `ports.Terminal`. The agent opens the other end by the number or name that the
device reports, as with a real one. After a crash of the agent, its end is dead."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from koordgen.runtime.vehicle.platform import Unready

# Datagrams that wait at one end, as many as a Linux socket buffer holds. Further ones are lost.
MOST_WAITING = 256
EPOCH = 1_750_000_000.0  # time of day at which every lockstep run begins, in seconds since 1970
ROOM = 4096  # bytes that a serial line buffers


class MemoryPort:
    """Datagram port of a device, in memory. Implements `targets.sim.base.ports.Port`."""

    def __init__(self, number: int) -> None:
        self.number = number
        self._to_agent: deque[bytes] = deque()
        self._to_device: list[bytes] = []
        self._end: MemoryPortEnd | None = None

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

    def opened(self) -> MemoryPortEnd:
        """Return a new end for the agent. Raises Unready if another agent has one."""
        if self._end is not None:
            raise Unready(f"port {self.number} is in use")
        self._to_agent.clear()
        self._end = MemoryPortEnd(self)
        return self._end

    def left(self, end: MemoryPortEnd) -> None:
        if self._end is end:
            self._end = None

    def taken(self, end: MemoryPortEnd) -> bytes | None:
        return self._to_agent.popleft() if self._end is end and self._to_agent else None

    def given(self, data: bytes) -> bool:
        if len(self._to_device) >= MOST_WAITING:
            return False
        self._to_device.append(data)
        return True


class MemoryPortEnd:
    """Agent's end of a MemoryPort. Implements `koordgen.runtime.vehicle.simulator_services.Exchange`.

    It can still be written to after the agent's death, as a serial line's end can."""

    def __init__(self, line: MemoryPort) -> None:
        self._line = line

    def receive(self) -> bytes | None:
        return self._line.taken(self)

    def send(self, data: bytes) -> bool:
        return self._line.given(data)

    def close(self) -> None:
        self._line.left(self)


class MemorySerialLine:
    """Serial line of a device, in memory.

    Implements `targets.sim.base.ports.Terminal`; agents use `opened`."""

    def __init__(self, device: str) -> None:
        self.device = device
        self._to_agent = b""
        self._to_device = b""
        self._end: MemorySerialEnd | None = None

    def read(self) -> bytes:
        data, self._to_device = self._to_device, b""
        return data

    def write(self, data: bytes) -> int:
        taken = data[: ROOM - len(self._to_agent)]
        self._to_agent += taken
        return len(taken)

    def close(self) -> None:
        self._end = None

    def opened(self) -> MemorySerialEnd:
        """Return a new end for the agent. Raises Unready if another agent has one.

        Bytes that an earlier agent did not read are still there, as on a real line."""
        if self._end is not None:
            raise Unready(f"cannot open {self.device}: another program has it")
        self._end = MemorySerialEnd(self)
        return self._end

    def left(self, end: MemorySerialEnd) -> None:
        if self._end is end:
            self._end = None

    def taken(self, end: MemorySerialEnd) -> bytes:
        if self._end is not end:
            return b""
        data, self._to_agent = self._to_agent, b""
        return data

    def given(self, data: bytes) -> int:
        taken = data[: ROOM - len(self._to_device)]
        self._to_device += taken
        return len(taken)


class MemorySerialEnd:
    """Agent's end of a serial line. Implements `koordgen.runtime.vehicle.simulator_services.Stream`.

    It can still be written to after the agent's death: the car's watchdog uses it, too."""

    def __init__(self, cable: MemorySerialLine) -> None:
        self._cable = cable

    def read(self) -> bytes:
        return self._cable.taken(self)

    def write(self, data: bytes) -> int:
        return self._cable.given(data)

    def fileno(self) -> int:
        return -1

    def close(self) -> None:
        self._cable.left(self)


class MemoryWiring:
    """All connections of a run, on both sides. Implements `targets.sim.base.ports.Wiring`.

    Ports are numbered from 1 in the order of creation."""

    def __init__(self) -> None:
        self._lines: dict[int, MemoryPort] = {}
        self._cables: dict[str, MemorySerialLine] = {}

    def port(self) -> MemoryPort:
        line = MemoryPort(len(self._lines) + 1)
        self._lines[line.number] = line
        return line

    def terminal(self) -> MemorySerialLine:
        cable = MemorySerialLine(f"memory{len(self._cables) + 1}")
        self._cables[cable.device] = cable
        return cable

    def line(self, url: str) -> MemoryPort:
        """Return the device's port for "udp:HOST:PORT" or "udpin:HOST:PORT". Raises Unready."""
        number = url.rpartition(":")[2]
        if not number.isdecimal() or int(number) not in self._lines:
            raise Unready(f"no simulated device is at {url}")
        return self._lines[int(number)]

    def cable(self, device: str) -> MemorySerialLine:
        """Return the serial line of a device. Raises Unready."""
        if device not in self._cables:
            raise Unready(f"there is no simulated device {device}")
        return self._cables[device]


class LockstepServices:
    """Services of the process for one start of one agent.

    Implements `koordgen.runtime.vehicle.simulator_services.SimulatorServices`.

    `steps` are called at each step of the world."""

    def __init__(self, hub: MemoryWiring, clock: Callable[[], float], seed: int, iterations: int) -> None:
        self._hub = hub
        self._clock = clock
        self.seed, self.iterations = seed, iterations
        self.steps: list[Callable[[float], None]] = []
        self._opened: list[MemoryPortEnd | MemorySerialEnd] = []

    def now(self) -> float:
        return self._clock()

    def today(self) -> float:
        return EPOCH + self._clock()

    def exchange(self, url: str) -> MemoryPortEnd:
        end = self._hub.line(url).opened()
        self._opened.append(end)
        return end

    def stream(self, device: str) -> MemorySerialEnd:
        end = self._hub.cable(device).opened()
        self._opened.append(end)
        return end

    def beside(self, step: Callable[[float], None]) -> None:
        self.steps.append(step)

    def cut(self) -> None:
        """Close all that the agent had opened, after its end."""
        for end in self._opened:
            end.close()
