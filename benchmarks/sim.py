"""Speed of the simulated world: `python benchmarks/sim.py [--quick] [--json FILE] [--gym-pybullet-drones PATH]`.

Measured first is the physics alone: a step of 25 robots beside other simulators with as many; a lidar's turn beside
PyBullet's; the factor to real time at 1, 4, 16 and 64 robots. Then whole runs in lockstep, with agents. Peers that are
not installed are left out, and the output says so. All times are CPU time of this process: other load on the computer
counts little, and on an idle one it is the wall-clock time. Exit status 1: a target was missed.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks import sim_lockstep, sim_physics

COUNTS = (1, 4, 16, 64)
MOST_HARNESS = 0.6  # share of a core


def _physics(turns: int, drones: Path | None) -> tuple[bool, dict[str, object]]:
    pairs, left = sim_physics.peers(25, turns, drones)
    seen = sim_physics.lidars(25, turns)
    print("physics alone, 25 robots at 240 Hz: milliseconds of CPU a step")
    good = True
    for pair in (*pairs, seen.pair):
        enough = pair.ratio >= pair.least
        good = good and enough
        print(
            f"  {pair.name:18} {pair.ours:8.4f}   {pair.other:20} {pair.theirs:8.4f}   "
            f"{pair.ratio:6.1f} times as fast (at least {pair.least:g}){'' if enough else '  MISSED'}"
        )
    for what in left:
        print(f"  left out: {what}")
    print(f"  one lidar's turn alone   {seen.single:.4f}")
    print(f"  lidar from plane geometry: {seen.geometry * 1e3:.6f} mm at most")
    print("  rayTestBatch within 1 mm of that, over 10 degrees from tangent: ", end="")
    print(f"{seen.faces:.1%} of rays at faces, {seen.round:.1%} at round things")
    good = good and seen.geometry < sim_physics.MILLIMETRE and seen.faces > 0.99
    found = {"pairs": [{**asdict(p), "ratio": p.ratio} for p in pairs], "left_out": left, "lidar": asdict(seen)}
    return good, found


def _factors(turns: int) -> dict[str, object]:
    found = sim_physics.factors(COUNTS, turns)
    print("physics alone, times real time" + "".join(f"{count:>10}" for count in COUNTS) + " robots")
    for name, by_count in found.items():
        print(f"  {name:28}" + "".join(f"{by_count[count]:10.1f}" for count in COUNTS))
    return {name: {str(k): v for k, v in by_count.items()} for name, by_count in found.items()}


def _lockstep(quick: bool) -> tuple[bool, dict[str, object]]:
    """Measure quads that fly LineForm in lockstep."""
    print("lockstep, agents included: simulated seconds by seconds of CPU, and what these went to")
    good, found = True, dict[str, object]()
    for fidelity, least in (("simple", 8.0), ("full", 2.0)):
        for count in COUNTS[:3] if quick else COUNTS:
            _tell_mission(found, count, fidelity, 2.0 if count > 16 else 5.0)
        eight = _tell_mission(found, 8, fidelity, 10.0 if quick else 30.0)
        enough = eight.factor >= least
        good = good and enough
        print(f"    8 quads at {fidelity}: at least {least:g} times real time{'' if enough else '  MISSED'}")
    harness = sim_lockstep.mission(16, "quad", "full", 5.0).harness
    enough = harness <= MOST_HARNESS
    print(f"  16 quads at full, in real time: world and autopilots need {harness:.0%} of a core")
    print(f"    at most {MOST_HARNESS:.0%}{'' if enough else '  MISSED'}")
    return good and enough, {**found, "harness of 16 quads": harness}


def _tell_mission(found: dict[str, object], count: int, fidelity: str, seconds: float) -> sim_lockstep.Mission:
    mission = sim_lockstep.mission(count, "quad", fidelity, seconds)
    shares = ", ".join(f"{part} {share:.0%}" for part, share in mission.shares.items())
    print(f"  {count:3} quads, {fidelity:7} {mission.factor:8.2f}   {shares}", flush=True)
    found[f"{count} quads, {fidelity}"] = {**asdict(mission), "factor": mission.factor}
    return mission


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help="fewer turns: under a minute")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there, too")
    parser.add_argument("--gym-pybullet-drones", type=Path, metavar="PATH", help="a checkout of it, to measure beside")
    options = parser.parse_args()
    turns = 7 if options.quick else 25
    good, physics = _physics(turns, options.gym_pybullet_drones)
    figures: dict[str, object] = {"physics": physics, "factors": _factors(turns)}
    held, figures["lockstep"] = _lockstep(options.quick)
    if options.json is not None:
        options.json.write_text(json.dumps(figures, indent=2) + "\n")
    return 0 if good and held else 1


if __name__ == "__main__":
    raise SystemExit(main())
