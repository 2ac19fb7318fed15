"""What must hold of a fleet's traces, real or virtual: `lines` are each robot's trace, all its processes in order."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

Lines = Mapping[int, Sequence[dict[str, Any]]]
# How the reasons begin for which a robot without current shared state ran no event.
NOT_CURRENT = ("not current", "woke after", "left the mission", "not counted", "no record")


def rounds(lines: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    return [t for t in lines if t["kind"] == "round"]


def spoken(lines: Sequence[dict[str, Any]]) -> list[str]:
    return [t["text"] for t in lines if t["kind"] == "stream"]


def commits(lines: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rounds in which the counter's event took effect."""
    return [t for t in rounds(lines) if t["event"] == "Count" and "total" in t["shared"]]


def wrong_sums(lines: Lines, times: int, *, complete: bool = True) -> list[str]:
    """What is wrong with a counter that has come to its end. Not `complete`: a killed robot may have kept to itself
    what it did; all others must still have seen the right sum."""
    wrong: list[str] = []
    whole = times * len(lines)
    found = [(t["shared"]["total"], t["round"], pid) for pid in lines for t in commits(lines[pid])]
    totals = Counter(total for total, _, _ in found)
    wrong += [f"total {total} committed {many} times" for total, many in totals.items() if many > 1]
    in_order = [total for _, total in sorted((round_, total) for total, round_, _ in found)]
    if in_order != sorted(in_order):
        wrong.append("totals do not grow with the rounds")
    if complete and sorted(totals) != list(range(1, whole + 1)):
        wrong.append(f"{len(totals)} of {whole} totals committed")
    for pid in lines:
        said = spoken(lines[pid])
        wrong += [f"robot {pid} said: {text}" for text in said if text.startswith("wrong")]
        if f"total {whole}, here {times}" not in said and (complete or said):
            wrong.append(f"robot {pid} did not see the sum: {said}")
        own = [t["shared"]["counted"] for t in commits(lines[pid])]
        if own != sorted(set(own)) or (complete and own != list(range(1, times + 1))):
            wrong.append(f"robot {pid} counted {own}")
    return wrong


def wrong_reads(lines: Lines) -> tuple[int, list[str]]:
    """How many reads of others' steps there were, and those that did not give exactly S_r: what the other's last
    counted event before the reader's round wrote."""
    written: dict[int, tuple[list[int], list[int]]] = {}
    for pid in lines:
        steps = [(t["round"], t["shared"]["step"]) for t in rounds(lines[pid]) if "step" in t["shared"]]
        written[pid] = [r for r, _ in steps], [0, *(s for _, s in steps)]
    told = min((max((t["round"] for t in rounds(lines[p])), default=0) for p in lines), default=0)
    reads, wrong = 0, []
    for pid in lines:
        for t in rounds(lines[pid]):
            if "read" not in t["shared"] or t["round"] > told + 1:
                continue
            for other, (at, values) in written.items():
                if other != pid:
                    reads += 1
                    expected = values[bisect_left(at, t["round"])]
                    if t["shared"]["read"][other] != expected:
                        text = f"round {t['round']}, robot {pid} read {t['shared']['read'][other]}"
                        wrong.append(f"{text} of robot {other} instead of {expected}")
    return reads, wrong


def is_current(t: Mapping[str, Any]) -> bool:
    """Whether the robot had the shared state of the round in time."""
    return not (t["skipped"] or "").startswith(NOT_CURRENT)


def current(lines: Lines, first: int, last: int) -> tuple[float, Counter[str]]:
    """The share of robot-rounds from `first` to `last` in which the robot was current, and why no event ran."""
    good, why = 0, Counter[str]()
    for pid in lines:
        told = {t["round"]: t for t in rounds(lines[pid])}
        for round_ in range(first, last + 1):
            t = told.get(round_, {"skipped": "no record"})
            good += is_current(t)
            if t["skipped"]:
                why[t["skipped"].partition(":")[0]] += 1
    return good / (len(lines) * (last - first + 1)), why
