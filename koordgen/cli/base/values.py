"""Parsers of options' values. Each raises ArgumentTypeError, whose message has the allowed range."""

from __future__ import annotations

import argparse
import math

MOST_ROBOTS = 128  # largest number of robots in a fleet, as in koordgen/runtime/net/wire.py (a test compares both)
MOST_PROVED = 1000  # largest number of robots for `prove --robots`
LONGEST = 86400.0  # largest time of options, in seconds


def program(text: str) -> str:
    """Return the path of a program; refuse a YAML file."""
    if is_fleet(text):
        way = f"`koordgen build APP.koord --fleet {text}` checks a fleet file together with its program, and "
        way += f"`koordgen check {text}` one that names its programs; this command takes one program"
        raise argparse.ArgumentTypeError(f"expected a program (.koord), not the YAML file {text}; {way}")
    return text


def is_fleet(path: str) -> bool:
    """Return whether a file that `program_or_fleet` accepts is a fleet file, by its name."""
    return path.endswith((".yaml", ".yml"))


def fleet(text: str) -> str:
    """Return the path of a fleet file; refuse a program."""
    if text.endswith(".koord"):
        raise argparse.ArgumentTypeError(f"expected a fleet file (YAML), not the program {text}")
    return text


def release(text: str) -> str:
    """Return the id of a release, 16 hex digits."""
    if len(text) != 16 or not set(text) <= set("0123456789abcdef"):
        raise argparse.ArgumentTypeError(f"expected the 16 hex digits of a release, not {text!r}")
    return text


def seconds(text: str) -> float:
    """Return a time in seconds, 0.01 to 86400."""
    return _number(text, 0.01, LONGEST, "seconds")


def seconds_or_none(text: str) -> float:
    """Return a time in seconds, 0 to 86400."""
    return _number(text, 0.0, LONGEST, "seconds")


def time_of_run(text: str) -> float:
    """Return a time of a run in seconds since round 1; before round 1 it is negative."""
    return _number(text, -LONGEST, LONGEST, "seconds since round 1")


def rate(text: str) -> float:
    """Return a rate in Hz, 1 to 1000."""
    return _number(text, 1.0, 1000.0, "a rate in Hz")


def probability(text: str) -> float:
    """Return a probability strictly between 0 and 1."""
    return _number(text, 0.000001, 0.999, "a probability")


def share(text: str) -> float:
    """Return a probability, 0 and 1 included."""
    return _number(text, 0.0, 1.0, "a probability")


def short_time(text: str) -> float:
    """Return a time on a link in seconds, 0 to 10."""
    return _number(text, 0.0, 10.0, "seconds")


def factor(text: str) -> float:
    """Return a multiple of real time."""
    return _number(text, 0.001, 1000.0, "a multiple of real time")


def port(text: str) -> int:
    """Return a port of this host, 1 to 65535."""
    return _whole(text, 1, 65535)


def port_or_any(text: str) -> int:
    """Return a port of this host, 0 to 65535; 0 stands for any free port."""
    return _whole(text, 0, 65535)


def natural(text: str) -> int:
    """Return a whole number, 0 or more."""
    return _whole(text, 0)


def count(text: str) -> int:
    """Return a whole number, 1 or more."""
    return _whole(text, 1)


def fleet_size(text: str) -> int:
    """Return a number of robots that a fleet may have."""
    return _whole(text, 1, MOST_ROBOTS)


def application(text: str) -> int:
    """Return a fleet's `application_id`, 0 to 65535."""
    return _whole(text, 0, 65535)


def robots(text: str) -> list[int | None]:
    """Parse `any` (None), `5` or `3..15` into numbers of robots."""
    if text == "any":
        return [None]
    first, dots, last = text.partition("..")
    try:
        low, high = int(first), int(last) if dots else int(first)
    except ValueError:
        low = high = 0
    if not 1 <= low <= high <= MOST_PROVED:
        raise argparse.ArgumentTypeError(
            f"expected `any`, a number from 1 to {MOST_PROVED}, or a range such as 3..15, not {text}"
        )
    return list(range(low, high + 1))


def offset(text: str) -> tuple[float, float, float]:
    """Return a displacement X,Y,Z in metres (ENU) whose length is 0.1 to 1000."""
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected X,Y,Z in metres, such as 0.7,0.4,0, not {text}") from None
    if not 0.1 <= math.hypot(x, y, z) <= 1000.0:
        raise argparse.ArgumentTypeError(f"expected an offset from 0.1 to 1000 m long, not {text}")
    return x, y, z


def _number(text: str, least: float, most: float, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not least <= value <= most:
        raise argparse.ArgumentTypeError(f"expected {what} from {least:g} to {most:g}, not {text}")
    return value


def _whole(text: str, least: int, most: float = math.inf) -> int:
    value = int(text) if text.strip().isdecimal() else -1
    if not least <= value <= most:
        end = "on" if most == math.inf else f"to {most}"
        raise argparse.ArgumentTypeError(f"expected a whole number from {least} {end}, not {text}")
    return value
