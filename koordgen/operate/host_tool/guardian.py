"""Guardian of a pending release: a process of its own that returns to the old release when the time is over."""

from __future__ import annotations

import subprocess
import time
from contextlib import suppress

from .deployment import Boot, Deployment
from .entry import command
from .folder import Folder, ToolError
from .lock import deciding

_LONGEST_SLEEP = 1.0  # seconds; the host may have slept meanwhile, and a confirmed release needs no guardian
_RETRY = 5.0  # seconds between two tries to return, where the disk is full


def start(folder: Folder, boot: Boot, nonce: str) -> None:
    """Start the guardian of the switch that has this nonce, detached from the session."""
    subprocess.Popen(
        command(folder, boot, "guardian", nonce),
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        cwd=folder.root, start_new_session=True,
    )  # fmt: skip


def guard(folder: Folder, boot: Boot, nonce: str) -> int:
    """Wait until the switch was confirmed or reverted, or until its time is over and it is reverted here."""
    deployment = Deployment(folder, boot)
    while True:
        pending = deployment.read()["pending"]
        if pending is None or pending["nonce"] != nonce:
            return 0
        if not deployment.has_expired(pending):
            time.sleep(max(0.0, min(_LONGEST_SLEEP, pending["deadline"] - boot.now())))
            continue
        with suppress(OSError, ToolError), deciding(folder):
            deployment.repair()
            continue
        time.sleep(_RETRY)
