"""`koordgen status`: the table of a fleet's robots, once or again and again."""

from __future__ import annotations

import sys
import time
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

from koordgen import cli
from koordgen.estop import CannotStop, find_fleet, find_key
from koordgen.operate.status import Asked, ask_all, odd_releases, table, to_json

_EVERY = 1.0  # seconds from one table to the next


def status(options: Namespace) -> int:
    """Ask the fleet and print the answers; the status says whether all robots answered and are of one release."""
    try:
        fleet = find_fleet(Path(options.fleet), cli._say)
        key = find_key(fleet, options.fleet, options.key, cli._say)
    except CannotStop as error:
        raise cli.Failure(cli.WRONG, str(error), f"{error.help}nobody was asked") from None
    while True:
        began = time.monotonic()
        answers = ask_all(fleet, key)
        if options.watch and options.format == "text" and sys.stdout.isatty():
            print("\x1b[H\x1b[2J", end="")  # cursor home, then clear the screen
        print(to_json(answers) if options.format == "json" else table(answers), flush=True)
        if not options.watch:
            return _verdict(answers)
        time.sleep(max(0.0, began + _EVERY - time.monotonic()))


def _verdict(answers: Sequence[Asked]) -> int:
    if silent := [each.place.name for each in answers if each.report is None]:
        help = "are their computers on, and do their agents run? `python3 BUNDLE --status` asks on the robot itself"
        raise cli.Failure(cli.SURROUNDINGS, f"no answer from {', '.join(silent)}", help)
    if odd := odd_releases(answers):
        help = "build once with one fleet file, and copy every robot's bundle"
        raise cli.Failure(cli.WRONG, f"{', '.join(odd)} run another release than the rest", help)
    return cli.HOLDS
