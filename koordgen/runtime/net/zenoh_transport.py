"""Zenoh transport for networks of several hops: robots in router mode forward others' datagrams.

Only this module needs the package eclipse-zenoh."""

from __future__ import annotations

import json
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence

import zenoh

from koordgen.runtime.config.settings import Settings
from koordgen.runtime.net.transport import MOST_AT_ONCE, CannotOpen
from koordgen.runtime.net.wire import LIMIT

MOST_WAITING = 4096  # largest number of received datagrams that wait for `receive`; further datagrams are dropped
QUEUE = 16  # largest number of datagrams to one peer that wait for the network
NAP = 20e-6  # seconds of sleep for each datagram that is still missing
WAIT_BEFORE_DROP = 100  # microseconds that a send waits for room in a full queue before it drops the datagram


class ZenohTransport:
    """Zenoh transport: one topic for all robots and one for each pid, below `koordgen/APPLICATION_ID`.

    It connects only to the endpoints in the settings, without scouting or gossip. Datagrams arrive on a thread of
    Zenoh. Raises CannotOpen."""

    def __init__(self, settings: Settings) -> None:
        self._troubles: dict[str, int] = {}
        self._arrived: deque[bytes] = deque()
        self._some = threading.Event()
        try:
            self._session = zenoh.open(_config(settings))
        except zenoh.ZError as error:
            own, text = settings.peers[settings.pid], str(error).partition(" at /")[0]
            raise CannotOpen(f"zenoh of robot {own.name} ({own.host}:{own.port}): {text}") from None
        topic = f"koordgen/{settings.application_id}"
        self._all = self._publisher(f"{topic}/all")
        self._each = [self._publisher(f"{topic}/{pid}") for pid in range(len(settings.peers))]
        for name in ("all", settings.pid):
            self._session.declare_subscriber(f"{topic}/{name}", self._queue, allowed_origin=zenoh.Locality.REMOTE)

    def send(self, to: Sequence[int], datagram: bytes) -> None:
        if to:
            try:
                (self._all if len(to) > 1 else self._each[to[0]])(datagram)
            except zenoh.ZError:  # the session is closed
                self._count("send: closed")

    def receive(self) -> Sequence[bytes]:
        self._some.clear()
        arrived = self._arrived
        taken = [arrived.popleft() for _ in range(min(len(arrived), MOST_AT_ONCE))]
        if arrived:
            self._some.set()
        return taken

    def wait(self, seconds: float, expected: int = 1, gather: float = 0.0) -> None:
        begin = time.monotonic()
        until = begin + min(gather, seconds)
        while expected > 1 and (missing := expected - len(self._arrived)) > 0:
            if (left := until - time.monotonic()) <= 0:
                break
            time.sleep(min(NAP * missing, left))
        self._some.wait(max(0.0, begin + seconds - time.monotonic()))

    @property
    def troubles(self) -> dict[str, int]:
        return self._troubles.copy()  # a copy, because Zenoh's thread changes the original

    def close(self) -> None:
        self._session.close()  # type: ignore[no-untyped-call]

    def _publisher(self, topic: str) -> Callable[[bytes], None]:
        return self._session.declare_publisher(
            topic,
            congestion_control=zenoh.CongestionControl.DROP,
            reliability=zenoh.Reliability.BEST_EFFORT,
            priority=zenoh.Priority.REAL_TIME,
            express=True,  # send each datagram at once, without batching
            allowed_destination=zenoh.Locality.REMOTE,
        ).put

    def _queue(self, sample: zenoh.Sample) -> None:
        """Queue a received datagram for `receive`. Zenoh calls this method on a thread of its own."""
        if len(self._arrived) >= MOST_WAITING:
            self._count("receive: overflow")
        elif len(sample.payload) > LIMIT:  # a datagram that is too long is not copied
            self._count("receive: too long")
        else:
            self._arrived.append(sample.payload.to_bytes())
            self._some.set()

    def _count(self, reason: str) -> None:
        self._troubles[reason] = self._troubles.get(reason, 0) + 1


def _config(settings: Settings) -> zenoh.Config:
    """Return Zenoh's configuration. Raises ZError for an invalid endpoint."""
    network, pid = settings.network, settings.pid
    places = [f"udp/{_bracketed(peer.host)}:{peer.port}" for peer in settings.peers]
    own = [f"udp/{_bracketed(settings.bind)}:{settings.peers[pid].port}"] if settings.bind else [places[pid]]
    if network.mode == "client":
        own, places = [], []
    values = {
        "mode": network.mode,
        "listen/endpoints": own if network.listen is None else network.listen,
        "listen/exit_on_failure": True,
        "connect/endpoints": places[:pid] if network.connect is None else network.connect,
        # A peer connects to missing peers in the background. A client fails if it cannot reach its router at once.
        "connect/timeout_ms": 0 if network.mode == "client" else -1,
        "connect/exit_on_failure": network.mode == "client",
        "connect/retry": {"period_init_ms": 250, "period_max_ms": 1000, "period_increase_factor": 2},
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/tx/queue/size/real_time": QUEUE,
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop": WAIT_BEFORE_DROP,
    }
    config = zenoh.Config()
    for key, value in values.items():
        config.insert_json5(key, json.dumps(value))
    return config


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host
