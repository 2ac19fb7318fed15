"""Whether robots kept the time that their rounds say."""

from __future__ import annotations

from koordgen.verify.audit.story import Mission

SLACK = 0.05  # s a round may be off by, beyond what the clocks say of themselves
DRIFT = 1e-3  # s a second: twice what two clocks may drift apart


def notes(mission: Mission) -> list[str]:
    """Rounds are the fleet's time; a robot's own clock only tells when it decided them. Where the two do not go
    together, that is said."""
    found = []
    delta = mission.delta
    for story in mission.stories:
        for life in story.lives:
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
            bound = max(float(r.get("clock_bound", 0.0)) for r in rounds)
            (first, origin), *_ = ticks
            off, when = max((abs(tick - origin) - DRIFT * delta * abs(r - first), r) for r, tick in ticks)
            if off > SLACK + 2 * bound:
                found.append(
                    f"{story.name}'s clock and its rounds are {off:.2f} s apart in round {when}: "
                    "seconds told here are those of rounds"
                )
            if bound > delta / 2:
                found.append(
                    f"{story.name} knew the fleet's time only to {bound:.2f} s: its samples are of other moments"
                )
    return found
