"""`koordgen deploy`, `rollback` and `key`: change a release or key on all robots or on none."""

from __future__ import annotations

import os
import secrets
import sys
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from koordgen.cli.base import building, console
from koordgen.cli.base.terminal import ProgressLine
from koordgen.cli.operate import ssh
from koordgen.operate.physical import PhysicalRobot, physical_robots

if TYPE_CHECKING:
    from koordgen.fleet.file import Fleet
    from koordgen.operate.deploy import Deployed, Failed, Show

# Endings added to the name of the key file: the key before the last rotation, and the key of a rotation under way.
BEFORE, NEXT = ".before", ".next"


def deploy(options: Namespace) -> int:
    """Build the fleet and deploy it. Raises Failure."""
    from koordgen.operate import deploy as deployment

    options.collected = []
    path = building.fleet_path(options)
    bundles, app = building.planned(options, None, squads=True)
    options.fleet = path
    fleet = ssh.read_fleet(path)
    robots = physical_robots(fleet, path)
    hosts, connecting = ssh.fleet_hosts(fleet, path, robots), ssh.connection(options)
    place = fleet.deployment
    built = deployment.Built(
        {robot.name: bundles[robot.name] for robot in robots}, app, fleet.application_id, _key_bytes(fleet, options),
        place.service, place.wheels, Path(path).parent, _squad_keys(robots),
    )  # fmt: skip
    return _run(options, lambda show: deployment.deploy(hosts, connecting, built, options.take_over, show))


def rollback(options: Namespace) -> int:
    """Roll the fleet back to a release that its hosts still have. Raises Failure."""
    from koordgen.operate import deploy as deployment

    options.collected = []
    fleet = ssh.read_fleet(options.fleet)
    robots = physical_robots(fleet, options.fleet)
    hosts, connecting = ssh.fleet_hosts(fleet, options.fleet, robots), ssh.connection(options)
    key, squad_keys = _key_bytes(fleet, options), _squad_keys(robots)
    return _run(options, lambda show: deployment.rollback(hosts, connecting, options.to, key, squad_keys, show))


def key(options: Namespace) -> int:
    """Make a key, rotate the key of a fleet, or list the keys that its robots need. Raises Failure."""
    if options.action == "list":
        from koordgen.cli.operate.keys import list_keys

        return list_keys(options)
    return _rotate(options) if options.action == "rotate" else _new_key(options)


def _new_key(options: Namespace) -> int:
    try:
        _write_key(Path(options.file), secrets.token_bytes(32))
    except FileExistsError:
        help = "a key is never overwritten; choose another name, or run `koordgen key rotate FLEET`"
        raise console.Failure(console.SURROUNDINGS, f"{options.file} exists", help) from None
    print(f"{options.file}: keep this file beside the fleet file; `koordgen deploy` copies the key to every robot")
    return console.HOLDS


def _rotate(options: Namespace) -> int:
    """Give all robots a new key. Raises Failure.

    The new key is stored in FILE.next. When all robots have it, the old key is copied to FILE.before, and FILE.next is
    renamed to FILE.
    """
    from koordgen.operate import deploy as deployment

    options.collected = []
    fleet = ssh.read_fleet(options.file)
    if not fleet.key:
        raise console.Failure(
            console.WRONG, f"{options.file}: the fleet has no key: it is insecure", "set `key` instead"
        )
    robots = physical_robots(fleet, options.file)
    hosts, connecting = ssh.fleet_hosts(fleet, options.file, robots), ssh.connection(options)
    options.fleet = options.file
    old = _key_file(fleet, options)
    before, waiting = _with(old, BEFORE), _with(old, NEXT)
    _key_bytes(fleet, options)
    with suppress(FileExistsError):  # use the key of an interrupted rotation again: some robots may have it already
        _write_key(waiting, secrets.token_bytes(32))
    new = _read_key(waiting)

    def finish(show: Show) -> Deployed:
        try:
            done = deployment.rotate(hosts, connecting, new, show)
        except deployment.Missed as missed:
            missed.situation += f". Until then keep both {old} and {waiting}"
            raise
        except deployment.Failed as failed:
            if failed.situation == deployment.NOTHING_CHANGED:
                failed.situation += f", and {old} stays its key"
            raise
        _replace_key(old, before, waiting)
        return done

    status = _run(options, finish)
    if status == console.HOLDS and options.format == "text":
        print(f"{old} is the new key; {before} is the previous one. Copy {old} to every computer that stops the fleet")
    return status


def _replace_key(old: Path, before: Path, waiting: Path) -> None:
    """Copy the key file `old` to `before`, and rename the key file `waiting` to `old`. Raises Failure."""
    try:
        before.unlink(missing_ok=True)
        _write_key(before, old.read_bytes())
        os.replace(waiting, old)
    except OSError as error:
        message = f"all robots have the key in {waiting}, but the file cannot be renamed to {old}: {error.strerror}"
        raise console.Failure(console.SURROUNDINGS, message, "run the command again; it only renames files") from None


def _with(path: Path, ending: str) -> Path:
    return path.with_name(path.name + ending)


def _write_key(path: Path, content: bytes) -> None:
    """Write a new key file that only its owner may read. Raises FileExistsError, Failure."""
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(descriptor)
        except BaseException:
            os.unlink(path)  # an incomplete key file would prevent the next attempt, which never overwrites a file
            raise
    except FileExistsError:
        raise
    except OSError as error:
        raise console.Failure(console.SURROUNDINGS, f"{path}: {error.strerror}") from None


def _key_file(fleet: Fleet, options: Namespace) -> Path:
    """Return the key file: --key, else beside the fleet file, else in the working directory."""
    if options.key:
        return Path(options.key)
    beside = Path(options.fleet).parent / fleet.key
    return beside if beside.exists() or not Path(fleet.key).exists() else Path(fleet.key)


def _key_bytes(fleet: Fleet, options: Namespace) -> bytes | None:
    """Return the fleet's key; None for an insecure fleet. Raises Failure."""
    return _read_key(_key_file(fleet, options)) if fleet.key else None


def _squad_keys(robots: Sequence[PhysicalRobot]) -> dict[str, bytes | None]:
    """Return the key of each squad's robots, from beside their own fleet file, by their names. Raises Failure."""
    found: dict[str, bytes | None] = {}
    for robot in robots:
        if robot.squad:
            found[robot.name] = _read_key(robot.file.parent / robot.fleet.key) if robot.fleet.key else None
    return found


def _read_key(path: Path) -> bytes:
    from koordgen.runtime.net.seal import BadKey, load_key

    try:
        return load_key(path)
    except BadKey as error:
        raise console.Failure(console.WRONG, str(error), "nothing was changed") from None


def _run(options: Namespace, run: Callable[[Show], Deployed]) -> int:
    """Run a deployment, show its progress on a terminal, and print its result; return the exit status."""
    from koordgen.operate.deploy import Failed

    try:
        with _progress(options) as show:
            done = run(show)
    except Failed as failed:
        return _report_failure(options, failed)
    if options.format == "json":
        console.print_document(options, _as_data(done))
    else:
        print(_as_text(done))
    return console.HOLDS


@contextmanager
def _progress(options: Namespace) -> Iterator[Show]:
    line = ProgressLine(sys.stderr)
    shown = not options.quiet and options.format == "text"
    try:
        yield line.show if shown else lambda text: None
    finally:
        line.end()


def _report_failure(options: Namespace, failed: Failed) -> int:
    status = ssh.status_of(failed.errors) if failed.errors else console.INTERRUPTED
    from koordgen.operate.deploy import Missed

    if isinstance(failed, Missed):
        status = console.WRONG
    if options.format == "json":
        errors = [
            {"robots": list(each.host.robots), "host": each.host.login.text, "error": each.code,
             "message": each.message, "help": each.help} for each in failed.errors
        ]  # fmt: skip
        console.print_document(options, {"release": None, "outcome": failed.situation, "errors": errors})
        return status
    for error in failed.errors:
        console.notify(f"error: {error}" + (f"\n  help: {error.help}" if error.help else ""))
    console.notify(failed.situation if failed.errors else f"interrupted; {failed.situation}")
    return status


def _as_data(done: Deployed) -> dict[str, object]:
    return {
        "release": done.release,
        "hosts": [
            {
                "host": host.login.text,
                "robots": list(host.robots),
                "before": before,
                "changed": host in done.changed,
                "sent_bytes": done.sent[host],
            }
            for host, before in done.before.items()
        ],
        "seconds": {name: round(seconds, 3) for name, seconds in done.seconds.items()},
        "errors": [],
    }


def _as_text(done: Deployed) -> str:
    robots = sum(len(host.robots) for host in done.before)
    sent = sum(done.sent.values())
    took = sum(done.seconds.values())
    size = f"{sent / 1e6:.1f} MB sent, {took:.1f} s"
    named = f"{robots} robot{'s' if robots != 1 else ''}"
    if not done.changed:
        return f"release {done.release}: already on {named}; {size}"
    return f"release {done.release}: on {named}, confirmed; {size}"
