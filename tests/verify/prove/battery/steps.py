"""Programs about steps: rounds, events, init, actuators, the environment."""

from __future__ import annotations

LEVEL = """
using Dev:
  sensors: int level
  assume {assume}
initially: forall i in ID: Dev.level[i] == 1
"""

# name -> (text, the invariants that are proved, with "(well-defined)" where there is such an obligation and it holds)
STEPS: dict[str, tuple[str, set[str]]] = {
    "geofence": (
        """
param Point lo = Point(-1, -1, -1)
param Point hi = Point(1, 1, 1)
using Motion:
  sensors: Point position
  actuators: Point target
  assume position' in Rect(target, position)
allread: Point x[N_SYS]
init: x[pid] = Motion.position
Move:
  pre: not (pid == N_SYS - 1 or pid == 0)
  eff:
    Motion.target = (x[pid + 1] + x[pid - 1]) / 2
    x[pid] = Motion.position
initially: forall i in ID: Motion.position[i] in Rect(lo, hi)
invariant Fence:
  forall i in ID: Motion.position[i] in Rect(hi, lo) and x[i] in Rect(lo, hi) and Motion.target[i] in Rect(lo, hi)
invariant Shared: forall i in ID: x[i] in Rect(lo, hi)
""",
        {"Fence", "Shared", "(well-defined)"},
    ),
    "no bound on targets": (
        """
param Point lo = Point(-1, -1, -1)
param Point hi = Point(1, 1, 1)
using Motion:
  sensors: Point position
  actuators: Point target
  assume position' in Rect(position, target)
Move:
  pre: True
  eff: Motion.target = Motion.position
initially: forall i in ID: Motion.position[i] in Rect(lo, hi)
invariant Fence: forall i in ID: Motion.position[i] in Rect(lo, hi)
""",
        set(),
    ),
    "rising": (
        LEVEL.format(assume="level' >= level")
        + """
local: int seen = 1
Look:
  pre: Dev.level > seen
  eff: seen = Dev.level
invariant Least: forall i in ID: Dev.level[i] >= 1
invariant Most: forall i in ID: Dev.level[i] <= 1
invariant Seen: forall i in ID: seen[i] <= Dev.level[i]
invariant Alike: forall i, j in ID: Dev.level[i] == Dev.level[j]
""",
        {"Least", "Seen"},
    ),
    "mutual exclusion": (
        """
allwrite: int holder = -1
local: bool inside
Enter:
  pre: holder == -1 and not inside
  eff: atomic:
    holder = pid
    inside = True
Leave:
  pre: inside
  eff: atomic:
    inside = False
    holder = -1
invariant Holder: forall i in ID: not inside[i] or holder == i
invariant Alone: forall i, j in ID: i == j or not (inside[i] and inside[j])
invariant Never: forall i in ID: not inside[i]
""",
        {"Holder", "Alone"},
    ),
    "exclusion with stale copies": (
        """
allwrite: int holder = -1
local: bool inside
Enter:
  pre: holder == -1 and not inside
  eff:
    holder = pid
    inside = True
invariant Holder: forall i in ID: not inside[i] or holder == i
invariant Alone: forall i, j in ID: i == j or not (inside[i] and inside[j])
""",
        set(),
    ),
    "frame": (
        """
allread: int x[N_SYS]
local:
  int a
  bool b
Step:
  pre: a < 5
  eff:
    a += 1
    if a == 5:
      b = True
      stop
    x[pid] = 0 - a
Rest:
  pre: b and a == 7
  eff: x[pid] = 1
invariant Small: forall i in ID: 0 <= a[i] and a[i] <= 5
invariant Smaller: forall i in ID: a[i] <= 4
invariant Five: forall i in ID: not b[i] or a[i] == 5
invariant Behind: forall i in ID: 0 - x[i] <= 4 and x[i] <= 0
invariant Even: forall i, j in ID: a[i] == a[j]
""",
        {"Small", "Five", "Behind"},
    ),
    "init": (
        """
using Dev:
  sensors: int level
  assume level' == level
allread: int x[N_SYS] = 3
allwrite:
  int last = -1
  int first = -1
local: int a
init:
  x[pid] = Dev.level
  last = pid
  if pid == 0:
    first = pid
  if Dev.level > 1:
    a = 1
Nothing:
  pre: a == 9
  eff: a = 8
initially: forall i in ID: Dev.level[i] >= 2
invariant Last: last == N_SYS - 1
invariant First: first == 0
invariant Wrong: last == 0
invariant Taken: forall i in ID: x[i] >= 2 and a[i] == 1
invariant Kept: forall i in ID: x[i] == 3
""",
        {"Last", "First", "Taken"},
    ),
    "init of others": (
        """
using Dev:
  sensors: int level
  assume level' == level
allwrite:
  int last = -1
  int second = -1
  int never = -1
  int seen = 5
local: int a
init:
  if pid > 0:
    last = pid
    seen = Dev.level
  if pid == 1:
    second = pid
  if pid < 0 or pid >= N_SYS:
    never = pid
Nothing:
  pre: a == 9
  eff: a = 8
initially: forall i in ID: Dev.level[i] >= 2
invariant Last: last == N_SYS - 1 or N_SYS == 1 and last == -1
invariant Second: second == 1 or N_SYS == 1 and second == -1
invariant Never: never == -1
invariant Seen: seen >= 2
invariant Five: N_SYS > 1 or seen == 5
invariant Some: last > 0
invariant First: last == 1 or N_SYS == 1
invariant All: second == 1
invariant Nobody: second == -1
invariant Kept: seen == 5
""",
        {"Last", "Second", "Never", "Seen", "Five"},
    ),
    "reached": (
        """
using Motion:
  sensors:
    Point position
    bool reached
  actuators: Point target
  assume not reached' or position' == target
local:
  Point goal
  int m
init: Motion.target = Point(3, 2, 1)
Go:
  pre: Motion.reached
  eff: Motion.target = Point(1, 2, 3)
Rest:
  pre: not Motion.reached
  eff:
    goal = Motion.target
    m = 0 if goal == Motion.position else 1
invariant Same: forall i in ID: m[i] == 0
invariant There: forall i in ID: not Motion.reached[i] or Motion.position[i] == Motion.target[i]
invariant Always: forall i in ID: Motion.reached[i]
""",
        {"There"},
    ),
    "others' parts": (
        """
allread: bool up[N_SYS]
allwrite: int level
Raise:
  pre: exists i in ID: True
  eff: up[pid] = True
""".replace("exists i in ID: True", "not up[pid]")
        + """
Drop:
  pre: up[pid]
  eff: atomic:
    up[pid] = False
    level = level + 1
invariant Positive: level >= 0 and (forall i in ID: up[i] or level >= 0)
invariant Some: exists i in ID: not up[i] or level >= 0
invariant None_: forall i in ID: (exists j in ID: up[j]) or not up[i]
invariant Every: (forall i in ID: up[i]) or (exists i in ID: not up[i])
invariant Down: exists i in ID: not up[i]
""".replace("None_", "Itself"),
        {"Positive", "Some", "Itself", "Every"},
    ),
    "flipping": (
        LEVEL.format(assume="level' == 1 - level")
        + """
local: int a
Nothing:
  pre: a > 0
  eff: a = 0
invariant Alike: forall i, j in ID: Dev.level[i] == Dev.level[j]
invariant One: forall i in ID: Dev.level[i] == 1
""",
        {"Alike"},
    ),
    "neighbours": (
        """
allread: int x[N_SYS]
Lower:
  pre: pid > 0
  eff: x[pid] = x[pid] - 1
invariant Falling: forall i in ID: i == 0 or x[i] <= x[i - 1]
invariant Below: forall i in ID: x[i] <= 0
""",
        {"Below"},
    ),
    "actuators": (
        """
using Heat:
  sensors: bool cold
  actuators:
    bool on
    int power
Warm:
  pre: Heat.cold and Heat.power < 3
  eff:
    Heat.power = Heat.power + 1
    Heat.on = Heat.power > 1
invariant On: forall i in ID: not Heat.on[i] or Heat.power[i] > 1
invariant Power: forall i in ID: 0 <= Heat.power[i] and Heat.power[i] <= 3
invariant Off: forall i in ID: not Heat.on[i]
""",
        {"On", "Power"},
    ),
    "contradiction": (
        LEVEL.format(assume="level' > level and level' < level")
        + """
local: int a
Begin:
  pre: True
  eff: a = 1
invariant Any: forall i in ID: Dev.level[i] == 1
""",
        {"Any", "vacuous"},
    ),
}
