"""A fleet on simulated hosts: its files, and the commands that deploy it."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from koordgen import cli
from tests.operate.ssh_hosts import SshFleet, SshHost, ssh_fleet

PROGRAM = (Path(__file__).parents[2] / "examples/lineform/lineform.koord").read_text(encoding="utf-8")
FLEET = """\
delta: 0.1
application_id: {application_id}
origin: {{latitude: 47.0, longitude: 8.0, altitude: 400.0}}
geofence: {{lo: [-5, -5, -1], hi: [5, 5, 4]}}
deploy: {{folder: koordgen/fleet, python: "{python}", service: none, wheels: {wheels}}}
robots:
"""


class Deployed:
    """A program and a fleet file in `folder`, and a host for each of some names. `robots` is robot -> name of host."""

    def __init__(self, folder: Path, ssh: SshFleet, robots: dict[str, str]) -> None:
        self.folder = folder
        self.ssh = ssh
        self.robots = robots
        self.program = folder / "line.koord"
        self.fleet = folder / "fleet.yaml"
        self.key = folder / "fleet.key"
        self.write()
        assert cli.main(["key", "new", str(self.key)]) == 0

    def write(
        self, version: int = 1, application_id: int = 7, wheels: str = "host", python: str = sys.executable
    ) -> None:
        """Write the program and the fleet file."""
        self.program.write_text(f"{PROGRAM}\n# version {version}\n")
        text = FLEET.format(application_id=application_id, wheels=wheels, python=python)
        for number, (robot, host) in enumerate(self.robots.items()):
            port = 20000 + 2 * (os.getpid() % 10000) + number
            login = self.ssh.hosts[host].login
            text += f'  - {{name: {robot}, target: quad, address: "127.0.0.1:{port}", host: "{login}"}}\n'
        self.fleet.write_text(text)

    def deploy(self, *options: str) -> int:
        """Run `koordgen deploy`; return the exit status."""
        return cli.main(["deploy", str(self.program), "--fleet", str(self.fleet), *self.ssh.arguments, *options])

    def rollback(self, *options: str) -> int:
        """Run `koordgen rollback`; return the exit status."""
        return cli.main(["rollback", str(self.fleet), *self.ssh.arguments, *options])

    def rotate(self, *options: str) -> int:
        """Run `koordgen key rotate`; return the exit status."""
        return cli.main(["key", "rotate", str(self.fleet), *self.ssh.arguments, *options])

    def states(self) -> dict[str, Any]:
        """Return deployment.json of each host, and where `current` leads to; None for a host without a release."""
        return {name: state(host) for name, host in self.ssh.hosts.items()}

    def confirmed(self) -> set[str | None]:
        """Return the releases that are confirmed on hosts: one for a fleet that is whole."""
        return {found["confirmed"] if found else None for found in self.states().values()}


def place(host: SshHost) -> Path:
    """Return the folder of the deployment on a host."""
    return host.home / "koordgen/fleet"


def state(host: SshHost) -> dict[str, Any] | None:
    """Return deployment.json and the target of `current`."""
    path = place(host) / "deployment.json"
    if not path.exists():
        return None
    link = place(host) / "current"
    return {**json.loads(path.read_text()), "current": os.readlink(link) if link.is_symlink() else None}


@contextmanager
def deployed(folder: Path, robots: dict[str, str]) -> Iterator[Deployed]:
    """Run the hosts of a fleet that is not deployed yet."""
    with ssh_fleet(folder / "ssh", list(dict.fromkeys(robots.values()))) as ssh:
        yield Deployed(folder, ssh, robots)
