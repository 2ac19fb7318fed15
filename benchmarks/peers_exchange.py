"""Peers of the shared memory: raw UDP, CycloneDDS and Zenoh, each as an Exchange between N processes on loopback.

Also the harness that drives them and ours in the same way. Each peer runs with the settings that its makers recommend
for small, frequent, reliable updates, and with those that were fastest here. None authenticates data or writes to a
file. Tried, on two cores with other load:

- Zenoh, peers on TCP, express publishers. Round trip 250 us; with the low-latency transport 175 us, so it is used for
  two robots; with 16 robots some of its links never came up. UDP links, no batching, no QoS, no shared memory, one
  sending thread: 245 to 275 us, no gain. A full queue drops updates by default, so with 16 robots many rounds were
  never complete; publishers that wait (`BLOCK`) with REAL_TIME priority were the best there.
- CycloneDDS, reliable writers, a waitset, the loopback interface with multicast. Round trip 175 us (150 to 245 as the
  load of the machine changed). Synchronous delivery and one receiving thread: as fast, or faster with 16 robots (4.7
  and 4.8 ms to consistency, against 7.1 ms), so they are used. No batching, more buffer, no multicast for data, other
  heartbeats: no gain; acknowledgements that wait 1 ms: much slower with 16 robots.
"""

from __future__ import annotations

import importlib.util
import json
import os
import queue
import socket
import struct
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

PACKAGES = {"zenoh": "eclipse-zenoh", "cyclonedds": "cyclonedds"}
_HEAD = struct.Struct("<II")
Heard = list[tuple[int, int]]  # pid and round


def warm_up(delta: float) -> int:
    """Return the number of rounds before the measured ones.

    A process takes many times longer for everything that it does for the first time. A large fleet with short rounds
    needs most rounds to recover.
    """
    return max(20, round(1.0 / delta))


@dataclass(frozen=True)
class Place:
    """Setting of one robot: `size` bytes of an update, `delta` seconds between rounds, and a folder for its files.

    The last of `ports` belongs to no robot.
    """

    pid: int
    ports: Sequence[int]
    size: int
    delta: float
    folder: Path


class Exchange(Protocol):
    @property
    def missed(self) -> Sequence[int]:
        """Rounds that were published without an update, because data of earlier rounds were missing."""
        ...

    def publish(self, round_: int) -> None:
        """Send the robot's update of a round to all others."""
        ...

    def take(self, seconds: float) -> Heard:
        """Return the updates that have arrived; wait up to `seconds` for the first."""
        ...


class Raw:
    """Exchange between two robots over blocking UDP sockets, and nothing else."""

    missed = ()

    def __init__(self, place: Place) -> None:
        self._pid, self._rest = place.pid, bytes(place.size - _HEAD.size)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", place.ports[self._pid]))
        self._socket.connect(("127.0.0.1", place.ports[1 - self._pid]))

    def publish(self, round_: int) -> None:
        self._socket.send(_HEAD.pack(self._pid, round_) + self._rest)

    def take(self, seconds: float) -> Heard:
        pid, round_ = _HEAD.unpack_from(self._socket.recv(2048))
        return [(pid, round_)]


class Polled(Raw):
    """Like Raw, but without sleeping: each side polls its socket all the time, and occupies a core."""

    def __init__(self, place: Place) -> None:
        super().__init__(place)
        self._socket.setblocking(False)

    def take(self, seconds: float) -> Heard:
        while True:
            with suppress(BlockingIOError):
                return super().take(seconds)


class Zenoh:
    missed = ()

    def __init__(self, place: Place) -> None:
        import zenoh

        pid, ports, size = place.pid, place.ports, place.size

        config = zenoh.Config()
        config.insert_json5("mode", '"peer"')
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("listen/endpoints", json.dumps([f"tcp/127.0.0.1:{ports[pid]}"]))
        config.insert_json5("connect/endpoints", json.dumps([f"tcp/127.0.0.1:{p}" for p in ports[:pid]]))
        retry = {"period_init_ms": 200, "period_max_ms": 500, "period_increase_factor": 1}
        config.insert_json5("connect/retry", json.dumps(retry))
        config.insert_json5("connect/timeout_ms", "-1")
        if len(ports) == 3:
            config.insert_json5("transport/unicast/qos/enabled", "false")
            config.insert_json5("transport/unicast/lowlatency", "true")
        self._session = zenoh.open(config)
        self._arrived: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._subscriber = self._session.declare_subscriber("robot/*", self._hear)
        self._publisher = self._session.declare_publisher(
            f"robot/{pid}",
            express=True,
            congestion_control=zenoh.CongestionControl.BLOCK,
            priority=zenoh.Priority.REAL_TIME,
        )
        self._pid, self._rest = pid, bytes(size - _HEAD.size)

    def _hear(self, sample: Any) -> None:
        self._arrived.put(sample.payload.to_bytes())

    def publish(self, round_: int) -> None:
        self._publisher.put(_HEAD.pack(self._pid, round_) + self._rest)

    def take(self, seconds: float) -> Heard:
        heard: Heard = []
        try:
            arrived = self._arrived.get(timeout=seconds) if seconds > 0 else self._arrived.get_nowait()
            while True:
                pid, round_ = _HEAD.unpack_from(arrived)
                if pid != self._pid:
                    heard.append((pid, round_))
                arrived = self._arrived.get_nowait()
        except queue.Empty:
            return heard


class Cyclone:
    missed = ()

    def __init__(self, place: Place) -> None:
        os.environ["CYCLONEDDS_URI"] = (
            '<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface address="127.0.0.1" multicast="true"/>'
            "</Interfaces></General><Discovery><MaxAutoParticipantIndex>200</MaxAutoParticipantIndex></Discovery>"
            "<Internal><SynchronousDeliveryLatencyBound>inf</SynchronousDeliveryLatencyBound>"
            "<SynchronousDeliveryPriorityThreshold>-2147483648</SynchronousDeliveryPriorityThreshold>"
            "<MultipleReceiveThreads>false</MultipleReceiveThreads></Internal></Domain></CycloneDDS>"
        )
        from cyclonedds.core import InstanceState, Policy, Qos, ReadCondition, SampleState, ViewState, WaitSet
        from cyclonedds.domain import DomainParticipant
        from cyclonedds.pub import DataWriter
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic
        from cyclonedds.util import duration

        quality = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(256))
        self._type = _update_type()
        self._duration = duration
        # Each run has its own domain, so that robots of two runs do not meet.
        self._participant = DomainParticipant(place.ports[0] % 200)
        topic = Topic(self._participant, "update", self._type)
        self._writer = DataWriter(self._participant, topic, qos=quality)
        self._reader = DataReader(self._participant, topic, qos=quality)
        self._waitset = WaitSet(self._participant)
        anything = SampleState.Any | ViewState.Any | InstanceState.Any
        self._condition = ReadCondition(self._reader, anything)
        self._waitset.attach(self._condition)
        self._pid, self._rest = place.pid, "x" * (place.size - _HEAD.size)

    def publish(self, round_: int) -> None:
        self._writer.write(self._type(self._pid, round_, self._rest))

    def take(self, seconds: float) -> Heard:
        found = self._reader.take(N=256)
        if not found and seconds > 0:
            self._waitset.wait(self._duration(nanoseconds=int(seconds * 1e9)))
            found = self._reader.take(N=256)
        return [(s.pid, s.round) for s in found if s.pid != self._pid]


def _update_type() -> Any:
    from cyclonedds.idl import IdlStruct
    from cyclonedds.idl.types import uint32

    space: dict[str, Any] = {"__annotations__": {"pid": uint32, "round": uint32, "rest": str}, "__module__": __name__}
    return dataclass(type("Update", (IdlStruct,), space, typename="Update"))


Make = Callable[[Place], Exchange]
PEERS: dict[str, Make] = {"zenoh": Zenoh, "cyclonedds": Cyclone}


def missing() -> dict[str, str]:
    """Return the peers that are not installed, with the command that installs each."""
    return {
        name: f"{name} is not there: pip install 'koordgen[bench]' (or {package})"
        for name, package in PACKAGES.items()
        if importlib.util.find_spec(name) is None
    }


def meet(exchange: Exchange, n: int, limit: float = 30.0) -> None:
    """Publish until the updates of all others have arrived. Raises TimeoutError."""
    heard: set[int] = set()
    end = time.monotonic() + limit
    while time.monotonic() < end:
        exchange.publish(0)
        again = time.monotonic() + 0.2
        while (rest := again - time.monotonic()) > 0:
            heard |= {pid for pid, _ in exchange.take(rest)}
        if len(heard) == n - 1:
            exchange.publish(0)
            return
    raise TimeoutError(f"heard {len(heard)} of {n - 1} others within {limit:.0f} s")


def ping(exchange: Exchange, pid: int, count: int) -> list[float]:
    """Return the seconds of each of `count` round trips, measured by robot 0."""
    took = []
    for round_ in range(1, count + 1):
        began = time.perf_counter()
        if pid == 0:
            exchange.publish(round_)
        while not any(r == round_ for _, r in exchange.take(1.0)):
            pass
        if pid != 0:
            exchange.publish(round_)
        took.append(time.perf_counter() - began)
    return took


def keep_rounds(exchange: Exchange, n: int, delta: float, start: float, count: int) -> list[float]:
    """Return for each round the seconds from its tick until the n - 1 updates of others arrived, however late.

    Infinite if they had not arrived one second after the end.
    """
    missing = [n - 1] * (count + 1)
    missing[0] = 0  # updates of round 0 may still be in transit
    took = [float("inf")] * count

    def hear_until(end: float) -> None:
        while (rest := end - time.monotonic()) > 0:
            for _, round_ in exchange.take(rest):
                missing[round_] -= 1
                if not missing[round_]:
                    took[round_ - 1] = time.monotonic() - start - (round_ - 1) * delta

    for round_ in range(1, count + 1):
        hear_until(start + (round_ - 1) * delta)
        exchange.publish(round_)
    hear_until(start + count * delta + 1.0)
    return took
