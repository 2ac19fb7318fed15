"""Parts of a squad's trace: each host of the squad's agent writes one part.

A host may record rounds that are not committed when another robot becomes the host. A host that was cut off or frozen
may record rounds long after that. Of a round that several hosts recorded, only the record of the last host counts."""

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
