"""Shares of a run's processor time."""

from __future__ import annotations

from time import perf_counter


class TimeShares:
    """Seconds by part. Devices are also counted within `stage`; network and trace also within `agents`."""

    def __init__(self) -> None:
        self._spent: dict[str, float] = {}

    def begin(self) -> float:
        return perf_counter()

    def end(self, part: str, began: float) -> None:
        self._spent[part] = self._spent.get(part, 0.0) + perf_counter() - began

    def fractions(self, devices: float) -> dict[str, float]:
        """Return each part's share of the whole; `devices` are the seconds that the scene spent on devices."""
        spent = self._spent.get
        stage, agents = spent("stage", 0.0), spent("agents", 0.0)
        network, trace = spent("network", 0.0), spent("trace", 0.0)
        parts = {
            "physics": stage - devices,
            "devices": devices,
            "agents": agents - network - trace,
            "network": network,
            "trace": trace,
        }
        whole = sum(parts.values()) or 1.0
        return {part: round(seconds / whole, 4) for part, seconds in parts.items()}
