"""Tracking error of the car's controller, with PyBullet's racecar: `python benchmarks/car_tracking.py`.

Slalom: arcs of 1 m radius, alternately to the left and to the right, at 1.5 m/s; measured is the distance of the middle
of the true rear axle from the path, at 240 Hz. Parking: Reeds-Shepp curves to one pose from seeded starts around it;
measured is the final true pose. `fixtures/racecar.py` drives the car. Exit status 1: a target was missed.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import asdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.fixtures.racecar import parked, slalom
from benchmarks.fixtures.slalom import PACE, RADIUS

STARTS = 20
WANTED_RMS, WANTED_PLACE, WANTED_HEADING = 0.05, 0.10, 0.15  # m, m, rad


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help="fewer arcs and starts")
    parser.add_argument("--json", metavar="FILE", help="write the figures there, too")
    arguments = parser.parse_args()
    began = time.perf_counter()
    winding = slalom(4 if arguments.quick else 12)
    starts = [parked(seed) for seed in range(4 if arguments.quick else STARTS)]
    good = [p for p in starts if p.finished and p.away <= WANTED_PLACE and p.turned <= WANTED_HEADING]
    print(f"slalom, radius {RADIUS:g} m at {PACE:g} m/s: RMS {1e3 * winding.rms:.1f} mm, largest "
          f"{1e3 * winding.largest:.1f} mm, median speed {winding.median_speed:.2f} m/s"
          f" (wanted: RMS {1e3 * WANTED_RMS:.0f} mm)")  # fmt: skip
    print(f"parking: {len(good)} of {len(starts)} within {WANTED_PLACE:g} m and {WANTED_HEADING:g} rad; largest "
          f"{1e3 * max(p.away for p in starts):.0f} mm, {max(p.turned for p in starts):.3f} rad; "
          f"{sum(p.gear_changes for p in starts)} changes of gear")  # fmt: skip
    print(f"{time.perf_counter() - began:.0f} s")
    if arguments.json:
        figures = {"slalom": asdict(winding), "parking": [asdict(p) for p in starts]}
        Path(arguments.json).write_text(json.dumps(figures, indent=1) + "\n")
    sound = winding.finished and winding.rms <= WANTED_RMS and winding.median_speed >= 0.95 * PACE
    return 0 if sound and len(good) == len(starts) else 1


if __name__ == "__main__":
    sys.exit(main())
