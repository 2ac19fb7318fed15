"""Real OpenSSH servers on loopback ports, one for each simulated host: an own host key and home folder each."""

from __future__ import annotations

import os
import pwd
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from koordgen.deployment import Login
from koordgen.operate.hosts import Host, Options

SSHD = shutil.which("sshd", path=f"{os.environ.get('PATH', '')}:/usr/sbin:/usr/local/sbin")
USER = pwd.getpwuid(os.getuid()).pw_name
_CONFIG = """\
Port {port}
ListenAddress 127.0.0.1
HostKey {folder}/host_key
AuthorizedKeysFile {folder}/authorized_keys
PidFile none
StrictModes no
UsePAM no
PasswordAuthentication no
KbdInteractiveAuthentication no
PermitRootLogin prohibit-password
PrintMotd no
LogLevel ERROR
SetEnv HOME={folder}/home
"""


class SshHost:
    """One running server. `home` is the home folder of who logs in."""

    def __init__(self, name: str, folder: Path, user_key: str) -> None:
        self.name = name
        self.folder = folder
        self.home = folder / "home"
        self.home.mkdir(parents=True)
        self.make_host_key()
        (folder / "authorized_keys").write_text(user_key)
        self.port = 0
        self._server: subprocess.Popen[bytes] | None = None

    def make_host_key(self) -> None:
        """Give the host a new key; the server shows it once it is started again."""
        key = self.folder / "host_key"
        for old in (key, key.with_suffix(".pub")):
            old.unlink(missing_ok=True)
        make_key(key)

    @property
    def login(self) -> str:
        """`host` of a fleet file."""
        return f"{USER}@127.0.0.1:{self.port}"

    @property
    def known_line(self) -> str:
        """Its line in known_hosts."""
        return f"[127.0.0.1]:{self.port} {(self.folder / 'host_key.pub').read_text()}"

    def host(self, *robots: str, folder: str = "koordgen/fleet", python: str = sys.executable) -> Host:
        """The host as koordgen/operate knows it."""
        return Host(Login(USER, "127.0.0.1", self.port), robots or (self.name,), folder, python)

    def start(self) -> None:
        """Start the server, at its port of before if it had one, and wait until it listens."""
        for _ in range(20):
            port = self.port or _free_port()
            config = self.folder / "sshd_config"
            config.write_text(_CONFIG.format(port=port, folder=self.folder))
            assert SSHD is not None, "openssh-server is not installed"
            log = (self.folder / "sshd.log").open("ab")
            with log:
                server = subprocess.Popen([SSHD, "-D", "-e", "-f", str(config)], stdin=subprocess.DEVNULL, stderr=log)
            if _listens(server, port):
                self.port, self._server = port, server
                return
        raise AssertionError((self.folder / "sshd.log").read_text())

    def stop(self) -> None:
        """Stop listening; connections that are open stay."""
        if self._server is not None:
            self._server.terminate()
            self._server.wait()
            self._server = None

    def cut(self) -> None:
        """Kill the processes of all connections, as when the link is lost: the host's own processes live on."""
        for process in _children(self._server.pid if self._server else 0):
            try:
                os.kill(process, 9)
            except ProcessLookupError:
                continue


class SshFleet:
    """Several hosts, and the files with which a client reaches them."""

    def __init__(self, folder: Path, names: list[str]) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        self.identity = folder / "id_ed25519"
        make_key(self.identity)
        public = self.identity.with_suffix(".pub").read_text()
        self.hosts = {name: SshHost(name, folder / "hosts" / name, public) for name in names}
        self.known_hosts = folder / "known_hosts"
        self.config = folder / "ssh_config"

    def write(self) -> None:
        """Write known_hosts and the configuration of SSH for the servers as they are."""
        self.known_hosts.write_text("".join(host.known_line for host in self.hosts.values()))
        self.config.write_text(f"IdentityFile {self.identity}\nUserKnownHostsFile {self.known_hosts}\n")

    @property
    def options(self) -> Options:
        """How koordgen/operate reaches them."""
        return Options(str(self.config), str(self.known_hosts), str(self.identity))

    @property
    def arguments(self) -> list[str]:
        """The same as options of a command."""
        return [f"--ssh-config={self.config}", f"--known-hosts={self.known_hosts}", f"--identity={self.identity}"]


@contextmanager
def ssh_fleet(folder: Path, names: list[str]) -> Iterator[SshFleet]:
    """Run a server for each name below `folder`."""
    if os.getuid() == 0:
        Path("/run/sshd").mkdir(exist_ok=True)  # sshd wants it
    fleet = SshFleet(folder, names)
    try:
        for host in fleet.hosts.values():
            host.start()
        fleet.write()
        yield fleet
    finally:
        for host in fleet.hosts.values():
            host.cut()
            host.stop()


def make_key(path: Path) -> None:
    """Make a key pair without a passphrase."""
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", "test", "-f", str(path)], check=True)


def _free_port() -> int:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return int(taken.getsockname()[1])


def _listens(server: subprocess.Popen[bytes], port: int) -> bool:
    """Return True once the server listens, False if it ended before."""
    while server.poll() is None:
        with socket.socket() as client:
            if client.connect_ex(("127.0.0.1", port)) == 0:
                return True
        time.sleep(0.02)
    return False


def _children(parent: int) -> list[int]:
    """All descendants of sshd that are sshd too: one or two a connection."""
    found: list[int] = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            text = (entry / "stat").read_text()
        except OSError:
            continue
        name, _, rest = text.partition(") ")
        if int(rest.split()[1]) == parent and name.endswith("(sshd"):
            found += [int(entry.name), *_children(int(entry.name))]
    return found
