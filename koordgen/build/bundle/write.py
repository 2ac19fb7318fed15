"""Writing of bundles: first into a staging folder, then into place by rename. The user's files are never replaced.

A folder may be replaced if its SHA256SUMS begins with MARK and lists every file in it with its present digest: then the
user cannot lose anything. Only Python's byte code of listed files may be there in addition.
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import suppress
from hashlib import sha256
from pathlib import Path, PurePosixPath

SUMS = "SHA256SUMS"
MARK = "# written by koordgen; a build replaces this folder while nothing in it is changed or added"
STAGING = ".building-"  # prefix of a staging folder's name; the process id follows


class CannotWrite(Exception):
    """Raised if the output folder cannot be written. The message has path and reason, `hint` what to do."""

    def __init__(self, message: str, hint: str) -> None:
        super().__init__(message)
        self.hint = hint


class Foreign(CannotWrite):
    """Raised if the output folder has files that koordgen did not write, or that were changed afterwards."""


def sums(files: Mapping[str, bytes]) -> bytes:
    """Return the content of SHA256SUMS for these files. Its first line is MARK, a comment for `sha256sum -c`."""
    lines = [f"{sha256(data).hexdigest()}  {path}\n" for path, data in sorted(files.items())]
    return "".join([f"{MARK}\n", *lines]).encode()


def write(bundles: Mapping[str, Mapping[str, bytes]], folder: Path) -> None:
    """Write each bundle (name -> relative path -> bytes) as `folder/<name>/`: all bundles or none.

    A bundle that is already there with equal bytes is not written again. Raises Foreign before anything is written, and
    CannotWrite after an error of the disk.
    """
    _sweep(folder)
    standing = {name: _must_be_ours(folder / name) for name in bundles}
    bundles = {name: files for name, files in bundles.items() if files[SUMS] != standing[name]}
    if not bundles:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        staging = folder / f"{STAGING}{os.getpid()}"  # importing tempfile would take as long as all our own imports
        staging.mkdir()
    except OSError as error:
        raise _refused(folder, error) from None
    try:
        for name, files in bundles.items():
            _fill(staging / "new" / name, files)
        _swap(staging, folder, list(bundles))
    except OSError as error:
        raise _refused(folder, error) from None
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _refused(folder: Path, error: OSError) -> CannotWrite:
    place = error.filename or folder
    return CannotWrite(
        f"{place}: {error.strerror or error}",
        "nothing was changed; make the folder writable, free space, or choose another folder with -o",
    )


def _fill(folder: Path, files: Mapping[str, bytes]) -> None:
    made: set[str] = set()
    root = str(folder)
    for path, data in files.items():
        full = f"{root}/{path}"
        parent = os.path.dirname(full)
        if parent not in made:
            os.makedirs(parent, exist_ok=True)
            made.add(parent)
        descriptor = os.open(full, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)  # os.open takes half the time of `open`
        try:
            if os.write(descriptor, data) != len(data):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), full)
        finally:
            os.close(descriptor)


def _swap(staging: Path, folder: Path, names: list[str]) -> None:
    """Move the staged bundles into place by rename. If a rename fails, undo the earlier ones."""
    (staging / "old").mkdir()
    done: list[str] = []
    try:
        for name in names:
            if (folder / name).exists():
                (folder / name).rename(staging / "old" / name)
            done.append(name)
            (staging / "new" / name).rename(folder / name)
    except OSError:
        for name in done:
            shutil.rmtree(folder / name, ignore_errors=True)
            if (staging / "old" / name).exists():
                (staging / "old" / name).rename(folder / name)
        raise


def _sweep(folder: Path) -> None:
    """Remove staging folders of builds that were killed, after moving old bundles in them back into place."""
    for staging in folder.glob(f"{STAGING}*"):
        number = staging.name.removeprefix(STAGING)
        if staging.is_symlink() or not number.isdecimal() or _runs(int(number)):
            continue
        with suppress(OSError):
            for old in (staging / "old").glob("*"):
                if not (folder / old.name).exists():
                    old.rename(folder / old.name)
            shutil.rmtree(staging)


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        pass
    return True


def _must_be_ours(folder: Path) -> bytes | None:
    """Return the SHA256SUMS of a complete bundle in `folder`; None if the bundle or one of its files is missing.

    Raises Foreign if the folder has a file that koordgen did not write, or that was changed.
    """
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        message = f"{folder}: the build writes a bundle of this name, but this file or link is not from koordgen"
        raise Foreign(message, "move it away, or choose another folder with -o")
    if not folder.is_dir():
        return None
    known = _known(folder)
    found = dict(_contents(folder, known))
    if not found:
        return None
    strange = sorted(path for path in found if path != SUMS and path not in known)
    if not known and SUMS in found:
        strange = [SUMS]  # SHA256SUMS was written by the user or by an earlier version of koordgen
    changed = sorted(p for p in known if p in found and sha256(found[p].read_bytes()).hexdigest() != known[p])
    for paths, what in ((strange, "not written by koordgen"), (changed, "changed since koordgen wrote it")):
        if paths:
            more = f" and {len(paths) - 1} more" if len(paths) > 1 else ""
            raise Foreign(
                f"{folder / paths[0]}{more}: {what}, and the build would replace {folder}",
                "move the files that you need out of that folder and delete it, or choose another folder with -o",
            )
    return (folder / SUMS).read_bytes() if set(found) == {*known, SUMS} else None


def _contents(folder: Path, known: Mapping[str, str]) -> Iterator[tuple[str, Path]]:
    """Yield the path of each file, link and unexpected empty folder in `folder`.

    Left out: byte code that Python wrote for `known` files, and empty folders that belong to a `known` file.
    """
    parents = {parent.as_posix() for path in known for parent in PurePosixPath(path).parents}
    for root, folders, names in os.walk(folder):
        place = Path(root).relative_to(folder)
        compiled = place.name == "__pycache__" and place.parent.as_posix() in parents
        for name in [*names, *[each for each in folders if os.path.islink(os.path.join(root, each))]]:
            path = place / name
            if not (compiled and (place.parent / f"{name.partition('.')[0]}.py").as_posix() in known):
                yield path.as_posix(), folder / path
        if not (names or folders or compiled) and place.as_posix() not in (*parents, "."):
            yield place.as_posix(), folder / place


def _known(folder: Path) -> dict[str, str]:
    """Return the digest of each file that koordgen wrote, by path.

    The result is empty if SHA256SUMS is missing or does not begin with MARK.
    """
    try:
        mark, *listed = (folder / SUMS).read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):
        return {}
    if mark != MARK:
        return {}
    return {path: digest for digest, _, path in (line.partition("  ") for line in listed)}
