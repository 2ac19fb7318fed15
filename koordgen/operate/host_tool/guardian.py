"""Guardian of a pending release: a separate process that reverts the release at its deadline."""

from __future__ import annotations

import subprocess
import time
from contextlib import suppress

from .deployment import Boot, Deployment
from .entry import command
from .folder import Folder, ToolError
from .lock import deciding

# Seconds between two looks at the deadline. A single long sleep would not count the time while the host is suspended,
# and the guardian should end soon after the release was confirmed.
_LONGEST_SLEEP = 1.0
_RETRY = 5.0  # seconds between two attempts to revert, for example while the disk is full


def start(folder: Folder, boot: Boot, nonce: str) -> None:
    """Start a guardian for the switch with this nonce, as a process that outlives the session."""
    subprocess.Popen(
        command(folder, boot, "guardian", nonce),
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        cwd=folder.root, start_new_session=True,
    )  # fmt: skip


def guard(folder: Folder, boot: Boot, nonce: str) -> int:
    """Wait until the switch is confirmed or reverted, and revert it after its deadline.

    Return exit status 0.
    """
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
