"""Locks of the folder.

The session lock lets only one session at a time change the folder. `deciding` is the critical section for changes of
`deployment.json` and starts of agents. All locks are flock(2) on open files, so the kernel releases a lock when its
process ends, even if the process is killed.
"""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from .folder import Folder, ToolError, read_json, write_json

_LOCK_TIMEOUT = 60.0  # longest wait for another process to leave the critical section, in seconds
_PROBED = 0.3  # seconds to retry a lock; `is_locked` of another process may hold the lock for some microseconds


def try_lock(path: Path, timeout: float = _PROBED) -> int | None:
    """Lock `path` and return the open file, which holds the lock until it is closed.

    Returns None if another process still holds the lock after `timeout` seconds.
    """
    file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    end = time.monotonic() + timeout
    try:
        while True:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return file
            except BlockingIOError:
                if time.monotonic() > end:
                    os.close(file)
                    return None
                time.sleep(0.02)
    except OSError:
        os.close(file)
        raise


def is_locked(path: Path) -> bool:
    """Return whether a process holds the lock of `path`."""
    try:
        file = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    finally:
        os.close(file)
    return False


@contextmanager
def deciding(folder: Folder) -> Iterator[None]:
    """Critical section for changes of `deployment.json` and starts of agents. Raises ToolError "busy"."""
    file = try_lock(folder.deployment_lock, _LOCK_TIMEOUT)
    if file is None:
        raise ToolError(
            "busy", f"another process has worked in {folder.root} for {_LOCK_TIMEOUT:.0f} s", "try again later"
        )
    try:
        yield
    finally:
        os.close(file)


class SessionLock:
    """Lock of one session on the whole folder. The file `lock.json` names the lock's owner, for messages."""

    def __init__(self, folder: Folder) -> None:
        self._folder = folder
        self._file: int | None = None

    @property
    def held(self) -> bool:
        return self._file is not None

    def acquire(self, owner: str, what: str) -> None:
        """Acquire the lock. Raises ToolError "locked", which names the present owner and the lock's age."""
        if self._file is None:
            self._file = try_lock(self._folder.lock)
        if self._file is None:
            other = locked_by(self._folder) or {}
            age = time.time() - float(other.get("since", time.time()))
            raise ToolError(
                "locked",
                f"{other.get('owner', 'somebody')} works here since {age:.0f} s "
                f"({other.get('what', 'not known what')}, process {other.get('pid', 'unknown')})",
                "wait until the other command has ended, which releases the lock",
            )
        try:
            write_json(
                self._folder.lock_owner, {"owner": owner, "pid": os.getpid(), "since": time.time(), "what": what}
            )
        except OSError:
            self.release()
            raise

    def release(self) -> None:
        if self._file is not None:
            with suppress(OSError):
                self._folder.lock_owner.unlink()
            os.close(self._file)
            self._file = None


def locked_by(folder: Folder) -> dict[str, Any] | None:
    """Return the owner of the session lock, from `lock.json`; None when no living process holds the lock."""
    if not is_locked(folder.lock):
        return None
    found = read_json(folder.lock_owner)
    return found if isinstance(found, dict) else {}
