"""Small programs whose invariants are known to be provable, or not to be: a wrong generator tells otherwise."""

from __future__ import annotations

MOTION = """
using Motion:
  sensors:
    Point position
    bool reached
  actuators: Point target
"""
LEVEL = """
using Dev:
  sensors: int level
  assume {assume}
initially: forall i in ID: Dev.level[i] == 1
"""

# name -> (text, the invariants that are proved, with "(well-defined)" where there is such an obligation and it holds)
BATTERY: dict[str, tuple[str, set[str]]] = {
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
    "indices": (
        """
allread: int x[N_SYS]
local: int a
First:
  pre: pid > 0
  eff: x[pid] = max(x[pid - 1], 0)
invariant Sign: forall i in ID: x[i] >= 0
""",
        {"Sign", "(well-defined)"},
    ),
    "indices that leave": (
        """
allread: int x[N_SYS]
local: int a
First:
  pre: a < N_SYS
  eff: x[pid] = x[a]
Second:
  pre: a == 0
  eff: x[pid] = 7 // a
invariant Zero: forall i in ID: x[i] == 0
invariant Start: forall i in ID: a[i] == 0
""",
        {"Zero", "Start"},
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
    "searching": (
        """
allread: bool busy[N_SYS]
local: bool go
fun free(bool all[N_SYS], int me) -> bool:
  for i in range(len(all)):
    if i != me and all[i]:
      return False
  return True
Begin:
  pre: not go
  eff: atomic:
    if free(busy, pid):
      busy[pid] = True
      go = True
End:
  pre: go
  eff: atomic:
    busy[pid] = False
    go = False
invariant Told: forall i in ID: busy[i] == go[i]
invariant Alone: forall i, j in ID: i == j or not (busy[i] and busy[j])
invariant Idle: forall i in ID: not busy[i]
""",
        {"Told", "Alone", "(well-defined)"},
    ),
    "a loop that adds": (
        """
allread: int x[N_SYS]
local: int a
Add:
  pre: a >= 0
  eff:
    int total = 0
    for i in range(N_SYS):
      if i == pid: continue
      if x[i] > 100: break
      total += x[i]
      a = a + 1
    x[pid] = min(total, 0)
invariant Up: forall i in ID: a[i] >= 0
invariant Down: forall i in ID: x[i] <= 0
invariant Flat: forall i in ID: a[i] <= 3
""",
        {"Up", "Down", "(well-defined)"},
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
    "lists": (
        """
local:
  List<int> xs max 6
  int n
Grow:
  pre: n < 3
  eff:
    xs.append(n)
    n += 1
    if xs[n - 1] != n - 1:
      n = 99
Shrink:
  pre: n > 0 and len(xs) == n
  eff:
    xs.pop()
    n -= 1
invariant Long: forall i in ID: len(xs[i]) == n[i]
invariant Few: forall i in ID: 0 <= n[i] and n[i] <= 3
invariant None_: forall i in ID: n[i] == 0
""".replace("None_", "Never"),
        {"Long", "Few", "(well-defined)"},
    ),
    "sums": (
        """
allwrite: int total
allread:
  int given[N_SYS]
  bool done[N_SYS]
Add:
  pre: not done[pid]
  eff: atomic:
    total += pid - given[pid]
    given[pid] = pid
    done[pid] = True
invariant Sum: total == sum(given)
invariant Count: 0 <= done.count(True) and done.count(True) <= N_SYS
invariant Wrong: total <= 1
""",
        {"Sum", "Count"},
    ),
    "leaders": (
        """
extern fun best(List<int> bids) -> int:
  ensures: result >= 0
extern fun half(int x) -> int:
  requires: x >= 2
  ensures: 2 * result <= x and result >= 1
allread: int bid[N_SYS] = -1
local:
  int leader = -1
  int h = 1
Bid:
  pre: bid[pid] < 0
  eff: bid[pid] = pid
Elect:
  pre: leader < 0 and not -1 in bid
  eff: leader = best(bid)
Halve:
  pre: h >= 1
  eff: h = half(h + 1)
invariant Bidding: forall i in ID: bid[i] >= -1
invariant All: forall i, j in ID: leader[i] < 0 or bid[j] >= 0
invariant Best: forall i in ID: leader[i] < 0 or leader[i] == best(bid)
invariant One: forall i, j in ID: leader[i] < 0 or leader[j] < 0 or leader[i] == leader[j]
invariant Half: forall i in ID: h[i] >= 1
invariant Bidden: forall i in ID: bid[i] >= 0
""",
        {"Bidding", "All", "Best", "One", "Half", "(well-defined)"},
    ),
    "maps": (
        """
spec fun true_(GridMap m) -> bool
extern fun seen(int at) -> GridMap
axiom Empty: true_(GridMap(Point(0, 0, 0), Point(1, 1, 0), 0.5))
axiom Merged: not (true_(a) and true_(b)) or true_(merge(a, b))
axiom Seen: true_(seen(at))
allwrite: GridMap all = GridMap(Point(0, 0, 0), Point(1, 1, 0), 0.5)
local: GridMap own = GridMap(Point(0, 0, 0), Point(1, 1, 0), 0.5)
Look:
  pre: True
  eff:
    for k in range(N_SYS):
      own = merge(own, seen(k))
Give:
  pre: pid > 0
  eff: atomic: all = merge(all, own)
invariant Own: forall i in ID: true_(own[i])
invariant All: true_(all)
""".replace("true_", "honest"),
        {"Own", "All"},
    ),
    "apart": (
        """
param float eps = 1.0
fun clearOf(List<Point> paths[N_SYS], List<Point> path, int me) -> bool:
  for i in range(len(paths)):
    if i != me and path_distance(path, paths[i]) <= eps: return False
  return True
using Motion:
  sensors: Point position
  PathPlanner planner
  assume planner(goal) == [] or first(planner(goal)) == position
allread: List<Point> way[N_SYS] max 8
local:
  bool on
  Point begun
init: way[pid] = [Motion.position]
Go:
  pre: not on
  eff: atomic:
    List<Point> path = Motion.planner(Point(1, 2, 3))
    if len(path) > 0 and clearOf(way, path, pid):
      way[pid] = path
      begun = Motion.position
      on = True
End:
  pre: on and len(way[pid]) > 0
  eff: atomic:
    way[pid] = [last(way[pid])]
    on = False
initially: forall i, j in ID: i == j or distance(Motion.position[i], Motion.position[j]) > eps
invariant Apart: forall i, j in ID: i == j or path_distance(way[i], way[j]) > eps
invariant Farther: forall i, j in ID: i == j or path_distance(way[i], way[j]) > eps + 1
invariant Begun: forall i in ID: not on[i] or first(way[i]) == begun[i]
invariant Some: forall i in ID: len(way[i]) > 0
""",
        {"Apart", "Some", "Begun", "(well-defined)"},
    ),
    "numbers": (
        """
local:
  int a = 1
  int q
  int r
  float f
Turn:
  pre: True
  eff:
    a = (a + 1) % N_SYS
    q = -7 // 2 + abs(0 - 3) + min(1, 2) - max(1, 2)
    r = (r + 5) % 3
    f = abs(f) + floor(2.5) - 2
invariant Ring: forall i in ID: 0 <= a[i]
invariant Rest: forall i in ID: 0 <= r[i] and r[i] < 3
invariant Floor: forall i in ID: q[i] == 0 or q[i] == -2
invariant Sign: forall i in ID: f[i] >= 0
invariant Out: forall i in ID: a[i] < 1
""",
        {"Ring", "Rest", "Floor", "Sign", "(well-defined)"},
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
