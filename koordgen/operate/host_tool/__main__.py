"""Command line of the robot-side tool.

`python3 TOOL.pyz --folder FOLDER session|guardian NONCE|supervise ROBOT|launch ROBOT`
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from .deployment import Boot, Deployment
from .folder import Folder, ToolError

_SURROUNDINGS = 5  # exit status after an OSError; the supervisor or systemd then starts the process again
_IDLE = 30.0  # seconds without a request after which a session ends
_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


def main() -> int:
    """Run the tool with the arguments of its command line; return the exit status."""
    parser = argparse.ArgumentParser(description="Robot-side tool of koordgen's deployments.", allow_abbrev=False)
    parser.add_argument(
        "--folder", type=Path, required=True, help="folder of the fleet, absolute or in the home folder"
    )
    parser.add_argument("--boot-id", type=Path, default=_BOOT_ID, metavar="FILE", help="file with the id of this boot")
    parser.add_argument("--idle", type=float, default=_IDLE, help="seconds without a request that end a session")
    verbs = parser.add_subparsers(dest="verb", required=True)
    verbs.add_parser("session", help="answer requests on the standard input")
    verbs.add_parser("guardian", help="return from a release that is not confirmed in time").add_argument("nonce")
    verbs.add_parser("supervise", help="keep a robot's agent running").add_argument("robot")
    verbs.add_parser("launch", help="become a robot's agent").add_argument("robot")
    arguments = parser.parse_args()
    folder = Folder((Path.home() / arguments.folder).resolve())
    boot = Boot(arguments.boot_id)
    # Python caches no compiled modules of an archive and compiles them at each start. To start sooner, each verb
    # imports only the modules that it needs.
    if arguments.verb == "session":
        from . import session

        return session.serve(folder, boot, arguments.idle)
    try:
        if arguments.verb == "guardian":
            from . import guardian

            return guardian.guard(folder, boot, arguments.nonce)
        if arguments.verb == "supervise":
            from . import supervise

            return supervise.supervise(folder, boot, arguments.robot)
        from . import agents

        agents.launch(folder, Deployment(folder, boot), arguments.robot)
    except ToolError as error:
        print(f"error: {error.message}" + (f"\n  help: {error.help}" if error.help else ""), file=sys.stderr)
        return 1
    except OSError as error:
        print(f"error: {error.filename or folder.root}: {error.strerror or error}", file=sys.stderr)
    return _SURROUNDINGS
