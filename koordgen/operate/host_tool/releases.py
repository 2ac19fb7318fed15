"""Releases: folders of bundles, made of hard links to objects.

A release is made completely or not at all, and verified before it is used. Its `release.json` describes how its robots
are run. When a release is staged a second time, its new `release.json` is stored as `next.json` until it is confirmed,
so a deployment that fails cannot break the release that runs.
"""

from __future__ import annotations

import json
import os
import shutil
import stat
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from . import objects, packages
from .folder import (
    OUTER,
    Folder,
    ToolError,
    checked_path,
    checked_release,
    checked_robot,
    checked_sha256,
    key_id,
    make_folder,
    read_json,
    remove_tree,
    sha256_of,
    sync_folder,
    write_file,
    write_json,
)

_TIME_FOR_HELP = 120.0  # time limit in seconds for a bundle's --help, which imports all modules of the bundle
_FILES, _RELEASE, _NEXT = "files.json", "release.json", "next.json"


class Release(NamedTuple):
    """Content of a release's `release.json`.

    id: id of the release.
    robots: robots of this host, sorted.
    key: key id; empty for a fleet without a key.
    venv: digest of the virtual environment; empty if the packages of `python` are used.
    python: command of the interpreter.
    service: "systemd" or "none".
    squad_keys: key ids of the own fleets of the robots of squads, by robot.
    """

    id: str
    robots: tuple[str, ...]
    key: str
    venv: str
    python: str
    service: str
    squad_keys: Mapping[str, str]

    @property
    def keys(self) -> set[str]:
        """Return the ids of all keys that the release needs on this host."""
        return {self.key, *self.squad_keys.values()} - {""}


def read_release(folder: Folder, release: str, candidate: bool = False) -> Release:
    """Return the release with this id. Raises ToolError if it is not on this host.

    `candidate`: True to read `next.json`, if it exists, instead of `release.json`.
    """
    place = folder.release(release)
    found = read_json(place / _NEXT) if candidate else None
    document = found if found is not None else read_json(place / _RELEASE)
    if document is None:
        raise ToolError("missing", f"release {release} is not on this host", "deploy it")
    return parse_release(folder, document)


def readable(folder: Folder, ids: Iterable[str | None]) -> list[Release]:
    """Return those releases of `ids` that are on this host, each with its `next.json` if it has one."""
    found = []
    for release in ids:
        with suppress(ToolError):
            found += [] if release is None else [read_release(folder, release, candidate=True)]
    return found


def builds(folder: Folder, release: str | None) -> dict[str, str]:
    """Return robot -> build name, as in the robot's bundle of a release. Agents compare build names.

    The result is empty if `release` is None or not on this host.
    """
    found = {}
    for known in readable(folder, [release]):
        for robot in known.robots:
            with suppress(OSError):
                found[robot] = (folder.bundle(known.id, robot) / "RELEASE").read_text(encoding="ascii").strip()
    return found


def source(folder: Folder, release: str, robot: str) -> dict[str, str]:
    """Return the source files in a robot's bundle, by path: program, params, extern functions.

    A replay of the robot's traces needs these files. With several applications, those of each are in a folder of its
    own, and `source/composition.json` says which robots run it.
    """
    bundle = folder.bundle(checked_release(release), checked_robot(robot))
    found = [*bundle.glob("*.koord"), *bundle.glob("*_functions.py"), *bundle.glob("params.json")]
    found += [*bundle.glob("source/composition.json"), *bundle.glob("source/*/*")]
    return {str(path.relative_to(bundle)): path.read_text(encoding="utf-8") for path in found if path.is_file()}


def describe(folder: Folder, release: str) -> dict[str, Any]:
    """Return a release's `release.json` and the list of files in its bundles."""
    read_release(folder, release)
    place = folder.release(release)
    return {"release": read_json(place / _RELEASE), "files": read_json(place / _FILES) or {}}


def parse_release(folder: Folder, document: Any) -> Release:
    if not isinstance(document, dict) or not isinstance(document.get("robots"), dict):
        raise ToolError("bad request", "a release must be an object with a `robots` object")
    texts = {name: document.get(name) or "" for name in ("key", "venv", "python", "service")}
    if not all(isinstance(text, str) for text in texts.values()) or "\0" in texts["python"]:
        raise ToolError("bad request", "`key`, `venv`, `service` and `python` of a release must be strings")
    if texts["service"] not in ("systemd", "none"):
        raise ToolError("bad request", f"service {texts['service']!r}: systemd or none is expected")
    release = Release(
        checked_release(document.get("id")),
        tuple(sorted(checked_robot(name) for name in document["robots"])),
        texts["key"],
        texts["venv"],
        texts["python"] or "python3",
        texts["service"],
        _squad_keys(document["robots"]),
    )
    for key in release.keys:
        folder.key(key)
    if release.venv:
        folder.venv(release.venv)
    return release


def _squad_keys(robots: Mapping[str, Any]) -> dict[str, str]:
    found = {name: entry["key"] for name, entry in robots.items() if isinstance(entry, dict) and "key" in entry}
    if not all(isinstance(key, str) for key in found.values()):
        raise ToolError("bad request", "the `key` of a robot must be a string")
    return found


def interpreter(folder: Folder, release: Release) -> str:
    """Return the path of the Python interpreter that runs a release's bundles."""
    wanted = str(folder.venv(release.venv) / "bin" / "python") if release.venv else release.python
    found = shutil.which(wanted)
    if found is None:
        raise ToolError("no python", f"{wanted}: no such interpreter on this host", "set `python` in the fleet file")
    return os.path.abspath(found)


def command(folder: Folder, release: Release, robot: str, *options: str) -> list[str]:
    """Return the command that runs the bundle of a robot with the settings of this host."""
    overlay = str(folder.overlay(release.id, robot))
    return [interpreter(folder, release), str(folder.bundle(release.id, robot)), "--settings", overlay, *options]


def environment(folder: Folder) -> dict[str, str]:
    """Return the environment variables for bundles.

    Python writes compiled modules to another folder, so that the files of a release never change.
    """
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return kept | {"PYTHONPYCACHEPREFIX": str(folder.pycache)}


def run(folder: Folder, release: Release, robot: str, *options: str, seconds: float) -> tuple[int, str, str]:
    """Run a bundle until it ends; return its exit status, standard output and standard error.

    Status 124: the bundle did not end within `seconds`. Status 126: the bundle could not be started.
    """
    try:
        done = subprocess.run(
            command(folder, release, robot, *options), env=environment(folder), timeout=seconds,
            stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace", start_new_session=True,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return 124, "", f"not done in {seconds:.0f} s"
    except OSError as error:
        return 126, "", f"{error.filename}: {error.strerror}"
    return done.returncode, done.stdout, done.stderr


def stage(folder: Folder, document: Any, files: Mapping[str, Mapping[str, Sequence[Any]]]) -> None:
    """Make a release from stored objects. The release becomes visible by a rename, after it is complete."""
    release = parse_release(folder, document)
    wanted = _wanted(release, files)
    place = folder.release(release.id)
    with folder.room():
        make_folder(folder.releases)
        make_folder(folder.pycache)
        if place.is_dir():
            _complete(folder, place, document, wanted)
        else:
            staging = folder.releases / f".staging-{release.id}"
            remove_tree(staging)
            staging.mkdir()
            try:
                _fill(folder, staging, wanted)
                write_json(staging / _FILES, wanted)
                write_json(staging / _RELEASE, document)
                _write_overlays(folder, release, staging)
                os.rename(staging, place)
            except BaseException:
                remove_tree(staging)
                raise
            sync_folder(folder.releases)
            _link_compiled(folder, release, wanted)


def _link_compiled(folder: Folder, release: Release, wanted: Mapping[str, Mapping[str, Any]]) -> None:
    """Link compiled modules of the current release into a new release, for files that are equal.

    The links save most of the time that the first load of a bundle would take.
    """
    with suppress(OSError):
        current = folder.releases / Path(os.readlink(folder.current)).name
        known = read_json(current / _FILES) or {}
        for robot, files in wanted.items():
            bases = (current / robot, folder.bundle(release.id, robot))
            there, here = (folder.pycache / str(base).lstrip("/") for base in bases)
            for compiled in there.rglob("*.pyc"):
                place = compiled.relative_to(there)
                source = str(place.parent / f"{place.name.partition('.')[0]}.py")
                if source in files and files[source] == known.get(robot, {}).get(source):
                    (here / place).parent.mkdir(parents=True, exist_ok=True)
                    os.link(compiled, here / place)


def _complete(folder: Folder, place: Path, document: Any, wanted: dict[str, dict[str, Any]]) -> None:
    """Stage an existing release again: add bundles of new robots, and repair damaged files."""
    _fill(folder, place, wanted)
    write_json(place / _FILES, (read_json(place / _FILES) or {}) | wanted)
    release = parse_release(folder, document)
    _write_overlays(folder, release, place)
    if read_json(place / _RELEASE) == document:
        remove_tree(place / _NEXT)
    else:
        write_json(place / _NEXT, document)


def _wanted(release: Release, files: Any) -> dict[str, dict[str, Any]]:
    if not isinstance(files, dict) or tuple(sorted(files)) != release.robots:
        raise ToolError("bad request", "the request's `files` and `release` name different robots")
    wanted: dict[str, dict[str, Any]] = {}
    for robot, bundle in files.items():
        if not isinstance(bundle, dict) or "__main__.py" not in bundle:
            raise ToolError("bad request", f"robot {robot}: its bundle has no __main__.py")
        wanted[robot] = {}
        for path, entry in bundle.items():
            if not isinstance(entry, list) or len(entry) != 2 or not isinstance(entry[1], int):
                raise ToolError("bad request", f"robot {robot}, {path!r}: a file's entry must be [SHA-256, mode]")
            wanted[robot][checked_path(path)] = [checked_sha256(entry[0]), entry[1]]
    return wanted


def _fill(folder: Folder, place: Path, wanted: Mapping[str, Mapping[str, Any]]) -> None:
    """Make the bundles in `place` contain exactly the wanted files; files with the right content are kept."""
    for robot, files in wanted.items():
        bundle = place / robot
        folders = sorted(_folders_of(bundle, files))
        for path in folders:
            if path.is_symlink() or not path.is_dir():
                remove_tree(path)
                path.mkdir()
        for path in _extra(bundle, files):
            remove_tree(path)
        for name, (digest, mode) in files.items():
            if sha256_of(bundle / name) != digest:
                objects.link(folder, digest, bool(mode & stat.S_IXUSR), bundle / name)
        for path in reversed(folders):
            sync_folder(path)
    sync_folder(place)


def _folders_of(bundle: Path, files: Mapping[str, Any]) -> set[Path]:
    """Return the folder of a bundle, and all folders in it that contain its files."""
    above = {parent for path in files for parent in (bundle / path).parents}
    return {path for path in above if path.is_relative_to(bundle)}


def _extra(bundle: Path, files: Mapping[str, Any]) -> list[Path]:
    """Return the files and folders in a bundle's folder that do not belong to the bundle."""
    wanted, folders = {bundle / path for path in files}, _folders_of(bundle, files)
    found = []
    for here, subfolders, names in os.walk(bundle):
        found += [p for n in names if (p := Path(here) / n) not in wanted]
        unknown = [n for n in subfolders if (p := Path(here) / n) not in folders or p.is_symlink()]
        found += [Path(here) / n for n in unknown]
        subfolders[:] = [n for n in subfolders if n not in unknown]
    return found


def _write_overlays(folder: Folder, release: Release, place: Path) -> None:
    """Write the settings that override each bundle's own settings on this host.

    The settings place traces, the state and the key outside of the release, because a release never changes.
    """
    for robot in release.robots:
        path, bundle, trace = folder.overlay(release.id, robot), place / robot, "trace.jsonl"
        own = {"state": str(folder.state_of(robot)), "trace": str(folder.trace_folder(robot) / trace)}
        key = release.squad_keys.get(robot, release.key)
        _write_overlay(folder, path, own, key, bundle / "settings.json")
        if (bundle / f"{OUTER}.json").exists():
            outer = {"trace": str(folder.trace_folder(robot, True) / trace)}
            _write_overlay(folder, path.with_name(f"{OUTER}.json"), outer, release.key, bundle / f"{OUTER}.json")


def _write_overlay(folder: Folder, path: Path, overlay: dict[str, str], key: str, settings: Path) -> None:
    """Write settings that override those in the file `settings` of a bundle. `key`: key id; empty without a key."""
    make_folder(path.parent)
    make_folder(Path(overlay["trace"]).parent)
    if key:
        overlay = {**overlay, "key_file": str(folder.key(key))}
    elif not (read_json(settings) or {}).get("insecure", True):
        robot = settings.parent.name
        raise ToolError("no key", f"robot {robot}: its settings require a key, but the release has no key")
    if read_json(path) != overlay:
        write_json(path, overlay)


def verify(folder: Folder, release_id: str, load: bool = True) -> int:
    """Check all files and the key of a release; return the number of files. Raises ToolError.

    load: True to check also that each bundle can be loaded.
    """
    release = read_release(folder, release_id, candidate=True)
    known = read_json(folder.release(release.id) / _FILES) or {}
    count = 0
    for robot in release.robots:
        bundle, files = folder.bundle(release.id, robot), known.get(robot, {})
        wrong = [path for path, (digest, _) in files.items() if sha256_of(bundle / path) != digest]
        wrong += [str(path.relative_to(bundle)) for path in _extra(bundle, files)]
        if wrong or not files:
            raise ToolError("damaged", f"robot {robot}: {', '.join(wrong[:3]) or 'no file'}: missing or changed")
        count += len(files)
    for key in release.keys:
        check_key(folder, key)
    if load:
        with ThreadPoolExecutor(max_workers=os.cpu_count() or 1) as pool:
            list(pool.map(lambda robot: _check_loads(folder, release, robot), release.robots))
    return count


def _check_loads(folder: Folder, release: Release, robot: str) -> None:
    status, output, errors = run(folder, release, robot, "--help", seconds=_TIME_FOR_HELP)
    if status:
        last = (errors or output).strip()[-500:]
        raise ToolError("does not run", f"robot {robot}: its bundle does not load (status {status}): {last}")


def write_key(folder: Folder, key: str, content: bytes) -> None:
    path = folder.key(key)
    if key_id(content) != key:
        raise ToolError("damaged", f"the received key does not have the id {key}", "try again")
    with folder.room():
        make_folder(folder.keys, 0o700)
        os.chmod(folder.keys, 0o700)
        write_file(path, content, 0o600)


def check_key(folder: Folder, key: str) -> None:
    path = folder.key(key)
    try:
        mode, content = path.stat().st_mode, path.read_bytes()
    except OSError as error:
        raise ToolError("no key", f"{path}: {error.strerror}", "deploy again") from None
    if mode & 0o077 or key_id(content) != key:
        raise ToolError("no key", f"{path}: it holds another key, or other users can read it", "deploy again")


def accept(folder: Folder, release: str) -> None:
    """Replace a release's `release.json` by its `next.json`, if `next.json` exists."""
    place = folder.release(release)
    with suppress(FileNotFoundError):
        os.replace(place / _NEXT, place / _RELEASE)
        sync_folder(place)


def clean(folder: Folder) -> None:
    """Remove interrupted sessions' incomplete releases and `next.json` files. No release may be pending."""
    for path in [*folder.releases.glob(".staging-*"), *folder.releases.glob(f"*/{_NEXT}")]:
        remove_tree(path)


def staged(folder: Folder) -> list[str]:
    """Return the ids of the releases on this host."""
    if not folder.releases.is_dir():
        return []
    return sorted(p.name for p in folder.releases.iterdir() if not p.name.startswith(".") and p.is_dir())


def prune(folder: Folder, keep: Sequence[str]) -> None:
    """Remove all releases except `keep`, and settings, keys, packages and objects that are no longer used."""
    if folder.releases.is_dir():
        for path in list(folder.releases.iterdir()):
            if path.name not in keep:
                remove_tree(path)
                remove_tree(folder.settings / path.name)
                remove_tree(folder.pycache / str(path).lstrip("/"))
    here = [release for release in keep if folder.release(release).is_dir()]
    kept = [read_release(folder, release, candidate=c) for release in here for c in (False, True)]
    _prune_files(folder.keys, {f"{key}.key" for release in kept for key in release.keys})
    _prune_files(folder.venvs, {release.venv for release in kept})
    _prune_files(folder.wheels, {w for r in kept if r.venv for w in packages.wheels_of(folder.venv(r.venv))})
    objects.prune(folder)


def _prune_files(place: Path, keep: set[str]) -> None:
    if place.is_dir():
        for path in list(place.iterdir()):
            if path.name not in keep:
                remove_tree(path)


def to_document(text: str) -> Any:
    """Return the JSON document that a bundle printed; None if its output is not JSON."""
    try:
        return json.loads(text)
    except ValueError:
        return None
