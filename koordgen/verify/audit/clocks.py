"""Clock check: compares the clocks of robots with the times at which their rounds should begin."""

from __future__ import annotations

from koordgen.verify.audit.history import FleetMission

SLACK = 0.05  # seconds by which a round may begin late or early, in addition to the error bound that a clock reports
DRIFT = 1e-3  # allowed drift of a clock in seconds per second: twice the drift between two clocks


def notes(mission: FleetMission) -> list[str]:
    """Return notes about robots whose clocks disagree with the times of their rounds.

    The audit computes times from the numbers of rounds. A robot's clock only decides when the robot's rounds begin."""
    found = []
    delta = mission.delta
    for history in mission.histories:
        for life in history.lives:
            rounds = [line.record for line in life.lines if line.record["kind"] == "round"]
            if not rounds:
                continue
            ticks = [
                (
                    r["round"],
                    float(r.get("time", r.get("t", 0.0))) - float(r.get("late", 0.0)) - (r["round"] - 1) * delta,
                )
                for r in rounds
            ]
            bound = max(float(r.get("clock_bound", 0.0) or 0.0) for r in rounds)  # null: not known
            (first, origin), *_ = ticks
            off, when = max((abs(tick - origin) - DRIFT * delta * abs(r - first), r) for r, tick in ticks)
            if off > SLACK + 2 * bound:
                found.append(
                    f"{history.name}'s clock and its rounds differ by {off:.2f} s in round {when}: "
                    "the audit uses the times of the rounds"
                )
            if bound > delta / 2:
                found.append(
                    f"{history.name} knew the fleet's time only to within {bound:.2f} s: "
                    "its sensor samples may belong to other rounds"
                )
    return found
