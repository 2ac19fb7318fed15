"""Names of the reasons for which a robot skips a round: the same in logs, traces, --status, summaries and reports.

A reason is a name, or `NAME: detail`. docs/cli.md lists the names (a test compares); `koordgen explain skip` too.
"""

from __future__ import annotations

NO_EVENT = "no event enabled"
FAULT = "fault"
STOPPED = "stopped"
NOT_CURRENT = "not current"
NOT_CONFIRMED = "not confirmed"
WOKE_LATE = "woke after the publish deadline"
NO_SENSOR_VALUE = "no sensor value"
NO_POSITION = "no position"
LOST_CONTENTION = "lost contention"
NOT_COUNTED = "not counted"
LEFT = "left the mission"

NAMES = (
    NO_EVENT, NOT_CURRENT, NOT_CONFIRMED, LOST_CONTENTION, FAULT, WOKE_LATE, NO_SENSOR_VALUE, NO_POSITION, STOPPED,
    NOT_COUNTED, LEFT,
)  # fmt: skip


def name_of(reason: str) -> str:
    """Return the name of a reason, without its detail."""
    return reason.partition(":")[0]
