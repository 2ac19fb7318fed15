"""Session protocol: requests as JSON lines on the standard input, answers on the standard output.

The requests `store` and `key` carry data: they have an entry `"length": N`, and N raw bytes follow their line. An
answer with `length` is followed by data in the same way. A session ends at the end of its input, or when nothing has
arrived for `idle` seconds.
"""

from __future__ import annotations

import errno
import json
import os
import select
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

from . import agents, guardian, host, logs, objects, packages, releases, running
from .deployment import Boot, Deployment
from .folder import PIECE, Folder, ToolError, make_folder
from .lock import SessionLock, deciding

_LONGEST_LINE = 64 * 1024 * 1024  # largest size of a request's JSON line, in bytes
_WITH_DATA = ("store", "key")
_LONGEST_WAIT = 3600.0  # longest duration that a request may specify, in seconds

Request = Mapping[str, Any]
Answer = dict[str, Any]


class _Ended(Exception):
    """Raised at a session's end: the operator closed it, was silent, or violated the protocol."""


class Channel:
    """Requests and answers over two file descriptors."""

    def __init__(self, source: int, sink: int, idle: float) -> None:
        self._source, self._sink, self._idle = source, sink, idle
        self._buffer = bytearray()
        self._left = 0  # number of bytes of the present request's data that are not read yet

    def request(self) -> dict[str, Any]:
        """Wait for the next request and return it. Raises _Ended."""
        for _ in self.data():  # skip the data of a previous request that was refused before its data were read
            pass
        searched = 0
        while (end := self._buffer.find(b"\n", searched)) < 0:
            searched = len(self._buffer)
            if searched > _LONGEST_LINE:
                raise _Ended
            self._receive()
        line = bytes(self._buffer[:end])
        del self._buffer[: end + 1]
        try:
            found = json.loads(line)
            length = found.get("length", 0) if found.get("verb") in _WITH_DATA else 0
        except (ValueError, AttributeError):
            raise _Ended from None
        if not isinstance(length, int) or length < 0:
            raise _Ended
        self._left = length
        return dict(found)

    def data(self) -> Iterator[bytes]:
        """Yield the data of the present request, in pieces."""
        while self._left:
            if not self._buffer:
                self._receive()
            piece = bytes(self._buffer[: min(self._left, PIECE)])
            del self._buffer[: len(piece)]
            self._left -= len(piece)
            yield piece

    def answer(self, answer: Answer, data: bytes = b"") -> None:
        view = memoryview(json.dumps(answer).encode() + b"\n" + data)
        while view:
            try:
                view = view[os.write(self._sink, view) :]
            except OSError:
                raise _Ended from None

    def _receive(self) -> None:
        ready, _, _ = select.select([self._source], [], [], self._idle)
        piece = os.read(self._source, PIECE) if ready else b""
        if not piece:
            raise _Ended
        self._buffer += piece


class Verb(NamedTuple):
    """Handler of one kind of request.

    run: function that handles the request.
    locks: True if only a session that holds the folder's lock may send the request.
    """

    run: Callable[[Session, Request], Answer]
    locks: bool


class Session:
    """One session with the operator's computer."""

    def __init__(self, folder: Folder, boot: Boot, channel: Channel) -> None:
        self.folder, self.boot, self.channel = folder, boot, channel
        self.deployment = Deployment(folder, boot)
        self.lock = SessionLock(folder)
        self.fetching = logs.Fetching(folder)

    def run(self) -> None:
        """Answer requests until the session is over."""
        try:
            while True:
                request = self.channel.request()
                answer = self._answer(request)
                data = answer.pop("data", b"")
                self.channel.answer(answer | ({"length": len(data)} if "length" in answer else {}), data)
        except _Ended:
            pass
        finally:
            self.fetching.close()
            self.lock.release()

    def _answer(self, request: Request) -> Answer:
        verb = VERBS.get(str(request.get("verb")))
        try:
            if verb is None:
                raise ToolError("bad request", f"{request.get('verb')!r}: unknown request", "update koordgen")
            if verb.locks and not self.lock.held:
                raise ToolError("not locked", f"the request {request['verb']} needs the folder's lock")
            return {"ok": True, **verb.run(self, request)}
        except ToolError as error:
            return {"ok": False, "error": error.code, "message": error.message, "help": error.help}
        except OSError as error:
            return {"ok": False, **self._failure(error)}
        except (KeyError, TypeError, ValueError) as error:
            return {
                "ok": False,
                "error": "bad request",
                "message": f"{request['verb']}: {type(error).__name__}: {error}",
                "help": "",
            }
        except _Ended:
            raise
        except Exception:
            return {"ok": False, "error": "internal", "message": traceback.format_exc(), "help": "report it"}

    def _failure(self, error: OSError) -> Answer:
        path = error.filename or self.folder.root
        if error.errno == errno.EROFS:
            return {
                "error": "read-only",
                "message": f"{path}: the disk of this host is read-only",
                "help": "an SD card that fails becomes read-only: look at `dmesg`, then mount it for writing",
            }
        if error.errno in (errno.EACCES, errno.EPERM):
            return {
                "error": "no permission",
                "message": f"{path}: this user may not write here",
                "help": f"give the folder {self.folder.root} to the user that deploys",
            }
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            return {
                "error": "no space",
                "message": f"{path}: no space: {self.folder.free()} bytes are free",
                "help": "delete files on this host, then try again",
            }
        return {"error": "failed", "message": f"{path}: {error.strerror or error}", "help": ""}


def _seconds(request: Request, name: str = "seconds") -> float:
    seconds = float(request[name])
    if not 0 <= seconds <= _LONGEST_WAIT:
        raise ToolError("bad request", f"{name}: {seconds} is not between 0 and {_LONGEST_WAIT:.0f} s")
    return seconds


def _ping(session: Session, request: Request) -> Answer:
    return {"clock": time.time()}


def _inspect(session: Session, request: Request) -> Answer:
    try:
        with deciding(session.folder):
            session.deployment.repair()
    except OSError:  # the disk may be full or read-only; the answer reports this error
        pass
    return host.inspect(session.folder, session.boot, session.deployment)


def _lock(session: Session, request: Request) -> Answer:
    session.lock.acquire(str(request["owner"]), str(request["what"]))
    with deciding(session.folder):
        session.deployment.repair()
        if session.deployment.read()["pending"] is None:
            releases.clean(session.folder)
    return {}


def _missing(session: Session, request: Request) -> Answer:
    return objects.missing(session.folder, request.get("objects", []), request.get("wheels", []))


def _store(session: Session, request: Request) -> Answer:
    return {"stored": objects.store(session.folder, request["kind"], request["entries"], session.channel.data())}


def _key(session: Session, request: Request) -> Answer:
    content = b""
    for piece in session.channel.data():
        content += piece
        if len(content) > PIECE:
            raise ToolError("bad request", "the data are longer than any key")
    releases.write_key(session.folder, request["id"], content)
    return {}


def _stage(session: Session, request: Request) -> Answer:
    releases.stage(session.folder, request["release"], request["files"])
    return {}


def _release(session: Session, request: Request) -> Answer:
    return releases.describe(session.folder, request["id"])


def _verify(session: Session, request: Request) -> Answer:
    return {"checked": releases.verify(session.folder, request["id"], request.get("load", True) is not False)}


def _switch(session: Session, request: Request) -> Answer:
    release, seconds = request["id"], _seconds(request)
    with deciding(session.folder):
        known = releases.readable(session.folder, (session.deployment.read()["confirmed"], release))
        nonce = session.deployment.switch(release, seconds, lambda: agents.check_none_runs(session.folder, known))
    guardian.start(session.folder, session.boot, nonce)
    return {}


def _prepare(session: Session, request: Request) -> Answer:
    with deciding(session.folder):
        session.deployment.prepare(request["id"])
    return {}


def _confirm(session: Session, request: Request) -> Answer:
    with deciding(session.folder):
        session.deployment.confirm(request["id"])
    return {}


def _revert(session: Session, request: Request) -> Answer:
    with deciding(session.folder):
        return {"changed": session.deployment.revert(request["id"])}


def _source(session: Session, request: Request) -> Answer:
    return {"files": releases.source(session.folder, request["id"], request["robot"])}


def _packages(session: Session, request: Request) -> Answer:
    made = packages.make(session.folder, request["digest"], str(request["requirements"]), request["wheels"])
    return {"made": made}


def _start(session: Session, request: Request) -> Answer:
    return {"robots": running.start(session.folder, session.boot, session.deployment, request.get("robots"))}


def _stop(session: Session, request: Request) -> Answer:
    return {"stopped": running.stop(session.folder, session.deployment, request.get("robots"), _seconds(request))}


def _logs(session: Session, request: Request) -> Answer:
    since = float(request["since"] or 0.0) if "since" in request else None
    most = int(request.get("lines", logs.MOST_LINES))
    return running.log_lines(session.folder, session.deployment, request["robot"], most, since)


def _traces(session: Session, request: Request) -> Answer:
    return {"files": logs.traces(session.folder, request["robot"], bool(request.get("outer")))}


def _fetch(session: Session, request: Request) -> Answer:
    offset, length = int(request["offset"]), int(request["length"])
    data = session.fetching.fetch(request["robot"], bool(request.get("outer")), request["file"], offset, length)
    return {"length": len(data), "data": data}


def _doctor(session: Session, request: Request) -> Answer:
    return running.asked(session.folder, session.deployment, request["robot"], "--doctor", True)


def _status(session: Session, request: Request) -> Answer:
    return running.asked(session.folder, session.deployment, request["robot"], "--status", False)


VERBS = {
    "ping": Verb(_ping, False),
    "inspect": Verb(_inspect, False),
    "lock": Verb(_lock, False),
    "source": Verb(_source, False),
    "release": Verb(_release, False),
    "missing": Verb(_missing, False),
    "store": Verb(_store, True),
    "key": Verb(_key, True),
    "stage": Verb(_stage, True),
    "verify": Verb(_verify, True),
    "switch": Verb(_switch, True),
    "prepare": Verb(_prepare, True),
    "confirm": Verb(_confirm, True),
    "revert": Verb(_revert, True),
    "packages": Verb(_packages, True),
    "start": Verb(_start, False),
    "stop": Verb(_stop, False),
    "logs": Verb(_logs, False),
    "traces": Verb(_traces, False),
    "fetch": Verb(_fetch, False),
    "doctor": Verb(_doctor, False),
    "status": Verb(_status, False),
}


def serve(folder: Folder, boot: Boot, idle: float) -> int:
    """Run one session over standard input and output; return the exit status."""
    make_folder(folder.root, 0o700)
    Session(folder, boot, Channel(0, 1, idle)).run()
    return 0
