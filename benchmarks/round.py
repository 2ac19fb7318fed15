"""CPU cost of an agent's round, beside the bare exchange of the same bytes: `python benchmarks/round.py`.

Five agents run LineForm on the in-memory transport: event, shared memory, MAC, trace, a monitor hook, polls of a body
that does nothing. Then each robot runs three applications: LineForm three times, each with its own variables. In the
same run, the same five datagrams of a round are sent over loopback UDP: once sealed and packed with msgpack and BLAKE2s
and nothing else, and once pickled without authentication, as older open middleware did.
"""

from __future__ import annotations

import argparse
import json
import pickle
import socket
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from hashlib import blake2s
from pathlib import Path

import msgspec

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.fixtures.fleet import KEY, FakePlatform, Fleet
from benchmarks.fixtures.lineform import PROGRAM
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.program.fleet_program import FleetApplication, FleetProgram
from koordgen.runtime.program.program import Program
from koordgen.runtime.values.points import Point

N = 5
Update = tuple[int, int, list[float], int]


class Still(FakePlatform):
    """Body that is polled once a round and does nothing: the cost of a real body belongs to its target."""

    period = 0.1


def composed(applications: int) -> FleetProgram:
    """Return LineForm as several applications on all robots, each with its own variables."""
    members, locks = tuple(range(N)), tuple(range(len(PROGRAM.locks)))
    names = [f"application{number}" for number in range(applications)]
    made = [FleetApplication(name, replace(PROGRAM, name=name), members, locks=locks) for name in names]
    return FleetProgram(tuple(made), N, PROGRAM.program_hash, PROGRAM.interface_hash)


def agents(rounds: int, program: Program | FleetProgram = PROGRAM) -> float:
    """Return CPU seconds of one agent's round."""
    fleet = Fleet(n=N, conditions=Conditions(delay=0.001), program=program)
    for pid in range(N):
        fleet.boot(pid, Still(Point(float(pid))))
    fleet.run_rounds(20)
    began = time.process_time()
    fleet.run_rounds(20 + rounds)
    spent = time.process_time() - began
    assert all(len(r.records) >= rounds for r in fleet.robots.values())
    return spent / rounds / N


def exchange(rounds: int, pack: Callable[[Update], bytes], unpack: Callable[[bytes], Update]) -> float:
    """Return CPU seconds of one robot's share of a round: pack once, send to the others, receive and unpack theirs."""
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(N)]
    try:
        for s in sockets:
            s.bind(("127.0.0.1", 0))
            s.settimeout(5.0)
        places = [s.getsockname() for s in sockets]
        began = time.process_time()
        for round_ in range(rounds):
            for pid, s in enumerate(sockets):
                datagram = pack((pid, round_, [1.5, 2.5, 0.0], pid))
                for other in range(N):
                    if other != pid:
                        s.sendto(datagram, places[other])
            for s in sockets:
                for _ in range(N - 1):
                    unpack(s.recv(2048))
        return (time.process_time() - began) / rounds / N
    finally:
        for s in sockets:
            s.close()


def seal(update: Update) -> bytes:
    payload = msgspec.msgpack.encode(update)
    return payload + blake2s(payload, digest_size=16, key=KEY).digest()


_decoder = msgspec.msgpack.Decoder(Update)


def unseal(datagram: bytes) -> Update:
    payload = datagram[:-16]
    assert blake2s(payload, digest_size=16, key=KEY).digest() == datagram[-16:]
    update: Update = _decoder.decode(payload)
    return update


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help="200 rounds instead of 2,000")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there, too")
    arguments = parser.parse_args()
    rounds = 200 if arguments.quick else 2000
    figures = {
        "agent_round_us": agents(rounds) * 1e6,
        "three_applications_us": agents(rounds, composed(3)) * 1e6,
        "bare_sealed_exchange_us": exchange(rounds, seal, unseal) * 1e6,
        "bare_pickle_exchange_us": exchange(rounds, pickle.dumps, pickle.loads) * 1e6,
    }
    figures["agent_to_sealed"] = figures["agent_round_us"] / figures["bare_sealed_exchange_us"]
    figures["agent_to_pickle"] = figures["agent_round_us"] / figures["bare_pickle_exchange_us"]
    figures["sealed_to_pickle"] = figures["bare_sealed_exchange_us"] / figures["bare_pickle_exchange_us"]
    figures["three_to_one"] = figures["three_applications_us"] / figures["agent_round_us"]
    figures["share_of_1_ms"] = figures["agent_round_us"] / 1000
    print(f"CPU of one robot's round, N = {N}, {rounds} rounds")
    print(f"  agent, whole (in memory)            {figures['agent_round_us']:8.1f} us")
    print(f"  three applications on each robot    {figures['three_applications_us']:8.1f} us")
    print(f"  msgpack + BLAKE2s over UDP, bare    {figures['bare_sealed_exchange_us']:8.1f} us")
    print(f"  pickle over UDP, bare, no MAC       {figures['bare_pickle_exchange_us']:8.1f} us")
    for ratio in ("agent_to_sealed", "agent_to_pickle", "sealed_to_pickle", "three_to_one", "share_of_1_ms"):
        print(f"  {ratio:34}  {figures[ratio]:8.2f}")
    if arguments.json is not None:
        arguments.json.write_text(json.dumps({"n": N, "rounds": rounds, **figures}, indent=2) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
