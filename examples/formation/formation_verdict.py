"""Verdict of a simulated run of Formation: robots must end in their order on the corners of a turned, regular polygon.

`python formation_verdict.py DIR`, with the folder of the run. Positions are the true ones at the mission's end, in plan
view, from DIR/summary.json. Each robot must be within 0.4 m of its corner of the polygon that fits them best, and that
polygon must have turned by 0.3 rad or more. Exit status: 0 yes, 3 no, 1 the files cannot be used, 2 usage.
"""

from __future__ import annotations

import cmath
import json
import math
import sys
from pathlib import Path

OFF, TURNED = 0.4, 0.3  # metres, radians


class Unusable(Exception):
    """Raised if the run's files cannot be judged. The message gives the reason."""


def read(folder: Path) -> tuple[list[str], list[complex], str]:
    """Return names, plan positions (m) at the mission's end, and the reason why the run failed ("" if it held).

    Raises Unusable.
    """
    try:
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        robots = summary["robots"]
        places = [complex(*robot["final"][:2]) for robot in robots]
        flaw = "" if summary["verdict"] == "held" else f"the run itself: {summary['verdict']}, {summary['why']}"
        return [robot["name"] for robot in robots], places, flaw
    except OSError as error:
        raise Unusable(f"{error.filename}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError) as error:
        raise Unusable(f"{folder}: not the folder of a run: {type(error).__name__}: {error}") from None


def fitted(places: list[complex]) -> tuple[complex, complex]:
    """Return centre, and first corner relative to it, of the regular polygon that fits the positions best.

    Best in least squares: they are the terms 0 and 1 of a discrete Fourier transform.
    """
    n = len(places)
    middle = sum(places) / n
    return middle, sum(p * cmath.exp(-2j * math.pi * k / n) for k, p in enumerate(places)) / n


def main(argv: list[str]) -> int:
    if len(argv) != 1 or argv[0].startswith("-"):
        print("usage: python formation_verdict.py DIR (the folder of a run of Formation)", file=sys.stderr)
        return 2
    try:
        names, places, flaw = read(Path(argv[0]))
    except Unusable as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    middle, first = fitted(places)
    n = len(places)
    off = [abs(p - middle - first * cmath.exp(2j * math.pi * k / n)) for k, p in enumerate(places)]
    turned = cmath.phase(first) % (2 * math.pi)
    for name, far in zip(names, off, strict=True):
        print(f"{name:8} {far:.3f} m off its corner")
    reasons = [f"{name} is {far:.2f} m off its corner" for name, far in zip(names, off, strict=True) if far > OFF]
    if turned < TURNED:
        reasons.append(f"the polygon has turned by only {turned:.2f} rad")
    if flaw:
        reasons.append(flaw)
    print("Formation: a polygon" if not reasons else f"Formation: NO: {'; '.join(reasons)}")
    figures = {
        "radius, m": round(abs(first), 3),
        "turned, rad": round(turned, 3),
        "worst corner, m": round(max(off), 3),
    }
    print(json.dumps(figures))
    return 3 if reasons else 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
