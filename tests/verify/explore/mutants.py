"""Examples with one mistake each: a lost update, a missing `not`, a stale value."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from koordgen.verify.explore.search import DEADLOCK

EXAMPLES = Path(__file__).parents[3] / "examples"


class Mutant(NamedTuple):
    """`old` occurs once in the example. `caught`: what finds it after `rounds`, any of several that are broken then.
    `also`: an invariant that the example keeps when explored, and that is not proved."""

    name: str
    program: str
    old: str
    new: str
    caught: str
    rounds: int
    env: str = "explore"
    also: str = ""


PLAIN = "  eff: atomic:\n", "  eff:\n"
HANDED_IN = "invariant HandedIn: forall i in ID: onPath[i] or merge(map, localMap[i]) == map\n"

MUTANTS = (
    Mutant("hello: missing not", "hello/hello", "pre: not sent", "pre: sent", DEADLOCK, 0),
    Mutant("sum: lost update", "atomicsum/atomicsum", *PLAIN, "Counted", 1),
    Mutant("sum: missing not", "atomicsum/atomicsum", "pre: not done[pid]", "pre: done[pid]", DEADLOCK, 0),
    Mutant(
        "sum: stale total",
        "atomicsum/atomicsum",
        """Add:
  pre: not done[pid]
  eff: atomic:
    total += pid + 1
""",
        """local: int seen = -1

See:
  pre: seen < 0
  eff: seen = total

Add:
  pre: not done[pid] and seen >= 0
  eff: atomic:
    total = seen + pid + 1
""",
        "NothingLost",
        2,
    ),
    Mutant(
        "mutex: lost update",
        "atomicsum/mutex",
        "  eff: atomic:\n    holder = pid",
        "  eff:\n    holder = pid",
        "Holder",
        1,
    ),
    Mutant(
        "mutex: missing not", "atomicsum/mutex", "holder == -1 and not inside", "holder == -1 and inside", DEADLOCK, 0
    ),
    Mutant(
        "mutex: stale holder",
        "atomicsum/mutex",
        """Enter:
  pre: holder == -1 and not inside
  eff: atomic:
""",
        """local: bool open

See:
  pre: holder == -1 and not inside
  eff: open = True

Enter:
  pre: open and not inside
  eff: atomic:
    open = False
""",
        "Holder",
        2,
    ),
    Mutant(
        "crossing: lost update",
        "crossing/crossing",
        "  eff: atomic:\n    holder = pid",
        "  eff:\n    holder = pid",
        "MutualExclusion",
        1,
    ),
    Mutant("crossing: missing not", "crossing/crossing", "not across and pid", "across and pid", DEADLOCK, 0),
    Mutant(
        "crossing: stale arrival",
        "crossing/crossing",
        """Leave:
  pre: inside and Motion.reached
  eff: atomic:
""",
        """local: bool there

See:
  pre: not inside and Motion.reached
  eff: there = True

Leave:
  pre: inside and there
  eff: atomic:
    there = False
""",
        "Clear, Waiting",
        3,
    ),
    Mutant(
        "delivery: a parcel taken twice",
        "delivery/delivery",
        "Take:\n  pre: leg == 0 and len(waiting) > 0\n  eff: atomic:",
        "Take:\n  pre: leg == 0 and len(waiting) > 0\n  eff:",
        "Separation",
        1,
    ),
    Mutant(
        "delivery: a delivery lost",
        "delivery/delivery",
        "  eff: atomic:\n    delivered_by",
        "  eff:\n    delivered_by",
        DEADLOCK,
        4,
    ),
    Mutant(
        "delivery: stale home",
        "delivery/delivery",
        "  eff: atomic:\n    way[pid] = [home]",
        "  eff: atomic:\n    way[pid] = [parcel.door]",
        "Homes",
        4,
    ),
    Mutant("election: missing not", "election/election", "not -1 in bid", "-1 in bid", "Everyone", 1),
    Mutant(
        "election: stale bids",
        "election/election",
        """Elect:  # when all have bid
  pre: leader < 0 and not -1 in bid
  eff:
    leader = best(bid)
""",
        """local: int found = -1

Find:
  pre: found < 0 and bid[pid] >= 0
  eff: found = best(bid)

Elect:
  pre: leader < 0 and found >= 0 and not -1 in bid
  eff:
    leader = found
""",
        "Best",
        3,
    ),
    Mutant(
        "follow: stale route",
        "follow/follow",
        """priority:
  Lead:
    pre: pid == 0 and not begun
    eff:
      Motion.path = route
""",
        """local: List<Point> way

priority:
  Lead:
    pre: pid == 0 and not begun
    eff:
      Motion.path = way
      way = route
""",
        "Route",
        1,
    ),
    Mutant("formation: missing not", "formation/formation", "not False in there", "False in there", "Together", 1),
    Mutant(
        "hvac: stale temperature",
        "hvac/hvac",
        "  pre: HVAC.temp > wanted + band",
        "  pre: temps[pid] > wanted + band",
        "Safe",
        2,
    ),
    Mutant(
        "lineform: stale target",
        "lineform/geofence",
        """TargetUpdate:
  pre: not (pid == N_SYS - 1 or pid == 0)
  eff:
    Motion.target =""",
        """local: Point aim = Point(9, 0, 0)

TargetUpdate:
  pre: not (pid == N_SYS - 1 or pid == 0)
  eff:
    Motion.target = aim
    aim =""",
        "Geofence",
        1,
    ),
    Mutant(
        "mapping: lost update",
        "mapping/mapping",
        "  eff: atomic:\n    map =",
        "  eff:\n    map =",
        "HandedIn",
        2,
        also=HANDED_IN,
    ),
    Mutant("mapping: missing not", "mapping/mapping", "pre: not looked and", "pre: looked and", DEADLOCK, 0),
    Mutant("patrol: missing not", "patrol/patrol", "if not taken(", "if taken(", "Apart", 2),
    Mutant(
        "patrol: stale legs",
        "patrol/patrol",
        """Next:
  pre: begun and Motion.reached and len(route) > 0
  eff:
    int following = (leg[pid] + 1) % len(route)
    if not taken(leg, pid, following):
""",
        """local: bool free = True

Next:
  pre: begun and Motion.reached and len(route) > 0
  eff:
    int following = (leg[pid] + 1) % len(route)
    bool seen = free
    free = not taken(leg, pid, following)
    if seen:
""",
        "Apart",
        2,
    ),
    Mutant("rendezvous: missing not", "rendezvous/rendezvous", "not here[pid]", "here[pid]", DEADLOCK, 1),
    Mutant("task: lost update", "task/task", "  eff: atomic:\n    for t in", "  eff:\n    for t in", "Paths", 1),
    Mutant(
        "task: missing not",
        "task/task",
        "pre: not on_task and not stuck[pid]",
        "pre: on_task and not stuck[pid]",
        DEADLOCK,
        0,
    ),
    Mutant(
        "task: stale place",
        "task/task",
        "shared_paths[pid] = [cur_task.target]",
        "shared_paths[pid] = [curr_path[0]]",
        "Shared",
        2,
    ),
    Mutant("once: lost update", "task/once", "else: atomic:", "else:", "Once", 1, env="explore_once"),
    Mutant(
        "separation: lost update", "task/separation", "else: atomic:", "else:", "Clear", 1, env="explore_separation"
    ),
)
