"""Who has sent to all lets those of its computer go first that have not: all wait for the last of them."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from msgspec.structs import replace

from koordgen.runtime.config.settings import Network
from tests.runtime.net.test_udp import UNICAST, groups
from tests.runtime.net.transports import IMPLEMENTATIONS, free_ports, open_as, settings

TIMES, LEAST = 40, 6  # the system gives another process every second or third turn


@contextmanager
def a_busy_core() -> Iterator[None]:
    """This thread is on a core with another process that never rests."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    busy = subprocess.Popen([sys.executable, "-c", "print(flush=True)\nwhile True: pass"], stdout=subprocess.PIPE)
    try:
        assert busy.stdout is not None and busy.stdout.readline()
        yield
    finally:
        busy.kill()
        busy.communicate()
        os.sched_setaffinity(0, cores)


def switches() -> int:
    """How often another process got this thread's core while this one had something to do."""
    return resource.getrusage(resource.RUSAGE_THREAD).ru_nivcsw


@pytest.mark.parametrize("native", IMPLEMENTATIONS)
@pytest.mark.parametrize("network", [UNICAST, *groups()], ids=lambda network: network.transport)
@pytest.mark.parametrize(("host", "to", "gives_way"), [
    ("127.0.0.1", [1, 2], True),
    ("127.0.0.1", [1], False),  # an answer: nobody else waits for it
    ("127.0.0.2", [1, 2], False),  # alone on its computer
])  # fmt: skip
def test_a_robot_gives_way(network: Network, native: bool, host: str, to: list[int], gives_way: bool) -> None:
    given = settings(0, free_ports(4), network)
    peers = (given.peers[0], *(replace(peer, host=host) for peer in given.peers[1:]))
    transport = open_as(replace(given, peers=peers), native)
    with a_busy_core():
        before = switches()
        for _ in range(TIMES):
            transport.send(to, b"x")
        given_way = switches() - before >= LEAST
    transport.close()
    assert given_way == gives_way
