"""Programs about values: indices, loops, lists, maps, sums, numbers."""

from __future__ import annotations

# name -> (text, the invariants that are proved, with "(well-defined)" where there is such an obligation and it holds)
VALUES: dict[str, tuple[str, set[str]]] = {
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
}
