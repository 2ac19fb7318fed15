"""How long an event takes: evenly between nothing and the environment's KOORDGEN_CHAOS_PAUSE seconds."""

import os
import random
import time


def pause(step: int) -> int:
    time.sleep(random.uniform(0.0, float(os.environ.get("KOORDGEN_CHAOS_PAUSE", "0"))))
    return 1
