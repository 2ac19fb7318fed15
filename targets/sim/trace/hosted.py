"""Parts of a squad's trace, of which each was written by one host of its agent.

A host may record rounds that are not committed when another host takes over, and a host that was cut off or frozen may
record rounds long after that. Only the records of the later host count."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise


def replaced_from(parts: Sequence[tuple[float, float]]) -> list[float]:
    """Return for each part the first round that a later host recorded; inf if there is none.

    parts: first and last round of each part. A later host begins with a later round."""
    order = sorted(range(len(parts)), key=lambda part: parts[part])
    found = [math.inf] * len(parts)
    for earlier, later in pairwise(order):
        found[earlier] = parts[later][0]
    return found
