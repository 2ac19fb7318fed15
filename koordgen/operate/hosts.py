"""Parallel SSH sessions with the hosts of a fleet.

A host is a computer that runs the agents of one or several robots, `user@name[:port]`. Robots of one host share one SSH
session. The session starts the tool of koordgen/operate/host_tool on the host, and sends it one request at a time. The
tool is uploaded when the host does not have it. An SSH host key that is not in known_hosts, or differs from the key
there, is an error; it is never accepted.
"""

from __future__ import annotations

import asyncio
import errno
import getpass
import json
import os
import shlex
import socket
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

from koordgen.fleet.deployment import DeploymentSettings, Login
from koordgen.lang.node import Node
from koordgen.operate.physical import PhysicalRobot

if TYPE_CHECKING:
    import asyncssh

CONNECT_TIMEOUT = 10.0  # time limit for connecting and for logging in, each, in seconds
START_TIMEOUT = 60.0  # longest time in which a host must start the tool, in seconds
KEEPALIVE = 5.0  # seconds between two SSH keepalive messages; the connection is closed after three without an answer
PING = 10.0  # seconds without a request before a `ping` is sent; without pings, the tool ends the idle session
LONGEST_LINE = 1 << 24  # largest size of an answer's JSON line, in bytes
_CHATTER = 1 << 16  # largest number of bytes that a login shell may print before the tool's answer
OLDEST_PYTHON = (3, 10)


class Host(Node):
    """One computer, and the robots whose agents it runs.

    `folder` and `python` are entries of the fleet file.
    """

    login: Login
    robots: tuple[str, ...]
    folder: str
    python: str

    @property
    def title(self) -> str:
        """Return the host's robots and its login, as messages show them."""
        return f"{', '.join(self.robots)} ({self.login.text})"


class Options(Node):
    """Options of SSH connections.

    ssh_config: configuration file; None: ~/.ssh/config.
    known_hosts: file of trusted host keys; None: ~/.ssh/known_hosts.
    identity: file of the user's private key; None: the user's usual keys, or the SSH agent.
    timeout: seconds for connecting and for logging in, each.
    """

    ssh_config: str | None = None
    known_hosts: str | None = None
    identity: str | None = None
    timeout: float = CONNECT_TIMEOUT


class HostError(Exception):
    """Failure of one host: it refused a request, or cannot be reached.

    host: the host that failed.
    code: error code of the tool, or "unreachable", "unknown key", "changed key", "refused key", "settings", "python",
        "folder", "refused", "link" or "tool".
    message: the failure without the host's name; the text of the exception names the host.
    help: what the user can do.
    """

    def __init__(self, host: Host, code: str, message: str, help: str = "") -> None:
        super().__init__(f"{host.title}: {message}")
        self.host = host
        self.code = code
        self.message = message
        self.help = help


class NoHosts(Exception):
    """Raised if the fleet file names no host for a robot, or if asyncssh is missing.

    `help` says what to do."""

    def __init__(self, message: str, help: str, is_file_wrong: bool = True) -> None:
        super().__init__(message)
        self.help = help
        self.is_file_wrong = is_file_wrong


class Answer(dict[str, Any]):
    """The tool's answer to one request: a JSON object, and the raw bytes that followed the object."""

    data: bytes = b""


def hosts_of(robots: Sequence[PhysicalRobot], place: DeploymentSettings) -> tuple[Host, ...]:
    """Return the hosts of robots, in the order of the robots. `place`: of the (outer) fleet file.

    Raises NoHosts when the fleet file names no host for one of them.
    """
    without = [robot.name for robot in robots if robot.login is None]
    if without:
        help = "add `host: USER@NAME` to each of them, for example `host: pi@alice.local`"
        raise NoHosts(f"the fleet file names no host for {', '.join(without)}", help)
    by_login: dict[Login, list[str]] = {}
    for robot in robots:
        if robot.login is not None:
            by_login.setdefault(robot.login, []).append(robot.name)
    return tuple(Host(login, tuple(names), place.folder, place.python) for login, names in by_login.items())


def owner() -> str:
    """Return the name that this process's locks on hosts bear: user@computer."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # this computer has no user name for the process's user id
        user = str(os.getuid())
    return f"{user}@{socket.gethostname()}"


class SshSession:
    """SSH session with the tool on one host. Concurrent calls are sent one after another."""

    def __init__(
        self, host: Host, connection: asyncssh.SSHClientConnection, process: asyncssh.SSHClientProcess[bytes]
    ) -> None:
        self.host = host
        self.sent = 0  # number of bytes sent to the host, including an upload of the tool
        self._connection = connection
        self._process = process
        self._turn = asyncio.Lock()
        self._last = asyncio.get_running_loop().time()
        self._cut: HostError | None = None

    async def call(self, verb: str, data: bytes = b"", **arguments: Any) -> Answer:
        """Send one request and return the tool's answer.

        Raises HostError if it is refused or the connection fails.
        """
        request: dict[str, Any] = {"verb": verb, **arguments}
        if data:
            request["length"] = len(data)
        async with self._turn:
            answer = await self.exchange(json.dumps(request).encode() + b"\n" + data, f"during `{verb}`")
            self._last = asyncio.get_running_loop().time()
        if answer.get("ok") is not True:
            code, message = str(answer.get("error", "tool")), str(answer.get("message", "the tool refused"))
            raise HostError(self.host, code, message, str(answer.get("help", "")))
        return answer

    async def exchange(self, sent: bytes, when: str) -> Answer:
        """Send bytes and read one answer. Raises HostError when the connection fails, and in each later call."""
        if self._cut is not None:
            raise self._cut
        try:
            if sent:
                self.sent += len(sent)
                self._process.stdin.write(sent)
                await self._process.stdin.drain()
            answer = await self._read()
        except Exception as error:
            self._cut = await self._why_cut(when, error)
            raise self._cut from None
        except BaseException:  # an interrupted exchange leaves unread bytes, so the session cannot be used any more
            self._cut = HostError(self.host, "link", f"the connection was interrupted {when}")
            raise
        return answer

    async def _read(self) -> Answer:
        """Read one answer and its data. Raises EOFError, OSError, ValueError, asyncssh.Error.

        Lines before the answer that do not begin with `{` are output of the login shell, and are skipped.
        """
        chatter = 0
        while True:
            line: bytes = await self._process.stdout.readline()
            if not line.endswith(b"\n"):
                raise EOFError
            if line.startswith(b"{"):
                break
            chatter += len(line)  # skip a line of the login shell, for example a greeting in .bashrc
            if chatter > _CHATTER:
                raise ValueError(f"the login shell prints more than {_CHATTER} bytes")
        if len(line) > LONGEST_LINE:
            raise ValueError(f"the answer is longer than {LONGEST_LINE} bytes")
        answer = Answer(json.loads(line))
        if length := int(answer.get("length", 0)):
            answer.data = await self._process.stdout.readexactly(length)
        return answer

    async def _why_cut(self, when: str, error: Exception) -> HostError:
        with suppress(asyncio.TimeoutError):
            async with asyncio.timeout(1.0):
                await self._process.wait_closed()
        status, lines = self._process.returncode, await self._complaint()
        said = lines[-1][:200] if lines else ""
        if status == 127 or (status == 126 and said):
            return _no_python(self.host)
        if isinstance(error, ValueError):
            return HostError(self.host, "tool", f"the answer {when} is not understood: {error}", _SHELL)
        if status is not None and status != 0:
            what = f"the tool on the host ended {when} with status {status}" + (f": {said}" if said else "")
            help = "run the command again; if it fails again, log in to the host and check its disk and memory"
            return HostError(self.host, "tool", what, help)
        what = f"the link was cut {when}"
        return HostError(self.host, "link", what, "check that the host is on and in reach, then run the command again")

    async def _complaint(self) -> list[str]:
        with suppress(Exception):
            async with asyncio.timeout(0.2):
                text: bytes = await self._process.stderr.read(4096)
                return [line for line in text.decode("utf-8", "replace").splitlines() if line.strip()]
        return []

    async def keep_alive(self) -> None:
        """Send a `ping` after each PING seconds without a request, until cancelled or the connection fails."""
        loop = asyncio.get_running_loop()
        with suppress(HostError):
            while True:
                await asyncio.sleep(max(0.0, self._last + PING - loop.time()))
                if not self._turn.locked() and loop.time() >= self._last + PING:
                    await self.call("ping")
                elif self._turn.locked():
                    await asyncio.sleep(1.0)

    async def close(self) -> None:
        """End the tool, which releases its locks, and close the connection."""
        with suppress(Exception):
            self._process.stdin.write_eof()
            async with asyncio.timeout(2.0):
                await self._process.wait_closed()
        self._connection.close()
        with suppress(Exception):
            async with asyncio.timeout(2.0):
                await self._connection.wait_closed()


_SHELL = "`ssh HOST true` must print nothing: remove all output from the host's .bashrc or .profile"


class Sessions(Node):
    """Sessions with the hosts that were reached (in the fleet file's order), and failures of the other hosts."""

    reached: tuple[SshSession, ...]
    failed: tuple[HostError, ...]

    async def call(self, verb: str, **arguments: Any) -> tuple[dict[Host, Answer], list[HostError]]:
        """Send the same request to all reached hosts in parallel.

        Return the answers by host, and the failures.
        """
        return await self.each(lambda session: session.call(verb, **arguments))

    async def each(self, ask: Callable[[SshSession], Awaitable[Any]]) -> tuple[dict[Host, Any], list[HostError]]:
        """Run `ask` for all hosts that were reached, in parallel; return results by host, and failures."""
        results = await asyncio.gather(*map(ask, self.reached), return_exceptions=True)
        found: dict[Host, Any] = {}
        failed: list[HostError] = []
        for session, result in zip(self.reached, results, strict=True):
            if isinstance(result, HostError):
                failed.append(result)
            elif isinstance(result, BaseException):
                raise result
            else:
                found[session.host] = result
        return found, failed


@asynccontextmanager
async def sessions(hosts: Iterable[Host], options: Options, tool: bytes) -> AsyncIterator[Sessions]:
    """Connect to all hosts in parallel and start `tool`, the archive of the robot-side tool, on each.

    Hosts that cannot be reached are listed in `failed`; the caller decides what to do about them. Raises NoHosts when
    asyncssh is missing.
    """
    require_asyncssh()
    hosts = tuple(hosts)
    async with AsyncExitStack() as stack:
        opened = await asyncio.gather(*(_open(host, options, tool) for host in hosts), return_exceptions=True)
        reached = [each for each in opened if isinstance(each, SshSession)]
        stack.push_async_callback(_close_all, reached)
        for each in opened:
            if not isinstance(each, (SshSession, HostError)):
                raise each
        pings = [asyncio.create_task(session.keep_alive()) for session in reached]
        try:
            yield Sessions(tuple(reached), tuple(each for each in opened if isinstance(each, HostError)))
        finally:
            for task in pings:
                task.cancel()
            await asyncio.gather(*pings, return_exceptions=True)


async def _close_all(opened: Sequence[SshSession]) -> None:
    await asyncio.gather(*(session.close() for session in opened))


def require_asyncssh() -> None:
    """Raise NoHosts when the package asyncssh is missing."""
    try:
        import asyncssh  # noqa: F401
    except ImportError as error:
        from koordgen.runtime.ops.host import pip_install

        missing = error.name or "asyncssh"
        raise NoHosts(f"the Python package {missing} is missing", pip_install("'koordgen[deploy]'"), False) from None


async def _open(host: Host, options: Options, tool: bytes) -> SshSession:
    """Connect to a host and start its tool. Raises HostError."""
    connection = await _connect(host, options)
    try:
        digest = sha256(tool).hexdigest()
        process = await connection.create_process(_command(host, digest, len(tool)), encoding=None)
        session = SshSession(host, connection, process)
        async with asyncio.timeout(START_TIMEOUT):
            answer = await session.exchange(b"", "at its start")
        if answer.get("upload"):
            answer = await session.exchange(tool, "while the tool was sent")
        if answer.get("ok") is not True:
            message = str(answer.get("message", "the tool on the host does not start"))
            raise HostError(host, str(answer.get("error", "tool")), message, str(answer.get("help", "")))
    except BaseException as error:
        connection.abort()
        import asyncssh

        if isinstance(error, TimeoutError):
            message = f"the host did not start the tool within {START_TIMEOUT:g} s"
            raise HostError(host, "tool", message, _SHELL) from None
        if isinstance(error, (asyncssh.Error, OSError)):
            raise HostError(host, "refused", f"the host does not run commands over SSH: {error}", _SHELL) from None
        raise
    return session


# First program that runs on a host. Any Python version can run it, so it can report a Python that is too old. It stores
# the host tool, which it reads from standard input unless the host has it already, and then runs the tool in the same
# process.
_BOOT = """
import json, os, sys
def say(**what):
    os.write(1, json.dumps(what).encode() + b"\\n")
def refuse(error, message, help):
    say(ok=False, error=error, message=message, help=help)
    sys.exit(0)
folder, digest, size = sys.argv[1], sys.argv[2], int(sys.argv[3])
if sys.version_info < (3, 10):
    refuse("python", "its Python is %d.%d, and agents need 3.10 or later" % sys.version_info[:2],
           "install a newer one there, and name it in the fleet file: `deploy: {python: python3.11}`")
import hashlib
home = os.path.join(folder, "tool")
place = os.path.join(home, digest + ".pyz")
def is_there():
    try:
        with open(place, "rb") as file:
            return hashlib.sha256(file.read()).hexdigest() == digest
    except OSError:
        return False
try:
    if not is_there():
        os.makedirs(home, mode=0o700, exist_ok=True)
        say(ok=True, upload=True)
        data = b""
        while len(data) < size:
            part = os.read(0, size - len(data))
            if not part:
                sys.exit(1)
            data += part
        beside = "%s.%d" % (place, os.getpid())
        try:
            with open(beside, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            os.rename(beside, place)
        except OSError:
            if os.path.exists(beside):
                os.unlink(beside)
            raise
        if not is_there():
            refuse("tool", "the tool arrived damaged", "run the command again")
except OSError as error:
    refuse("folder", "%s cannot be written: %s" % (error.filename or folder, error.strerror),
           "free disk space there, make the disk writable, or name another `deploy: {folder: ...}`")
say(ok=True)
sys.argv = [os.path.abspath(place), "--folder", folder, "session"]
sys.path.insert(0, place)
import zipimport
exec(zipimport.zipimporter(place).get_code("__main__"), {"__name__": "__main__"})
"""


def _command(host: Host, digest: str, size: int) -> str:
    """Return the shell command that starts the tool on a host."""
    python, folder = shlex.quote(host.python), shlex.quote(host.folder)
    script = f"umask 077; cd && exec {python} -IS -c {shlex.quote(_BOOT)} {folder} {digest} {size}"
    return f"sh -c {shlex.quote(script)}"


def _no_python(host: Host) -> HostError:
    help = "install Python 3.10 or later on the host, or set `deploy: {python: /usr/bin/python3}` in the fleet file"
    return HostError(host, "python", f"the host has no command {host.python}", help)


async def _connect(host: Host, options: Options) -> asyncssh.SSHClientConnection:
    import asyncssh

    offered: list[asyncssh.SSHKey] = []
    known = 0  # number of this host's keys in known_hosts

    class Client(asyncssh.SSHClient):
        def validate_host_public_key(self, host: str, addr: str, port: int, key: asyncssh.SSHKey) -> bool:
            offered.append(key)
            return False

    def trusted(name: str, address: str, port: int | None) -> Any:
        nonlocal known
        found = asyncssh.read_known_hosts(files).match(name, address, port)
        known = len(found[0]) + len(found[1]) + len(found[2])
        return found

    try:
        settings = await asyncssh.SSHClientConnectionOptions.construct(**_settings(host, options))
        files = _known_hosts(options, settings.known_hosts)
        settings = await asyncssh.SSHClientConnectionOptions.construct(
            settings, known_hosts=trusted, client_factory=Client
        )
        return await asyncssh.connect(host.login.name, options=settings)
    except asyncssh.HostKeyNotVerifiable:
        raise _untrusted(host, offered, known, options) from None
    except asyncssh.KeyExchangeFailed as error:
        if known:
            raise _untrusted(host, offered, known, options) from None
        raise HostError(host, "unreachable", f"SSH on both computers has no common method: {error}", "") from None
    except asyncssh.PermissionDenied:
        who = f"{host.login.user} at {host.login.name}"
        help = f"copy your key to the host: `ssh-copy-id {_target(host)}`; or name another key with --identity FILE"
        raise HostError(host, "refused key", f"the host refuses your SSH keys for {who}", help) from None
    except (asyncssh.KeyImportError, asyncssh.KeyEncryptionError, asyncssh.ConfigParseError, ValueError) as error:
        help = "if the key has a passphrase, add the key to ssh-agent with `ssh-add`, and leave --identity out"
        raise HostError(host, "settings", f"the SSH files of this computer cannot be used: {error}", help) from None
    except (TimeoutError, asyncio.TimeoutError, OSError, asyncssh.Error) as error:
        raise _unreachable(host, error, options) from None


def _settings(host: Host, options: Options) -> dict[str, Any]:
    found: dict[str, Any] = {
        "host": host.login.name,
        "username": host.login.user,
        "connect_timeout": options.timeout,
        "login_timeout": options.timeout,
        "keepalive_interval": KEEPALIVE,
        "keepalive_count_max": 3,
    }
    if host.login.port is not None:
        found["port"] = host.login.port
    if options.ssh_config is not None:
        found["config"] = [options.ssh_config]
    if options.identity is not None:
        found |= {"client_keys": [options.identity], "agent_path": None}
    return found


def _known_hosts(options: Options, configured: Any) -> list[str]:
    """Return the existing files of trusted host keys. No setting turns the check of host keys off."""
    if options.known_hosts is not None:
        return [options.known_hosts]
    files = [configured] if isinstance(configured, str) else list(configured or [])
    usual = ["~/.ssh/known_hosts", "~/.ssh/known_hosts2", "/etc/ssh/ssh_known_hosts"]
    places = [os.path.expanduser(str(each)) for each in (files or usual)]
    return [each for each in places if Path(each).is_file()]


def _target(host: Host) -> str:
    port = f"-p {host.login.port} " if host.login.port else ""
    return f"{port}{host.login.user}@{host.login.name}"


def _untrusted(host: Host, offered: Sequence[asyncssh.SSHKey], known: int, options: Options) -> HostError:
    """Return the error for a host key that is not in known_hosts, or differs from the key there."""
    port = f"-p {host.login.port} " if host.login.port else ""
    file = options.known_hosts or "~/.ssh/known_hosts"
    shown = f"{offered[0].get_fingerprint()} ({offered[0].get_algorithm()})" if offered else "of another kind"
    look = "ssh-keygen -lf /etc/ssh/ssh_host_ed25519_key.pub"
    add = f"ssh-keyscan {port}{host.login.name} >> {file}"
    if not known:
        help = f"on the host, run `{look}`; if it prints this key, run `{add}` on this computer"
        return HostError(host, "unknown key", f"the host's key is not in known_hosts: {shown}", help)
    name = f"[{host.login.name}]:{host.login.port}" if host.login.port not in (None, 22) else host.login.name
    help = (
        f"was the host installed anew? then run `{look}` on the host; if it prints this key, run "
        f"`ssh-keygen -R '{name}' -f {file}` and `{add}` on this computer. "
        "Otherwise do not connect: another computer may pretend to be the host"
    )
    return HostError(host, "changed key", f"the host's key differs from the key in known_hosts: {shown}", help)


def _unreachable(host: Host, error: BaseException, options: Options) -> HostError:
    where = f"{host.login.name}" + (f" port {host.login.port}" if host.login.port else "")
    number = getattr(error, "errno", None)
    if isinstance(error, socket.gaierror):
        what, help = f"no address is known for {host.login.name}", "check the name, or write the IP address as `host`"
    elif isinstance(error, TimeoutError) or number == errno.ETIMEDOUT:
        what = f"{where} did not answer within {options.timeout:g} s"
        help = "check that the host is on, and in the same network"
    elif number == errno.ECONNREFUSED:
        what, help = f"{where} refuses connections", "start its SSH server: `sudo systemctl enable --now ssh`"
    else:
        reason = getattr(error, "strerror", None) or getattr(error, "reason", None) or str(error) or "closed"
        what, help = f"{where} cannot be reached: {reason}", "check that the host is on, and in the same network"
    return HostError(host, "unreachable", what, help)
