"""A host for tests of the robot-side tool: a folder, the tool as a process of its own, and bundles that do little."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import time
import zlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from hashlib import blake2s
from pathlib import Path
from typing import Any

import pytest

from koordgen.operate.host_tool_archive import archive

KEY = bytes(range(32))
KEY_ID = blake2s(KEY, person=b"koordgen", digest_size=8).hexdigest()

# Answers --help and --status as an agent does, holds its control port while it runs, ends at SIGTERM, and ends with
# the status in the file `ends` when that is there. It prints which release it belongs to.
MAIN = """
import json, pathlib, signal, socket, sys, time
here = pathlib.Path(__file__).resolve().parent
settings = json.loads((here / "settings.json").read_text())
place = ("127.0.0.1", settings["control"])
if "--help" in sys.argv:
    raise SystemExit(settings.get("help", 0))
if "--status" in sys.argv:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asker:
        try:
            asker.settimeout(10)
            asker.connect(place)
            asker.send(b"?")
            print(asker.recv(1000).decode())
        except OSError:
            raise SystemExit(5)
    raise SystemExit(0)
if "--doctor" in sys.argv:
    print(json.dumps({"robot": settings["robot"], "checks": []}))
    raise SystemExit(1)
overlay = json.loads(pathlib.Path(sys.argv[sys.argv.index("--settings") + 1]).read_text())
runs = pathlib.Path(overlay["state"]).parent / "runs.jsonl"
with runs.open("a") as file:
    file.write(json.dumps({"robot": settings["robot"], "release": here.parent.name, "overlay": overlay}) + chr(10))
pathlib.Path(overlay["trace"]).write_text("trace of " + settings["robot"] + chr(10))
print("starts", settings["robot"], file=sys.stderr, flush=True)
ends = pathlib.Path(overlay["state"]).parent / "ends"
if ends.exists():
    raise SystemExit(int(ends.read_text()))
import os
def notify(text):
    name = os.environ.get("NOTIFY_SOCKET", "")
    if name:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as to:
            to.sendto(text, name.replace("@", chr(0), 1))
control = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
control.bind(place)
control.settimeout(0.05)
done = []
signal.signal(signal.SIGTERM, lambda *_: done.append(1))
notify(b"READY=1")
while not done or settings.get("stays"):
    notify(b"WATCHDOG=1")
    try:
        _, asker = control.recvfrom(100)
        control.sendto(json.dumps({"phase": "running", "robot": settings["robot"]}).encode(), asker)
    except TimeoutError:
        pass
print("at rest", file=sys.stderr, flush=True)
"""


class Refused(Exception):
    def __init__(self, answer: Mapping[str, Any]) -> None:
        super().__init__(answer)
        self.code, self.message, self.help = answer["error"], answer["message"], answer["help"]


class Session:
    """A session of the tool, as the deploying side holds it."""

    def __init__(self, host: FakeHost, *options: str) -> None:
        self.process = subprocess.Popen(
            host.command(*options, "session"), stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=host.environment
        )

    def call(self, verb: str, data: bytes = b"", **arguments: Any) -> Any:
        """The answer to a request; raises Refused, and EOFError when the session has ended."""
        assert self.process.stdin is not None and self.process.stdout is not None
        head = {"verb": verb, **arguments} | ({"length": len(data)} if data else {})
        try:
            self.process.stdin.write(json.dumps(head).encode() + b"\n" + data)
            self.process.stdin.flush()
        except BrokenPipeError:
            raise EOFError from None
        line = self.process.stdout.readline()
        if not line:
            raise EOFError
        answer = json.loads(line)
        if not answer.pop("ok"):
            raise Refused(answer)
        if "length" in answer:
            answer["data"] = self.process.stdout.read(answer["length"])
        return answer

    def close(self) -> int:
        assert self.process.stdin is not None and self.process.stdout is not None
        with suppress(BrokenPipeError):
            self.process.stdin.close()
        status = self.process.wait()
        self.process.stdout.close()
        return status

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class FakeHost:
    """Folder `root/fleet` of a host whose boot id is in `root/boot_id`."""

    def __init__(self, root: Path) -> None:
        self.root, self.folder, self.boot = root, root / "fleet", root / "boot_id"
        self.boot.write_text("boot-1\n")
        self.tool = root / "tool.pyz"
        self.tool.write_bytes(archive())
        self.environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "XDG_RUNTIME_DIR")}
        self.environment |= {"HOME": str(root)}

    def command(self, *arguments: str) -> list[str]:
        return [sys.executable, str(self.tool), "--folder", "fleet", "--boot-id", str(self.boot), *arguments]

    def session(self, *options: str) -> Session:
        return Session(self, *options)

    def launch(self, robot: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(self.command("launch", robot), env=self.environment, stderr=subprocess.PIPE)

    def reboot(self) -> None:
        self.boot.write_text(self.boot.read_text() + "+\n")

    @property
    def deployment(self) -> Any:
        return json.loads((self.folder / "deployment.json").read_text())

    @property
    def current(self) -> str | None:
        path = self.folder / "current"
        return os.readlink(path).removeprefix("releases/") if path.is_symlink() else None

    @property
    def runs(self) -> list[tuple[str, str]]:
        """Robot and release of every agent that was started."""
        path = self.folder / "runs.jsonl"
        lines = path.read_text().splitlines() if path.exists() else []
        return [(each["robot"], each["release"]) for each in map(json.loads, lines)]


def digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


class FakeRelease:
    """Bundles of some robots, which differ from release to release in `text`."""

    def __init__(self, text: str, ports: Mapping[str, int], key: str = KEY_ID, **settings: Any) -> None:
        self.bundles: dict[str, dict[str, bytes]] = {
            robot: {
                "__main__.py": MAIN.encode(),
                "settings.json": json.dumps(
                    {"robot": robot, "pid": 0, "control": port, "peers": [{"host": "127.0.0.1", "port": 47000}]}
                    | settings
                ).encode(),
                "lib/program.py": f"TEXT = {text!r}\n".encode(),
            }
            for robot, port in ports.items()
        }
        self.id = digest(json.dumps([text, key, settings]).encode())[:16]
        self.key = key
        self.document: dict[str, Any] = {
            "id": self.id,
            "application_id": 7,
            "app": "fake",
            "robots": {robot: {} for robot in ports},
            "key": key,
            "venv": None,
            "service": "none",
            "python": sys.executable,
        }

    def take_over(self, robot: str, files: dict[str, bytes]) -> None:
        """Make a real bundle the one of a robot."""
        self.bundles[robot] = files
        self.document["robots"] |= {robot: {}}

    @property
    def contents(self) -> dict[str, bytes]:
        return {digest(c): c for files in self.bundles.values() for c in files.values()}

    @property
    def files(self) -> dict[str, dict[str, list[Any]]]:
        return {r: {path: [digest(c), 0o644] for path, c in files.items()} for r, files in self.bundles.items()}

    def store(self, session: Session) -> int:
        """Send what is missing; returns how many files that was."""
        lacking = session.call("missing", objects=sorted(self.contents))["objects"]
        send(session, "objects", {name: self.contents[name] for name in lacking})
        if self.key:
            session.call("key", KEY, id=self.key)
        return len(lacking)

    def stage(self, session: Session) -> None:
        session.call("stage", release=self.document, files=self.files)

    def put(self, session: Session, until: str = "confirm", seconds: float = 60) -> None:
        """Deploy up to the verb `until`."""
        steps: Sequence[Any] = (
            ("lock", lambda: session.call("lock", owner="anna@laptop", what="deploy")),
            ("store", lambda: self.store(session)),
            ("stage", lambda: self.stage(session)),
            ("verify", lambda: session.call("verify", id=self.id)),
            ("switch", lambda: session.call("switch", id=self.id, seconds=seconds)),
            ("prepare", lambda: session.call("prepare", id=self.id)),
            ("confirm", lambda: session.call("confirm", id=self.id)),
        )
        for name, step in steps:
            step()
            if name == until:
                return


def send(session: Session, kind: str, contents: Mapping[str, bytes]) -> None:
    """Store contents by name."""
    entries = [[name, digest(content), len(content)] for name, content in contents.items()]
    session.call("store", zlib.compress(b"".join(contents.values())), kind=kind, entries=entries)


def wait(condition: Callable[[], Any], seconds: float = 60) -> None:
    """Return once the condition holds."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited for too long"
        time.sleep(0.05)


def refused(call: Callable[..., Any], *arguments: Any, **named: Any) -> Refused:
    """The error with which a call is refused."""
    with pytest.raises(Refused) as caught:
        call(*arguments, **named)
    return caught.value
