"""Releases: all files and settings that a fleet runs, named by a digest, and the part of each host.

Pure functions, without network or files.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterable, Iterator, Mapping
from hashlib import blake2s, sha256
from typing import Any

from koordgen.build.bundle.write import SUMS
from koordgen.lang.node import Node
from koordgen.operate.hosts import Host

REQUIREMENTS = "requirements.txt"
ID_DIGITS = 16
BATCH = 8_000_000  # largest sum of file sizes in one request, in bytes; a larger file has a request of its own
_MODE = 0o444  # mode of all files of a release: read-only, because a release never changes

Bundles = Mapping[str, Mapping[str, bytes]]  # robot -> path -> content
FileMap = dict[str, dict[str, list[Any]]]  # robot -> path -> [SHA-256, mode]


class Fleetwide(Node):
    """Entries of a release that are equal on all hosts."""

    application_id: int
    app: str
    service: str
    python: str
    key: str  # key id; empty for a fleet without a key


class HostPart(Node):
    """Part of a release that one host stores.

    document: content of the host's release.json.
    files: files of the bundles of the host's robots.
    """

    document: dict[str, Any]
    files: FileMap


def key_id(key: bytes | None) -> str:
    """Return the id of a key, a hash that does not reveal the key; empty without a key."""
    return "" if key is None else blake2s(key, person=b"koordgen", digest_size=8).hexdigest()


def digest_of(value: Any) -> str:
    """Return the SHA-256 of a value's canonical JSON."""
    return sha256(json.dumps(value, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def robots_entry(bundle: Mapping[str, bytes], host: Host, venv: str, key: str | None) -> dict[str, str]:
    """Return one robot's entry in release.json: digests and places that distinguish releases.

    key: key id of the own fleet of a squad's robot, empty for a fleet without a key; None for an ordinary robot.
    """
    own = {} if key is None else {"key": key}
    return {
        "bundle": sha256(bundle[SUMS]).hexdigest(),
        "packages": sha256(bundle[REQUIREMENTS]).hexdigest(),
        "host": host.login.text,
        "venv": venv,
        **own,
    }


def release_id(fleetwide: Fleetwide, robots: Mapping[str, Mapping[str, str]]) -> str:
    """Return the id of a release: a digest of everything that the fleet runs, equal on all hosts."""
    named = {
        "bundles": {name: robot["bundle"] for name, robot in robots.items()},
        "packages": {name: robot["packages"] for name, robot in robots.items()},
        "places": {name: [robot["host"], robot["venv"]] for name, robot in robots.items()},
        "key": fleetwide.key,
        "service": fleetwide.service,
        "python": fleetwide.python,
        "application_id": fleetwide.application_id,
        "app": fleetwide.app,
    }
    if squads := {name: robot["key"] for name, robot in robots.items() if "key" in robot}:
        named["squad_keys"] = squads
    return digest_of(named)[:ID_DIGITS]


def parts_of(
    fleetwide: Fleetwide, files: Mapping[Host, FileMap], robots: Mapping[str, Mapping[str, str]]
) -> tuple[str, dict[Host, HostPart]]:
    """Return the id of a release, and each host's part.

    files: files of the bundles of each host's robots.
    robots: entry in release.json of each robot of the fleet.
    """
    name = release_id(fleetwide, robots)
    parts = {}
    for host, own in files.items():
        venvs = {robots[robot]["venv"] for robot in own}
        assert len(venvs) == 1, "robots of one host share their packages"
        document = {
            "id": name,
            "application_id": fleetwide.application_id,
            "app": fleetwide.app,
            "robots": {robot: dict(robots[robot]) for robot in own},
            "key": fleetwide.key,
            "venv": venvs.pop(),
            "service": fleetwide.service,
            "python": fleetwide.python,
        }
        parts[host] = HostPart(document, own)
    return name, parts


def file_map(bundles: Bundles, robots: Iterable[str]) -> FileMap:
    """Return the digest and the mode of each file in the bundles of `robots`."""
    return {
        robot: {path: [sha256(data).hexdigest(), _MODE] for path, data in bundles[robot].items()} for robot in robots
    }


def objects_of(bundles: Bundles, robots: Iterable[str]) -> dict[str, bytes]:
    """Return the distinct file contents in the bundles of `robots`, by digest."""
    return {sha256(data).hexdigest(): data for robot in robots for data in bundles[robot].values()}


def batches(contents: Iterable[tuple[str, str, bytes]]) -> Iterator[tuple[list[list[Any]], bytes]]:
    """Yield `entries` and compressed data of `store` requests that send (name, SHA-256, content)."""
    entries: list[list[Any]] = []
    joined: list[bytes] = []
    for name, digest, data in contents:
        if entries and sum(map(len, joined)) + len(data) > BATCH:
            yield entries, zlib.compress(b"".join(joined), 6)
            entries, joined = [], []
        entries.append([name, digest, len(data)])
        joined.append(data)
    if entries:
        yield entries, zlib.compress(b"".join(joined), 6)
