"""Deployment state of a host: the confirmed release, and the pending one with its deadline.

The state is stored in `deployment.json`, which is replaced atomically. A pending release that is not confirmed before
its deadline is void. No process needs to run at the deadline: the next process that uses the state repairs it, and the
link `current` with it.
"""

from __future__ import annotations

import os
import secrets
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from . import releases
from .folder import Folder, ToolError, checked_release, read_json, sync_folder, write_json

_KEPT = 3  # number of confirmed releases that a host keeps for rollbacks


class Boot:
    """Clock of the host, which continues while the host is suspended, and the id of the present boot."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def id(self) -> str:
        return self.file.read_text(encoding="ascii").strip()

    def now(self) -> float:
        """Return the seconds since this boot, including suspended time."""
        return time.clock_gettime(time.CLOCK_BOOTTIME)


class Deployment:
    """Deployment state of one folder. Call every method except `read` inside `lock.deciding`."""

    def __init__(self, folder: Folder, boot: Boot) -> None:
        self._folder = folder
        self._boot = boot

    def read(self) -> dict[str, Any]:
        """Return the content of `deployment.json`. Raises ToolError when it is damaged."""
        path = self._folder.deployment
        if not path.exists():
            return {"confirmed": None, "history": [], "pending": None}
        found = read_json(path)
        if not isinstance(found, dict) or not {"confirmed", "history", "pending"} <= found.keys():
            raise ToolError("damaged", f"{path} is damaged", "move the file away, then deploy again")
        return found

    def current(self) -> str | None:
        """Return the release that the link `current` names."""
        try:
            return Path(os.readlink(self._folder.current)).name
        except OSError:
            return None

    def has_expired(self, pending: dict[str, Any]) -> bool:
        return bool(pending["boot"] != self._boot.id() or self._boot.now() >= pending["deadline"])

    def runnable(self) -> str:
        """Return the confirmed release. Raises ToolError while another release is pending, or without any."""
        state = self.read()
        pending, confirmed = state["pending"], state["confirmed"]
        if pending is not None and not self.has_expired(pending):
            left = pending["deadline"] - self._boot.now()
            raise ToolError(
                "unconfirmed",
                f"release {pending['id']} waits for its confirmation; without confirmation this host returns to "
                f"{confirmed or 'having no release'} in {left:.0f} s",
                "wait for the confirmation, or deploy again",
            )
        if confirmed is None:
            raise ToolError("unconfirmed", "no release was confirmed on this host", "deploy a release")
        return str(confirmed)

    def repair(self) -> None:
        """Revert a pending release that has expired, and make the link `current` name the confirmed release."""
        state = self.read()
        pending = state["pending"]
        if pending is not None and self.has_expired(pending):
            self._return(state)
        elif pending is None and self.current() != state["confirmed"]:
            self._link(state["confirmed"])

    def switch(self, release: str, seconds: float, check: Callable[[], None]) -> str:
        """Make `release` the pending release for `seconds`; return the nonce that identifies this switch.

        check: called before any change; raises an exception if the robots must not be changed now, because agents run.
        A pending release of an earlier session, which no longer holds the folder's lock, is replaced.
        """
        releases.read_release(self._folder, release, candidate=True)
        check()
        with self._folder.room():
            state = self.read()
            if state["pending"] is not None:
                self._return(state)
            nonce = secrets.token_hex(8)
            pending = {
                "id": release,
                "from": state["confirmed"],
                "boot": self._boot.id(),
                "deadline": self._boot.now() + seconds,
                "seconds": seconds,
                "prepared": False,
                "nonce": nonce,
            }
            self._write(state | {"pending": pending})
            self._link(release)
        return nonce

    def prepare(self, release: str) -> None:
        """Phase one: check that this host can confirm `release`, and record that.

        The first call extends the deadline by the number of seconds that `switch` received.
        """
        state, pending = self._pending(release)
        releases.read_release(self._folder, release, candidate=True)
        if not pending["prepared"]:
            deadline = pending["deadline"] + pending["seconds"]
            with self._folder.room():
                self._write(state | {"pending": pending | {"prepared": True, "deadline": deadline}})

    def confirm(self, release: str) -> None:
        """Phase two: make `release` the confirmed release. A second call has no effect."""
        state = self.read()
        if state["pending"] is None and state["confirmed"] == checked_release(release):
            return
        state, pending = self._pending(release)
        if not pending["prepared"]:
            raise ToolError("not prepared", f"release {release} was not prepared", "prepare it first")
        history = [each for each in state["history"] if each != release] + [release]
        with self._folder.room():
            releases.accept(self._folder, release)
            self._write({"confirmed": release, "history": history[-_KEPT:], "pending": None})
        # the release is confirmed; a later confirmation removes the files that remain
        with suppress(OSError, ToolError):
            releases.prune(self._folder, history[-_KEPT:])

    def revert(self, release: str) -> bool:
        """Revert `release` if it is pending; return whether it was pending."""
        state = self.read()
        pending = state["pending"]
        if pending is not None and pending["id"] == checked_release(release):
            self._return(state)
            return True
        if state["confirmed"] == release:
            raise ToolError("confirmed", f"release {release} is confirmed", "roll back to another release instead")
        self.repair()
        return False

    def _pending(self, release: str) -> tuple[dict[str, Any], dict[str, Any]]:
        checked_release(release)
        state = self.read()
        pending = state["pending"]
        if pending is None or pending["id"] != release:
            raise ToolError("expired", f"release {release} is not pending on this host", "deploy it again")
        if self.has_expired(pending) or self.current() != release:
            self.repair()
            raise ToolError("expired", f"release {release} was not confirmed in time", "deploy it again")
        return state, pending

    def _return(self, state: dict[str, Any]) -> None:
        """Revert the pending release.

        The link `current` is changed first, because `confirm` refuses a release that `current` does not name.
        """
        self._link(state["confirmed"])
        self._write(state | {"pending": None})

    def _write(self, state: dict[str, Any]) -> None:
        write_json(self._folder.deployment, state)

    def _link(self, release: str | None) -> None:
        """Make the link `current` name a release, or remove the link; the change is one atomic rename."""
        path = self._folder.current
        if self.current() == release:
            return
        if release is None:
            path.unlink()
        else:
            beside = path.with_name(f".current.{os.getpid()}")
            with suppress(FileNotFoundError):
                beside.unlink()
            os.symlink(f"releases/{release}", beside)
            os.replace(beside, path)
        sync_folder(path.parent)
