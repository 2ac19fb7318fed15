"""Deployments by two-phase commit: a release is installed on all hosts of the fleet, or on none.

The steps are: stage on all hosts, verify, switch, then confirm in two phases. A host that switched reverts to its old
release by itself unless the switch is confirmed in time. Phase one (`prepare`) checks that every host can confirm; only
then phase two (`confirm`) begins. A failure before phase two reverts all hosts. A host that misses phase two reverts by
itself. The fleet then has two releases: its robots refuse to begin a mission together. The next deployment repairs the
fleet.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Collection, Coroutine, Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from koordgen.lang.node import Node
from koordgen.operate.host_tool_archive import archive
from koordgen.operate.hosts import Answer, Host, HostError, Options, Sessions, SshSession, owner, sessions
from koordgen.operate.release import (
    REQUIREMENTS,
    Bundles,
    FileMap,
    Fleetwide,
    HostPart,
    batches,
    file_map,
    key_id,
    objects_of,
    parts_of,
    release_id,
    robots_entry,
)
from koordgen.operate.wheels import CannotFetch, WheelSet, platform_of, wheel_set

# seconds from the switch to the end of `prepare`; `confirm` gets the same number of seconds in addition
CONFIRM_WITHIN = 60.0
MOST_CLOCK_ERROR = 60.0  # largest difference in seconds between a host's clock and this computer's clock
NOTHING_CHANGED = "nothing was changed: every robot keeps its release"

Show = Callable[[str], None]
SquadKeys = Mapping[str, bytes | None]  # robot of a squad -> key of its own fleet; None for a fleet without a key


class Failed(Exception):
    """Raised if a deployment fails, or if the user interrupts it (then `errors` is empty).

    `situation` says in one sentence which release every robot has now.
    """

    def __init__(self, errors: Iterable[HostError], situation: str = NOTHING_CHANGED) -> None:
        self.errors = tuple(errors)
        self.situation = situation
        super().__init__("; ".join(map(str, self.errors)))


class Missed(Failed):
    """Raised if some hosts confirmed the release and other hosts missed phase two."""


class Interrupted(Exception):
    """Raised if the user interrupted a phase. `results`: results and failures of that phase."""

    def __init__(self, results: tuple[dict[Host, Any], list[HostError]]) -> None:
        super().__init__("interrupted")
        self.results = results


class Deployed(Node):
    """Result of a deployment.

    release: id of the release that all hosts have now.
    before: release that each host had before; None if the host had no release.
    changed: hosts that were switched.
    seconds: duration of each phase.
    sent: bytes that were sent to each host.
    """

    release: str
    before: dict[Host, str | None]
    changed: tuple[Host, ...]
    seconds: dict[str, float]
    sent: dict[Host, int]


class Built(Node):
    """Input of a deployment: the bundles, and facts of the fleet file.

    `folder`: the folder of the fleet file. `squad_keys`: key of the own fleet of each robot of a squad.
    """

    bundles: Bundles
    app: str
    application_id: int
    key: bytes | None
    service: str
    wheels: str
    folder: Path
    squad_keys: SquadKeys = MappingProxyType({})


class Phases:
    """Phases of one deployment. Each phase runs on all hosts in parallel, and fails if one host fails."""

    def __init__(self, opened: Sessions, show: Show) -> None:
        self.hosts = opened.reached
        self.seconds: dict[str, float] = {}
        self._show = show

    async def phase(
        self,
        name: str,
        ask: Callable[[SshSession], Awaitable[Any]],
        among: Collection[Host] | None = None,
        patient: bool = False,
    ) -> dict[Host, Any]:
        """Run `ask` on the hosts `among` (default: all).

        Waits for the answers of all hosts, then raises Failed if a host failed.
        """
        found, failed = await self.attempt(name, ask, among, patient)
        if failed:
            raise Failed(failed)
        return found

    async def attempt(
        self,
        name: str,
        ask: Callable[[SshSession], Awaitable[Any]],
        among: Collection[Host] | None = None,
        patient: bool = False,
    ) -> tuple[dict[Host, Any], list[HostError]]:
        """Run `ask` on the hosts `among` (default: all); return the results and the failures.

        patient: an interrupt by the user takes effect after all hosts have answered, because the state of a host
            would be unknown after a request that was cut off.
        """
        asked = tuple(each for each in self.hosts if among is None or each.host in among)
        self._show(f"{name}: {len(asked)} host{'s' if len(asked) != 1 else ''}")
        began = time.monotonic()
        try:
            work = Sessions(asked, ()).each(ask)
            return await (_completed(work) if patient else work)
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.monotonic() - began


async def _completed(work: Coroutine[Any, Any, Any]) -> Any:
    """Return the result of `work`.

    After an interrupt, wait for `work` to end and raise Interrupted with its result.
    """
    task = asyncio.ensure_future(work)
    try:
        return await asyncio.shield(task)
    except asyncio.CancelledError:
        await asyncio.wait([task])
        raise Interrupted(task.result()) from None


def deploy(hosts: Sequence[Host], options: Options, built: Built, take_over: bool, show: Show) -> Deployed:
    """Deploy the release that was built to all hosts. Raises Failed, Missed, NoHosts."""

    async def run(phases: Phases) -> Deployed:
        inspected = await _begin(phases, "deploy", built.service)
        await _refuse_other_fleets(phases, inspected, built, take_over)
        sets = await _wheel_sets(phases, inspected, built)
        python = phases.hosts[0].host.python
        fleetwide = Fleetwide(built.application_id, built.app, built.service, python, key_id(built.key))
        entries = {
            robot: robots_entry(
                built.bundles[robot], each.host, found.venv if (found := sets[each.host]) else "",
                key_id(built.squad_keys[robot]) if robot in built.squad_keys else None,
            )
            for each in phases.hosts for robot in each.host.robots
        }  # fmt: skip
        files = {each.host: file_map(built.bundles, each.host.robots) for each in phases.hosts}
        name, parts = parts_of(fleetwide, files, entries)
        await _send(phases, parts, built, sets)
        await phases.phase("verify", lambda session: session.call("verify", id=name))
        return await _switch(phases, name, inspected)

    return asyncio.run(_with_sessions(hosts, options, show, run))


async def _with_sessions(
    hosts: Sequence[Host], options: Options, show: Show, run: Callable[[Phases], Awaitable[Deployed]]
) -> Deployed:
    show(f"connect: {len(hosts)} host{'s' if len(hosts) != 1 else ''}")
    began = time.monotonic()
    done: Deployed | None = None
    try:
        async with sessions(hosts, options, archive()) as opened:
            if opened.failed:
                raise Failed(opened.failed)
            phases = Phases(opened, show)
            phases.seconds["connect"] = time.monotonic() - began
            done = await run(phases)
    except asyncio.CancelledError:  # Ctrl-C before the switch began, or after the deployment ended
        if done is None:
            raise Failed(()) from None
    assert done is not None
    return done


async def _begin(phases: Phases, what: str, service: str = "") -> dict[Host, Answer]:
    """Lock and inspect all hosts; refuse a deployment to hosts that must not be changed now.

    Every deployment locks the first host (by login) before the others. If two deployments start together, only the
    deployment that locks the first host continues, so they cannot block
    each other.
    """
    first, *rest = sorted(each.host.login.text for each in phases.hosts)
    by_text = {each.host.login.text: each.host for each in phases.hosts}

    async def lock(session: SshSession) -> Answer:
        return await session.call("lock", owner=owner(), what=what)

    await phases.phase("lock", lock, [by_text[first]])
    if rest:
        await phases.phase("lock", lock, [by_text[text] for text in rest])

    async def inspect(session: SshSession) -> Answer:
        before = time.time()
        answer = await session.call("inspect")
        _refuse_state(session.host, answer, before, time.time(), service)
        return answer

    return await phases.phase("inspect", inspect)


def _refuse_state(host: Host, answer: Answer, before: float, after: float, service: str) -> None:
    """Raise HostError for a host on which a deployment would fail or do harm.

    The host gave its answer between `before` and `after`, in seconds since 1970 by this computer's clock.
    """
    if not answer["writable"]:
        help = "a failing SD card becomes read-only: read `dmesg` on the host, then mount the card for writing"
        raise HostError(host, "read-only", f"{answer['folder']} cannot be written", help)
    flying = {name: robot for name, robot in answer["robots"].items() if robot["running"]}
    if flying:
        named = ", ".join(f"{name} ({robot['phase'] or 'phase unknown'})" for name, robot in flying.items())
        help = "stop the robots and end their agents: `koordgen stop FLEET`"
        raise HostError(host, "in flight", f"agents run on the host: {named}", help)
    error = min(0.0, answer["clock"] - before) + max(0.0, answer["clock"] - after)
    if abs(error) > MOST_CLOCK_ERROR:
        side = "behind" if error < 0 else "ahead of"
        help = f"`ssh {host.login.user}@{host.login.name} sudo date -u --set=@{after:.0f}` sets the clock"
        message = f"the host's clock is {abs(error):.0f} s {side} this computer's; the limit is {MOST_CLOCK_ERROR:g} s"
        raise HostError(host, "clock", message, help)
    if service == "systemd" and not answer["linger"]:
        message = f"{answer['user']}'s services would end on the host when {answer['user']} logs out"
        help = f"run `sudo loginctl enable-linger {answer['user']}` on the host, or set `deploy: {{service: none}}`"
        raise HostError(host, "linger", message, help)


async def _refuse_other_fleets(phases: Phases, inspected: Mapping[Host, Answer], built: Built, take_over: bool) -> None:
    """Raise Failed if a host has a release of another fleet: another application, or unknown robots."""
    if take_over:
        return
    deployed = [host for host, answer in inspected.items() if answer["deployment"]["confirmed"]]

    async def look(session: SshSession) -> None:
        try:
            confirmed = inspected[session.host]["deployment"]["confirmed"]
            document = (await session.call("release", id=confirmed))["release"]
        except HostError as error:
            # the files of the host's release were deleted; this deployment installs new files
            if error.code == "missing":
                return
            raise
        strange = [name for name in document["robots"] if name not in built.bundles]
        other = document["application_id"] != built.application_id
        if strange or other:
            whose = f"application_id {document['application_id']}" if other else f"robots {', '.join(strange)}"
            message = f"the host has a release of another fleet: {document['app']}, {whose}"
            help = "name another folder: `deploy: {folder: ...}`, or replace the other fleet with --take-over"
            raise HostError(session.host, "other fleet", message, help)

    if deployed:
        await phases.phase("compare", look, deployed)


async def _wheel_sets(phases: Phases, inspected: Mapping[Host, Answer], built: Built) -> dict[Host, WheelSet | None]:
    """Return the wheels for each host: None for every host if the fleet file says `wheels: host`.

    Raises Failed.
    """
    if built.wheels == "host":
        return {each.host: None for each in phases.hosts}
    folder = None if built.wheels == "index" else built.folder / built.wheels
    fetched: dict[Any, asyncio.Future[WheelSet]] = {}

    async def fetch(session: SshSession) -> WheelSet:
        texts = [built.bundles[robot][REQUIREMENTS].decode() for robot in session.host.robots]
        wanted = "".join(dict.fromkeys(line for text in texts for line in text.splitlines(keepends=True)))
        try:
            platform = platform_of(inspected[session.host])
            if (wanted, platform) not in fetched:
                work = asyncio.to_thread(wheel_set, wanted, platform, folder)
                fetched[wanted, platform] = asyncio.ensure_future(work)
            return await fetched[wanted, platform]
        except CannotFetch as error:
            raise HostError(session.host, "wheels", str(error), error.help) from None

    return await phases.phase("wheels", fetch)


async def _send(
    phases: Phases, parts: Mapping[Host, HostPart], built: Built, sets: Mapping[Host, WheelSet | None]
) -> None:
    """Send each host its missing files, and stage its part of the release, without a switch to it."""
    packed: dict[tuple[str, ...], Any] = {}

    def pack(contents: list[tuple[str, str, bytes]]) -> Any:
        names = tuple(digest for _, digest, _ in contents)
        if names not in packed:
            packed[names] = list(batches(contents))
        return packed[names]

    async def send(session: SshSession) -> None:
        host, wheels = session.host, sets[session.host]
        objects = objects_of(built.bundles, host.robots)
        listed = list(wheels.digests.items()) if wheels else []
        lacking = await session.call("missing", objects=list(objects), wheels=listed)
        for entries, data in pack([(digest, digest, objects[digest]) for digest in lacking["objects"]]):
            await session.call("store", data, kind="objects", entries=entries)
        if wheels:
            for name in lacking["wheels"]:
                for entries, data in pack([(name, wheels.digests[name], wheels.files[name].read_bytes())]):
                    await session.call("store", data, kind="wheels", entries=entries)
        for key in {built.key, *[built.squad_keys[robot] for robot in host.robots if robot in built.squad_keys]}:
            await _send_key(session, key)
        if wheels:
            await session.call(
                "packages", digest=wheels.venv, requirements=wheels.requirements, wheels=list(wheels.files)
            )
        await session.call("stage", release=parts[host].document, files=parts[host].files)

    await phases.phase("send", send)


async def _send_key(session: SshSession, key: bytes | None) -> None:
    if key is not None:
        await session.call("key", key, id=key_id(key))


async def _switch(phases: Phases, name: str, inspected: Mapping[Host, Answer]) -> Deployed:
    """Switch all hosts that do not have release `name` yet, and confirm it in two phases.

    Raises Failed, Missed.
    """
    states = {host: answer["deployment"] for host, answer in inspected.items()}
    before = {host: state["confirmed"] for host, state in states.items()}
    late = [host for host, state in states.items() if state["confirmed"] != name or state["pending"]]
    if late:
        try:
            await phases.phase("switch", lambda each: each.call("switch", id=name, seconds=CONFIRM_WITHIN), late, True)
            await phases.phase("prepare", lambda each: each.call("prepare", id=name), late, True)
        except (Failed, Interrupted, asyncio.CancelledError) as error:
            situation = await _revert(phases, name, late)
            raise Failed(error.errors if isinstance(error, Failed) else (), situation) from None
        await _confirm(phases, name, late)
    sent = {session.host: session.sent for session in phases.hosts}
    return Deployed(name, before, tuple(late), phases.seconds, sent)


async def _revert(phases: Phases, name: str, late: Collection[Host]) -> str:
    """Revert all hosts to their previous releases; return a sentence that names the robots' releases."""
    _, failed = await phases.attempt("revert", lambda each: each.call("revert", id=name), late)
    if not failed:
        return NOTHING_CHANGED
    named = ", ".join(robot for error in failed for robot in error.host.robots)
    return (
        f"every robot keeps its release; the hosts of {named} could not be reached, and return to this release by "
        f"themselves within {2 * CONFIRM_WITHIN:g} s"
    )


async def _confirm(phases: Phases, name: str, late: Collection[Host]) -> None:
    """Run phase two on all hosts, even after an interrupt, so that few hosts have to be repaired.

    Raises Missed.
    """
    try:
        _, failed = await phases.attempt("confirm", lambda each: each.call("confirm", id=name), late, True)
    except Interrupted as interrupted:
        _, failed = interrupted.results
    if not failed:
        return
    there = sum(len(each.host.robots) for each in phases.hosts) - sum(len(error.host.robots) for error in failed)
    named = ", ".join(robot for error in failed for robot in error.host.robots)
    raise Missed(
        failed,
        f"{there} robots have release {name}; {named} missed the second phase, and return to their previous release "
        f"within {2 * CONFIRM_WITHIN:g} s unless the confirmation arrived. The fleet cannot begin a mission; the same "
        "command repairs it",
    )


def rollback(
    hosts: Sequence[Host], options: Options, to: str | None, key: bytes | None, squad_keys: SquadKeys, show: Show
) -> Deployed:
    """Roll all hosts back to the release `to`, else to the latest earlier release that all still have.

    key, squad_keys: the release must have these keys; see Built.
    Raises Failed, Missed, NoHosts.
    """

    async def run(phases: Phases) -> Deployed:
        inspected = await _begin(phases, "rollback")
        name = _common_release(inspected, to)

        async def check(session: SshSession) -> None:
            # the deployment already checked that the bundles load
            await session.call("verify", id=name, load=False)
            document = (await session.call("release", id=name))["release"]
            _refuse_robots(session.host, document)
            wanted = {robot: key_id(squad_keys[robot]) for robot in session.host.robots if robot in squad_keys}
            other = [robot for robot, own in wanted.items() if document["robots"][robot].get("key") != own]
            if document["key"] != key_id(key) or other:
                whose = f" of {', '.join(other)}" if other else ""
                message = f"release {name} has a different key from the given key{whose}"
                help = "a rotation copies the previous key to a file whose name ends in `.before`: name it with --key"
                raise HostError(session.host, "key", message, help)

        await phases.phase("verify", check)
        return await _switch(phases, name, inspected)

    return asyncio.run(_with_sessions(hosts, options, show, run))


def _common_release(inspected: Mapping[Host, Answer], to: str | None) -> str:
    """Return the target of a rollback: `to`, or the newest release on all hosts that some do not run.

    Raises Failed.
    """
    histories = {host: answer["deployment"]["history"] for host, answer in inspected.items()}
    confirmed = {answer["deployment"]["confirmed"] for answer in inspected.values()}
    first = next(iter(histories.values()))
    common = [name for name in first if all(name in history for history in histories.values())]
    if to is not None:
        lacking = [host for host, history in histories.items() if to not in history]
        if lacking:
            raise Failed(
                HostError(host, "missing", f"the host has no release {to}, but {', '.join(histories[host]) or 'none'}",
                          "`koordgen deploy` builds and deploys any program") for host in lacking
            )  # fmt: skip
        return to
    candidates: list[str] = [name for name in common if confirmed != {name}]
    if not candidates:
        help = "`koordgen deploy` deploys the program that you want"
        message = "no earlier release is still on all hosts of the fleet"
        raise Failed(HostError(host, "missing", message, help) for host in list(histories)[:1])
    return candidates[-1]


def _refuse_robots(host: Host, document: Mapping[str, Any]) -> None:
    if set(document["robots"]) != set(host.robots):
        message = f"the host's release {document['id']} is of robots {', '.join(document['robots'])}"
        raise HostError(host, "other fleet", message, "run `koordgen deploy` with this fleet file first")


def rotate(hosts: Sequence[Host], options: Options, new: bytes, show: Show) -> Deployed:
    """Install a new key on all hosts, as a new release with the same bundles.

    Raises Failed, Missed, NoHosts.
    """

    async def run(phases: Phases) -> Deployed:
        inspected = await _begin(phases, "key rotate")
        present = await phases.phase("compare", lambda each: _present(each, inspected[each.host]))
        documents = {host: answer["release"] for host, answer in present.items()}
        entries = {robot: entry for document in documents.values() for robot, entry in document["robots"].items()}
        _refuse_several(documents, entries)
        files: dict[Host, FileMap] = {host: answer["files"] for host, answer in present.items()}
        name, parts = parts_of(_fleetwide_of(next(iter(documents.values())), key_id(new)), files, entries)

        async def stage(session: SshSession) -> None:
            await _send_key(session, new)
            part = parts[session.host]
            await session.call("stage", release=part.document, files=part.files)

        await phases.phase("send", stage)
        await phases.phase("verify", lambda session: session.call("verify", id=name))
        return await _switch(phases, name, inspected)

    return asyncio.run(_with_sessions(hosts, options, show, run))


async def _present(session: SshSession, inspected: Answer) -> Answer:
    """Return the confirmed release of a host.

    Raises HostError if the host has no release, or a release of other robots.
    """
    confirmed = inspected["deployment"]["confirmed"]
    if confirmed is None:
        raise HostError(session.host, "missing", "the host has no release", "run `koordgen deploy` first")
    answer = await session.call("release", id=confirmed)
    _refuse_robots(session.host, answer["release"])
    return answer


def _fleetwide_of(document: Mapping[str, Any], key: str) -> Fleetwide:
    return Fleetwide(document["application_id"], document["app"], document["service"], document["python"], key)


def _refuse_several(documents: Mapping[Host, Mapping[str, Any]], entries: Mapping[str, Mapping[str, str]]) -> None:
    """Raise Failed if the releases of hosts differ in more than the key.

    Releases that differ only in the key are accepted: some hosts missed an earlier rotation, which this rotation
    repairs.
    """
    odd = [
        host for host, document in documents.items()
        if release_id(_fleetwide_of(document, document["key"]), entries) != document["id"]
    ]  # fmt: skip
    if odd:
        help = "run `koordgen deploy` first, which repairs the fleet"
        raise Failed(
            HostError(
                host,
                "mixed",
                f"the host's release {documents[host]['id']} differs from the other robots' release",
                help,
            )
            for host in odd
        )
