"""`koordgen dashboard`: serves a web page that shows the state of a fleet."""

from __future__ import annotations

import json
import os
import sys
import threading
from argparse import Namespace
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from koordgen.cli.base import console
from koordgen.lang import resources
from koordgen.operate.dashboard import Facts, Poller, RowsOfLevels, built_facts
from koordgen.operate.dashboard_access import AccessRefused, access
from koordgen.operate.estop import (
    ANSWER_TIMEOUT,
    CannotStop,
    Contact,
    StoppableFleet,
    contacts_of,
    find_fleet,
    show,
    stop_all,
)
from koordgen.operate.physical import physical_robots
from koordgen.operate.run_folder import SQUAD
from koordgen.runtime.ops.host import pip_install

if TYPE_CHECKING:
    from koordgen.runtime.trace.schema import Header
    from targets.sim.view.foxglove.stream import FoxgloveServer


def dashboard(options: Namespace) -> int:
    """Serve the dashboard of a fleet until Ctrl-C."""
    try:
        allowed = access(options.bind, options.port, options.tls_cert, options.tls_key, options.token)
        found = find_fleet(Path(options.fleet), console.notify)
        facts = _facts(found, options.fleet)
        contacts = contacts_of(facts.fleet, options.fleet, options.key, console.notify)
    except CannotStop as error:
        raise console.Failure(console.WRONG, str(error), f"{error.help}nobody was asked") from None
    except AccessRefused as error:
        raise console.Failure(console.USAGE if error.usage else console.SURROUNDINGS, str(error), error.help) from None
    sys.path.insert(0, str(resources.targets().parent))
    from targets.sim.view.web.dashboard import Dashboard, FleetServer, first_header

    targets = facts.plain.get("targets", {})
    rows = RowsOfLevels(contacts, lambda row, report, note: board.on_answer(row, report, note))
    names = [(name, SQUAD if name in rows.squads else targets.get(name, "")) for name in rows.names]
    plain = {name: value for name, value in facts.plain.items() if name != "targets"}
    poller = Poller(contacts, rows.on_answer)
    header = first_header(names, plain)
    board = Dashboard(
        header, lambda: poller.odd, None if options.foxglove is None else _stream(header, options.foxglove)
    )
    stop = _stop(contacts) if options.control else None
    try:
        server = FleetServer(allowed.host, options.port, board, stop, allowed.token, allowed.tls)
    except (OSError, OverflowError) as error:
        board.close()
        message = f"{allowed.host}:{options.port}: {getattr(error, 'strerror', None) or error}"
        raise console.Failure(console.SURROUNDINGS, message, "choose another port with `--port N`") from None
    print(f"dashboard: {server.url}", flush=True)
    if allowed.token:
        print(f"a browser must enter the token in {options.token}", flush=True)
    poller.start()
    threading.Thread(target=server.serve_forever, daemon=True).start()
    if options.browser:
        _open(server.url)
    try:
        board.run()
    finally:
        board.close()
        server.shutdown()
    return console.HOLDS


def _stream(header: Header, port: int) -> FoxgloveServer:
    """Return a server for the viewer Foxglove at a port of this computer (0: any free port)."""
    from targets.sim.view.foxglove.stream import FoxgloveServer

    try:
        server = FoxgloveServer(header, port)
    except ModuleNotFoundError as error:
        message = f"the Python package {error.name!r} is missing"
        raise console.Failure(console.SURROUNDINGS, message, pip_install("'koordgen[foxglove]'")) from None
    except OSError as error:
        raise console.Failure(console.SURROUNDINGS, str(error)) from None
    console.notify(f"foxglove: {server.url}")
    return server


def _facts(fleet: StoppableFleet, path: str) -> Facts:
    """Return the facts of a fleet file that the map shows: geofence, obstacles, world, targets.

    If the file has errors, a warning is printed, and the map shows only the robots.
    """
    from koordgen.build.pipeline import Rejected, read_fleet
    from koordgen.operate.basestation import all_targets

    if Path(path).is_dir():
        return built_facts(fleet, Path(path))
    try:
        read, _ = read_fleet(path, all_targets(), None, squads=True)
    except Rejected as error:
        reason = error.found[0][1].message if error.found else "it cannot be read"
        console.notify(f"warning: the map shows no obstacles: {path}: {reason}")
        return Facts(fleet, {})
    plain = {
        "delta": read.delta, "geofence": (read.geofence["lo"], read.geofence["hi"]), "obstacles": read.obstacles,
        "world": read.world.facts, "targets": {robot.name: robot.entry.target for robot in physical_robots(read, path)},
    }  # fmt: skip
    return Facts(fleet, plain)


def _stop(fleet: Sequence[Contact]) -> Callable[[], list[dict[str, Any]]]:
    """Return a function that stops the fleet and prints the result on this terminal."""

    def stop() -> list[dict[str, Any]]:
        results = stop_all(fleet, ANSWER_TIMEOUT)
        console.notify(f"emergency stop from the dashboard\n{show(results, 'text')}")
        robots: list[dict[str, Any]] = json.loads(show(results, "json"))["robots"]
        return robots

    return stop


def _open(url: str) -> None:
    """Show the page in a browser if a graphical desktop runs; a text browser would use this terminal."""
    if sys.platform == "darwin" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        import webbrowser

        webbrowser.open(url)
