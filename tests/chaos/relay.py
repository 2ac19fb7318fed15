"""Delays and so reorders datagrams: usage: relay.py ADDRESS LONGEST PORT=HOST:PORT ...

What arrives at ADDRESS:PORT goes on to HOST:PORT after an evenly random time up to LONGEST seconds.
"""

from __future__ import annotations

import heapq
import random
import select
import socket
import sys
import time


def main(own: str, longest: float, places: list[str]) -> None:
    listening: dict[socket.socket, tuple[str, int]] = {}
    for place in places:
        port, _, to = place.partition("=")
        host, _, number = to.rpartition(":")
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        opened.bind((own, int(port)))
        listening[opened] = (host, int(number))
    waiting: list[tuple[float, int, socket.socket, bytes]] = []
    count = 0
    while True:
        rest = max(0.0, waiting[0][0] - time.monotonic()) if waiting else None
        for ready in select.select(list(listening), [], [], rest)[0]:
            count += 1
            heapq.heappush(waiting, (time.monotonic() + random.uniform(0, longest), count, ready, ready.recv(65536)))
        while waiting and waiting[0][0] <= time.monotonic():
            _, _, by, datagram = heapq.heappop(waiting)
            by.sendto(datagram, listening[by])


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]), sys.argv[3:])
