"""Output of check results: as a table that fits a narrow terminal, as one JSON document, or as one line a check."""

from __future__ import annotations

import json
import shutil
import sys
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Literal

from koordgen.runtime.ops.host import files, host, install_requirements, is_bundled
from koordgen.runtime.vehicle.platform import Finding

OK, WRONG, SURROUNDINGS = 0, 1, 5
# Names of the checks of the user's own files, in a bundle that was built and copied. All other checks concern the
# environment of the robot.
OWN = ("files", "settings", "key", "program", "body", "outer", "outer key")
NARROWEST, WIDEST = 40, 100
_NAME = 10
_INDENT = " " * (_NAME + 7)
Form = Literal["text", "json"]


def status(results: Iterable[Finding]) -> int:
    """Return the exit status: 0 if no check failed, 1 if a check of files failed, 5 if only other checks failed."""
    failed = {finding.name for finding in results if finding.state == "fail"}
    return OK if not failed else WRONG if failed & set(OWN) else SURROUNDINGS


def print_checks(app: str, results: Iterable[Finding], form: Form) -> int:
    """Print the results of all checks on standard output. Return the exit status.

    `form`: "text" prints each result immediately, "json" prints one JSON document at the end."""
    width = min(WIDEST, max(NARROWEST, shutil.get_terminal_size().columns))
    shown = []
    for finding in results:
        shown.append(finding)
        if form == "text":
            print(row(finding, width), flush=True)
    result = status(shown)
    if form == "json":
        print(json.dumps({"app": app, "status": result, "checks": [asdict(f) for f in shown]}, indent=2))
    else:
        failed, doubtful = (sum(f.state == state for f in shown) for state in ("fail", "warn"))
        print(f"{len(shown)} checks: {failed} failed, {doubtful} warnings")
    return result


def row(finding: Finding, width: int) -> str:
    """Return the result of one check as lines of at most `width` characters; a longer word is not broken."""
    lines = [f"{finding.state.upper() if finding.state == 'fail' else finding.state:<5} {finding.name:<{_NAME}} "]
    lines[0] += finding.found
    if finding.state != "ok":
        lines += [f"{_INDENT}wanted: {finding.wanted}"] * bool(finding.wanted)
        lines += [f"{_INDENT}{finding.why}"] * bool(finding.why)
    wrapper = textwrap.TextWrapper(
        width, subsequent_indent=_INDENT, break_on_hyphens=False, break_long_words=False, drop_whitespace=True
    )
    return "\n".join(wrapper.fill(line) for line in lines)


def print_briefly(results: Iterable[Finding]) -> int:
    """Print the result of each check on one line, and stop after the first failed check. Return the exit status."""
    for finding in results:
        if finding.state == "fail":
            print(f"error: {_whole(finding)}", file=sys.stderr)
            return status([finding])
        if finding.state == "warn":
            print(f"warning: {_whole(finding)}", file=sys.stderr)
        else:
            print(f"{finding.name:<{_NAME}} {finding.found}", flush=True)
    return OK


def _whole(finding: Finding) -> str:
    wanted = f"; wanted: {finding.wanted}" if finding.wanted else ""
    hint = f"\n  help: {finding.why}" if finding.why else ""
    return f"{finding.name}: {finding.found}{wanted}{hint}"


def report_unloadable(root: Path, argv: Sequence[str], error: ImportError) -> int:
    """Print the error of a bundle that cannot be imported. Return the exit status.

    If `argv` contains `--doctor`, also print the results of all checks that need no import."""
    own = files(root)
    is_own = own.state == "fail" and is_bundled(root, error.name or "")
    kind, why = ("file of the bundle for", own.why) if is_own else ("Python package", install_requirements(root))
    what = f"the {kind} {error.name!r} is missing or does not load: {error}"
    found = [*host(root), own if is_own and "--doctor" not in argv else Finding("import", "fail", what, why=why)]
    if "--doctor" in argv:
        return print_checks(root.name, found, "json" if "json" in argv or "--format=json" in argv else "text")
    return print_briefly(found[-1:])
