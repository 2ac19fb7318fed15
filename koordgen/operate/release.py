"""Releases: everything that a fleet runs, named by its content, and the part of it that each host stores. Pure."""

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
BATCH = 8_000_000  # bytes of contents that one request carries, unless one content alone is longer
_MODE = 0o444  # of all files of a release: nothing there changes

Bundles = Mapping[str, Mapping[str, bytes]]  # robot -> path -> content
FileMap = dict[str, dict[str, list[Any]]]  # robot -> path -> [SHA-256, mode]


class Fleetwide(Node):
    """Entries that are equal in every host's part of a release."""

    application_id: int
    app: str
    service: str
    python: str
    key: str  # key id; empty for a fleet without a key


class HostPart(Node):
    """Part of a release that one host stores. `document`: its release.json; bundles hold the contents of `files`."""

    document: dict[str, Any]
    files: FileMap


def key_id(key: bytes | None) -> str:
    """Return the name of a key, which reveals nothing about the key; empty without a key."""
    return "" if key is None else blake2s(key, person=b"koordgen", digest_size=8).hexdigest()


def digest_of(value: Any) -> str:
    """Return the SHA-256 of a value's canonical JSON."""
    return sha256(json.dumps(value, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def robots_entry(bundle: Mapping[str, bytes], host: Host, venv: str) -> dict[str, str]:
    """Return what release.json says of one robot: all by which two releases may differ."""
    return {
        "bundle": sha256(bundle[SUMS]).hexdigest(),
        "packages": sha256(bundle[REQUIREMENTS]).hexdigest(),
        "host": host.login.text,
        "venv": venv,
    }


def release_id(fleetwide: Fleetwide, robots: Mapping[str, Mapping[str, str]]) -> str:
    """Return the name of a release: it is the same on all hosts, and differs when anything that they run differs."""
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
    return digest_of(named)[:ID_DIGITS]


def parts_of(
    fleetwide: Fleetwide, files: Mapping[Host, FileMap], robots: Mapping[str, Mapping[str, str]]
) -> tuple[str, dict[Host, HostPart]]:
    """Return the id of a release, and each host's part. `robots` are the entries of all robots of the fleet."""
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
    """Return the files of some robots' bundles by their digests."""
    return {
        robot: {path: [sha256(data).hexdigest(), _MODE] for path, data in bundles[robot].items()} for robot in robots
    }


def objects_of(bundles: Bundles, robots: Iterable[str]) -> dict[str, bytes]:
    """Return the different contents of some robots' bundles by their digests."""
    return {sha256(data).hexdigest(): data for robot in robots for data in bundles[robot].values()}


def batches(contents: Iterable[tuple[str, str, bytes]]) -> Iterator[tuple[list[list[Any]], bytes]]:
    """Yield the `entries` and the compressed data of requests `store` for (name, SHA-256, content)."""
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
