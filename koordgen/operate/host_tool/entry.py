"""Command line with which the tool starts itself as another process."""

from __future__ import annotations

import os
import sys

from .deployment import Boot
from .folder import Folder


def command(folder: Folder, boot: Boot, *arguments: str) -> list[str]:
    """Return the command that runs this tool with other arguments on the same folder.

    Python's site packages are disabled, because the tool does not need them and starts sooner without them.
    """
    options = ["--folder", str(folder.root), "--boot-id", str(boot.file)]
    return [sys.executable, "-IS", os.path.abspath(sys.argv[0]), *options, *arguments]
