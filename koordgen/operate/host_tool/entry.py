"""Command with which the tool starts itself again as another process."""

from __future__ import annotations

import os
import sys

from .deployment import Boot
from .folder import Folder


def command(folder: Folder, boot: Boot, *arguments: str) -> list[str]:
    """Return the command of this very tool on the same folder. Without site packages, which it does not need, it starts
    sooner."""
    options = ["--folder", str(folder.root), "--boot-id", str(boot.file)]
    return [sys.executable, "-IS", os.path.abspath(sys.argv[0]), *options, *arguments]
