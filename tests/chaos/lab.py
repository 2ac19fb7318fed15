"""Robots' network in the kernel: a network namespace for each robot, joined by a bridge in a namespace of its own.

Loss and partitions are rules of nftables on the bridge, for IP only, so that addresses are always resolved. Names of
namespaces hold the process id of their maker; those of makers that are gone are removed by the next Lab.
"""

from __future__ import annotations

import itertools
import os
import shutil
import subprocess
from collections.abc import Collection, Sequence
from pathlib import Path
from types import TracebackType

HUB = "hub"  # the bridge's namespace, where a relay may live
HUB_ADDRESS = "10.77.0.254"
_counter = itertools.count()


class LabError(Exception):
    """This machine cannot hold a lab; the message says what it lacks."""


def run(*command: str, text: str = "") -> str:
    done = subprocess.run(command, input=text, capture_output=True, text=True)
    if done.returncode:
        raise LabError(f"{' '.join(command)}: {done.stderr.strip()}\n{text}")
    return done.stdout


def address(pid: int) -> str:
    return f"10.77.0.{pid + 1}"


class Lab:
    """A context: `n` robots' namespaces on one bridge; raises LabError. `loss` is the share of datagrams to a robot
    that are dropped."""

    def __init__(self, n: int, loss: float = 0.0) -> None:
        self.n = n
        self._loss = loss
        self._groups: list[Collection[int]] = [range(n)]
        self._name = f"kchaos{os.getpid()}-{next(_counter)}"

    def __enter__(self) -> Lab:
        self._require()
        sweep()
        try:
            self._build()
        except BaseException:
            self._remove()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._remove()

    def inside(self, pid: int | str) -> list[str]:
        """What a command begins with that is to run where robot `pid` is (or in the HUB)."""
        return ["ip", "netns", "exec", self._space(pid)]

    def loss(self, share: float) -> None:
        self._loss = share
        self._rule()

    def partition(self, groups: Sequence[Collection[int]]) -> None:
        """From now on only robots of one group hear each other."""
        self._groups = list(groups)
        self._rule()

    def heal(self) -> None:
        self.partition([range(self.n)])

    def _space(self, pid: int | str) -> str:
        return f"{self._name}-{pid}"

    @staticmethod
    def _require() -> None:
        if os.geteuid() != 0:
            raise LabError("these tests make network namespaces: run them as root")
        for tool, package in (("ip", "iproute2"), ("nft", "nftables")):
            if shutil.which(tool) is None:
                raise LabError(f"these tests need `{tool}`; on Debian: apt-get install {package}")

    def _build(self) -> None:
        hub = self._space(HUB)
        run("ip", "netns", "add", hub)
        lines = ["link add br0 type bridge", "link set br0 up", "link set lo up", f"addr add {HUB_ADDRESS}/24 dev br0"]
        for pid in range(self.n):
            run("ip", "netns", "add", self._space(pid))
            lines.append(f"link add r{pid} type veth peer name eth0 netns {self._space(pid)}")
            lines.append(f"link set r{pid} master br0 up")
        run("ip", "-n", hub, "-batch", "-", text="\n".join(lines))
        for pid in range(self.n):
            own = f"link set lo up\nlink set eth0 up\naddr add {address(pid)}/24 dev eth0\nroute add default dev eth0\n"
            run("ip", "-n", self._space(pid), "-batch", "-", text=own)
        self._rule()

    def _rule(self) -> None:
        rules = []
        for a, b in itertools.permutations(range(self.n), 2):
            if not any(a in group and b in group for group in self._groups):
                rules.append(f'iifname "r{a}" oifname "r{b}" ether type ip drop')
        if self._loss > 0:
            rules.append(f'oifname "r*" ether type ip numgen random mod 1000 < {round(self._loss * 1000)} drop')
        both = "\n".join(
            f"chain {hook} {{\ntype filter hook {hook} priority 0; policy accept;\n" + "\n".join(rules) + "\n}"
            for hook in ("forward", "output")  # from robot to robot, and from the hub
        )
        table = f"table bridge lab\ndelete table bridge lab\ntable bridge lab {{\n{both}\n}}\n"
        run(*self.inside(HUB), "nft", "-f", "-", text=table)

    def _remove(self) -> None:
        for space in _spaces():
            if space.startswith(self._name + "-"):
                _delete(space)


def sweep() -> None:
    """Remove what labs left whose process is gone."""
    for space in _spaces():
        owner = space.removeprefix("kchaos").partition("-")[0]
        if space.startswith("kchaos") and owner.isdigit() and not Path(f"/proc/{owner}").exists():
            _delete(space)


def _spaces() -> list[str]:
    place = Path("/run/netns")
    return sorted(p.name for p in place.iterdir()) if place.exists() else []


def _delete(space: str) -> None:
    """End what runs in it, then take it away; another lab's sweep may have been faster."""
    found = subprocess.run(["ip", "netns", "pids", space], capture_output=True, text=True)
    for process in found.stdout.split():
        subprocess.run(["kill", "-9", process], capture_output=True)
    subprocess.run(["ip", "netns", "del", space], capture_output=True)
