"""Sends what no robot may listen to. usage: flooder.py SECONDS RATE HOST:PORT ... (RATE: so many a second to each)"""

from __future__ import annotations

import random
import socket
import sys
import time


def main(seconds: float, rate: float, places: list[str]) -> None:
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    to = [(host, int(port)) for host, _, port in (place.rpartition(":") for place in places)]
    chance = random.Random(1)
    store = [chance.randbytes(chance.choice([0, 1, 40, 300, 1200, 1201, 9000])) for _ in range(500)]
    began, sent = time.monotonic(), 0
    while (passed := time.monotonic() - began) < seconds:
        while sent < passed * rate:
            for place in to:
                opened.sendto(chance.choice(store), place)
            sent += 1
        time.sleep(0.002)


if __name__ == "__main__":
    main(float(sys.argv[1]), float(sys.argv[2]), sys.argv[3:])
