"""Programs that reveal mutants of the prover. Each is small: an everyday test runs some of them."""

from __future__ import annotations

from tests.verify.prove.battery.battery import BATTERY
from tests.verify.prove.test_soundness import BROKEN

LOOP = """
local:
  List<int> xs = {xs}
  bool bad
Go:
  pre: not bad
  eff:
    int k = 0
    {first}
    for x in xs:
      {turn}
    if {wrong}: bad = True
invariant Never: forall i in ID: not bad[i]
"""

LEAST = """
allread:
  int x[N_SYS]
  bool ok[N_SYS]
local: bool bad
Go:
  pre: not bad
  eff:
    int k = 10
    for i in ID:
      {turn}
    if k > x[pid]: bad = True
invariant Never: forall i in ID: not bad[i]
"""
VALUE = """
local:
  {given}
  bool bad
Go:
  pre: {pre}
  eff:
    {first}
    if {wrong}: bad = True
invariant Given: {known}
invariant Never: forall i in ID: not bad[i]
"""

# A mutant proves of each what a run breaks.
WRONG: dict[str, str] = {
    "a fleet that is commanded": """
provides Motion:
  actuators: int target = goal
allwrite: int goal
local: int seen
Go:
  pre: goal != seen
  eff: seen = goal
invariant Still: goal == 0
invariant Same: forall i in ID: seen[i] == 0
""",
    "a conjunction": """
local:
  int a
  int b
Go:
  pre: True
  eff: b += 1
invariant Both: forall i in ID: a[i] >= 0 and b[i] <= 0
""",
    "another robot's `reached`": """
using Motion:
  sensors:
    Point position
    bool reached
  actuators: Point target
  assume reached' == reached
allread: bool up[N_SYS] = True
allwrite: bool seen
Go:
  pre: pid == 0 and up[pid] and not seen
  eff: atomic:
    Motion.target = Point(1, 2, 3)
    up[pid] = False
Look:
  pre: up[0]
  eff: seen = True
invariant Up: forall i in ID: up[i] == Motion.reached[i]
invariant Seen: not seen or Motion.reached[0]
""",
    "a command": """
using Motion:
  sensors:
    Point position
    bool reached
  actuators: Point target
  assume reached' == reached
Go:
  pre: True
  eff: Motion.target = Point(1, 2, 3)
invariant Reached: forall i in ID: Motion.reached[i]
""",
    "an invariant that rests on a false one": """
local:
  int a
  int b
Go:
  pre: True
  eff:
    b = a
    a = a + 1
invariant False_: forall i in ID: a[i] == 0
invariant Rests: forall i in ID: b[i] == 0
""".replace("False_", "Wrong"),
    "a contract behind a division": """
extern fun half(int x) -> int:
  ensures: x > 0
local:
  int n
  int m
Go:
  pre: True
  eff: m = 7 // n + half(n)
invariant Any: forall i in ID: m[i] == m[i]
""",
    "an init that fails": """
local:
  List<int> xs
  int n = 1
  bool b
init: b = xs[0] == 1
Go:
  pre: n > 0
  eff: n = 7 // n
""",
    "two divisions": """
local:
  int n = 1
  int m
Go:
  pre: n > 0
  eff: m = 7 // n + 7 // m
""",
    "an allread variable as a whole": """
allread: int x[N_SYS]
local: bool seen
Go:
  pre: not 5 in x and not seen
  eff:
    x[pid] = 5
    seen = 5 in x
invariant Never: forall i in ID: not seen[i]
""",
    "a branch that reads": """
local:
  int a
  int b = 6
Go:
  pre: True
  eff:
    if pid == 0: a = 5
    else: b = a + 1
invariant Six: forall i in ID: b[i] == 6
""",
    "two branches": """
local: int a
Go:
  pre: True
  eff:
    if pid == 0: a = 1
    else: a = 2
invariant One: forall i in ID: a[i] <= 1
""",
    "stop": """
local:
  int a
  int b
Go:
  pre: True
  eff:
    if b == 0:
      a = 7
      stop
    b = 1
invariant Zero: forall i in ID: a[i] == 0
""",
    "break": """
local: int a
Go:
  pre: True
  eff:
    for k in range(3):
      if k >= a:
        a = 7
        break
invariant Zero: forall i in ID: a[i] == 0
""",
    "continue": """
local:
  int a
  int n
Go:
  pre: True
  eff:
    for k in range(3):
      if k >= n:
        a = 7
        continue
      a = 0
invariant Zero: forall i in ID: a[i] == 0
""",
    "behind a continue": """
local:
  int n
  int a
Go:
  pre: True
  eff:
    for k in range(2):
      if n == 0: continue
    a = 1
invariant None_: forall i in ID: n[i] == 0
invariant Zero: forall i in ID: a[i] == 0
""".replace("None_", "No"),
    "a transaction after the round's start": """
allwrite:
  int level
  bool ok
allread: int x[N_SYS]
Up:
  pre: level == 0
  eff: atomic: level = 1
Take:
  pre: level == 1 and not ok
  eff: atomic: x[pid] = 1
Look:
  pre: level == 0
  eff: ok = True
invariant Level: level == 0 or level == 1
invariant Start: forall i in ID: level == 1 or x[i] == 0
invariant Ok: forall i in ID: not ok or x[i] == 0
""",
    "a function that divides": """
local:
  int n
  int m = 1
fun part(int x) -> int:
  return 7 // x
Go:
  pre: m > 0
  eff: n = part(n) + 6 // m
""",
    "two calls": """
local:
  int a
  int b
fun next(int x) -> int:
  return x + 1
Go:
  pre: True
  eff:
    a = next(1)
    b = next(5)
invariant Two: forall i in ID: b[i] <= 2
""",
    "two returns": """
local: int a
fun sign(int x) -> int:
  if x == 0: return 7
  return 0
Go:
  pre: True
  eff: a = sign(a)
invariant Zero: forall i in ID: a[i] == 0
""",
    "requires": """
extern fun half(int x) -> int:
  requires: x >= 2
local:
  int n
  int m = 1
Go:
  pre: m > 0
  eff: n = half(n) + 6 // m
""",
    "a contract on one branch": """
extern fun half(int x) -> int:
  ensures: x > 0
local:
  int n
  bool bad
Go:
  pre: True
  eff:
    if n > 0: n = half(n)
    else: bad = True
invariant Never: forall i in ID: not bad[i]
""",
    "a contract within a function": """
extern fun half(int x) -> int:
  ensures: x > 0
fun wrapped(int x) -> int:
  return half(x)
local:
  int n
  bool bad
Go:
  pre: True
  eff:
    if n > 0: n = wrapped(n)
    else: bad = True
invariant Never: forall i in ID: not bad[i]
""",
    "a plan for the next level": """
using Motion:
  sensors: int level
  PathPlanner planner
  assume planner(goal) == [] or level' == 0
initially: forall i in ID: Motion.level[i] == 1
local: bool bad
Go:
  pre: True
  eff:
    List<Point> path = Motion.planner(Point(1, 0, 0))
    if Motion.level != 0 and len(path) > 0: bad = True
invariant Never: forall i in ID: not bad[i]
""",
    "two plans": """
using Motion:
  sensors: Point position
  PathPlanner planner
local: bool differ
Go:
  pre: True
  eff:
    List<Point> a = Motion.planner(Point(1, 0, 0))
    List<Point> b = Motion.planner(Point(2, 0, 0))
    if len(a) != len(b): differ = True
invariant Never: forall i in ID: not differ[i]
""",
    "a plan on one branch": """
using Motion:
  sensors: int level
  PathPlanner planner
  assume level > 0 or planner(goal) == []
  assume len(planner(goal)) > 0
local:
  int n
  bool bad
Go:
  pre: True
  eff:
    if Motion.level > 0: n = len(Motion.planner(Point(1, 0, 0)))
    else: bad = True
invariant Never: forall i in ID: not bad[i]
""",
    "priority at the round's start": """
allwrite:
  int level
  bool ok
priority:
  First:
    pre: level == 0
    eff: level = 1
  Second:
    pre: True
    eff: atomic: ok = True
Drop:
  pre: level == 1 and not ok
  eff: atomic: level = 0
invariant Level: level == 0 or level == 1
invariant Ok: not ok or level == 1
""",
    "priority of the first": """
local: int a
priority:
  First:
    pre: True
    eff: a = 1
  Second:
    pre: True
    eff: a = 0
invariant Zero: forall i in ID: a[i] == 0
""",
    "the last of three": """
local: int a
Go:
  pre: True
  eff:
    for k in range(3): a = k
invariant One: forall i in ID: a[i] <= 1
""",
    "the first of three": """
local:
  int n
  int a = 2
Go:
  pre: True
  eff:
    for k in range(3):
      a = k
      if k >= n: break
invariant Zero: forall i in ID: n[i] == 0
invariant Two: forall i in ID: a[i] == 2
""",
    "a search for nothing": """
local:
  List<int> xs
  bool bad
fun has(List<int> ys, int wanted) -> bool:
  for y in ys:
    if y == wanted: return True
  return False
Go:
  pre: True
  eff:
    if not has(xs, 3): bad = True
invariant Never: forall i in ID: not bad[i]
""",
    "a search that fails": """
local:
  List<int> xs = [0, 7]
  bool b
Go:
  pre: True
  eff:
    for y in xs:
      if 7 // y == 1 and y > 5 and y < 5:
        b = True
        break
""",
    "a search past a zero": """
local:
  List<int> xs = [0, 7]
  int n = 1
  bool b
Go:
  pre: n > 0
  eff:
    n = 7 // n
    for y in xs:
      if 7 // y == 1 and y > 3:
        b = True
        break
""",
    "a search for the first": """
allread: bool up[N_SYS] = True
local: int a
init: a = pid
Go:
  pre: up[pid]
  eff:
    for k in ID:
      if up[k]:
        a = k
        break
invariant Last: forall i in ID: a[i] >= i
""",
    "a witness": """
allread: bool up[N_SYS]
local: bool bad
Up:
  pre: pid == 0 and N_SYS > 1 and not up[1]
  eff: up[pid] = True
Go:
  pre: up[0]
  eff: bad = True
invariant Some: exists i in ID: not up[i]
invariant Never: forall i in ID: not bad[i]
""",
    "an invariant that is false at entry": """
local: int a
Go:
  pre: True
  eff:
    a = 7
    int k = 0
    while k < 3:
      invariant a == 0
      k += 1
invariant Zero: forall i in ID: a[i] == 0
""",
    "an invariant that a turn breaks": """
local: int a
Go:
  pre: True
  eff:
    int k = 0
    while k < 3:
      invariant k <= 1
      k += 1
    a = k
invariant Zero: forall i in ID: a[i] == 0
""",
    "a loop that counts": """
local: int a
Go:
  pre: True
  eff:
    for k in range(N_SYS): a += 1
invariant Zero: forall i in ID: a[i] == 0
""",
    "written, then continued": """
local: int a
Go:
  pre: True
  eff:
    for k in range(3, N_SYS + 9):
      if k > 3: break
      a = 7
      if k == 3: continue
      break
invariant Zero: forall i in ID: a[i] == 0
""",
    "a loop on one branch": """
local:
  int n
  bool bad
Go:
  pre: True
  eff:
    if n > 0:
      int k = 0
      while k < 3:
        invariant n > 0
        k += 1
    else: bad = True
invariant Never: forall i in ID: not bad[i]
""",
    "a function with a false invariant": """
local:
  List<int> xs = [1, 2]
  int a
fun total(List<int> ys) -> int:
  int t = 0
  for y in ys:
    invariant t == 0
    t += y
  return t
Go:
  pre: True
  eff: a = total(xs)
invariant Zero: forall i in ID: a[i] == 0
""",
    "a function with an invariant of some arguments": """
local:
  int n = 20
  int a
fun upto(int x) -> int:
  int t = x
  while t < 9:
    invariant t <= 9
    t += 1
  return t
Go:
  pre: True
  eff: a = upto(n)
invariant Nine: forall i in ID: a[i] <= 9
""",
    "a loop behind a division": """
local:
  int n
  int m
Go:
  pre: True
  eff:
    m = 7 // n
    int k = 0
    while k < 3:
      invariant n != 0
      k += 1
""",
    "behind a loop": """
local: int a
Go:
  pre: True
  eff:
    int k = 0
    for i in range(N_SYS): k += i
    a = 1
invariant Zero: forall i in ID: a[i] == 0
""",
    "no turn": LOOP.format(xs="[]", first="pass", turn="k += 1", wrong="k == 0"),
    "a shared variable": """
allwrite: int level
Go:
  pre: True
  eff:
    for i in range(N_SYS): level += 1
invariant Zero: level == 0
""",
    "counted under a condition": LOOP.format(xs="[1, 2]", first="pass", turn="if x > 5: k += 1", wrong="k < len(xs)"),
    "counted behind a continue": LOOP.format(
        xs="[1, 2]", first="pass", turn="if x < 5: continue\n      k += 1", wrong="k < len(xs)"
    ),
    "up and down": LOOP.format(
        xs="[1, 2]", first="pass", turn="if x > 5: k += 1\n      else: k -= 1", wrong="k < 0"
    ),
    "two steps": LOOP.format(xs="[1, 2]", first="pass", turn="k += 1\n      k += 2", wrong="k > len(xs)"),
    "counting down": LOOP.format(xs="[1, 2]", first="pass", turn="k -= 1", wrong="k < 0"),
    "a condition that changes": LOOP.format(
        xs="[1, 2]", first="int j = 0", turn="if k > 0: j = 1\n      k += 1", wrong="j == 1"
    ),
    "nothing found": LOOP.format(xs="[1, 2]", first="k = -1", turn="if x > 5: k = x", wrong="k == -1"),
    "the turn before": LOOP.format(xs="[1, 2]", first="int j = 0", turn="k = j\n      j = 5", wrong="k == 5"),
    "two values": LOOP.format(xs="[1, 2]", first="pass", turn="k = 1\n      k = 2", wrong="k == 2"),
    "one of two variables": LOOP.format(
        xs="[7]", first="int j = 0", turn="j = 1\n      if x > 5: continue\n      k = 1", wrong="j != k"
    ),
    "the least but one": LEAST.format(turn="if ok[i]:\n        if x[i] < k: k = x[i]"),
    "the least of those not skipped": LEAST.format(turn="if not ok[i]: continue\n      if x[i] < k: k = x[i]"),
    "the least so far": LEAST.format(turn="if k > x[i]: bad = True\n      if x[i] < k: k = x[i]"),
    "the least": LOOP.format(xs="[3]", first="k = 10", turn="k = min(k, x)", wrong="k < 10"),
    "a while that ends": """
local:
  int n = 3
  bool bad
Go:
  pre: True
  eff:
    int k = 0
    while k < n: k += 1
    if k > 0: bad = True
invariant Never: forall i in ID: not bad[i]
""",
    "every second": """
allread: bool up[N_SYS]
local: bool bad
init: up[pid] = pid != 1
Go:
  pre: True
  eff:
    int k = 0
    while k < N_SYS and up[k]: k += 2
    if k > pid and not up[pid]: bad = True
invariant Never: forall i in ID: not bad[i]
""",
    "the first that is not": """
local:
  List<int> xs = [0, 1, 0]
  bool bad
Go:
  pre: True
  eff:
    int k = 0
    while k < len(xs) and xs[k] == 0: k += 1
    if k < len(xs) and xs[k] == 1: bad = True
invariant Never: forall i in ID: not bad[i]
""",
    "a guard": VALUE.format(given="bool go = True", pre="go", first="pass", wrong="go", known="True"),
    "a shorter list": VALUE.format(
        given="List<int> xs = [1, 2]", pre="len(xs) == 2", first="xs.pop()", wrong="len(xs) < 2", known="True"
    ),
    "two points": VALUE.format(
        given="Point p", pre="True", first="p = Point(1, 2, 3)", wrong="p != Point(0, 0, 0)", known="True"
    ),
    "two paths": VALUE.format(
        given="List<Point> way = [Point(0, 0, 0)]", pre="True", first="pass",
        wrong="path_distance(way, [Point(0, 0, 0)]) < 1", known="True",
    ),
    "a remainder": VALUE.format(
        given="int n = 2", pre="True", first="pass", wrong="(n + 1) % 3 == 0", known="forall i in ID: n[i] == 2"
    ),
    "a quotient": VALUE.format(
        given="int n = 2", pre="True", first="pass", wrong="n // 2 == 1", known="forall i in ID: n[i] == 2"
    ),
    "a product": VALUE.format(
        given="int n = 3", pre="True", first="pass", wrong="n * n == 9", known="forall i in ID: n[i] == 3"
    ),
    "an actuator at the start": """
using Heat:
  actuators: bool on
local: int a
Go:
  pre: a == 1
  eff: a = 2
invariant On: forall i in ID: Heat.on[i]
""",
    "a sum": """
allread: int x[N_SYS]
Go:
  pre: True
  eff: x[pid] = 5
invariant Sum: sum(x) == 0
""",
}  # fmt: skip

# What is proved of each, and a mutant proves less of it, or sees no contradiction.
LESS: dict[str, tuple[str, set[str]]] = {
    "a fleet before its first command": (
        """
provides Motion:
  actuators: int target = goal
allwrite:
  int goal
  bool begun
Go:
  pre: not begun
  eff: atomic: begun = True
invariant Any: goal <= 0 or goal >= 0
invariant First: begun or not begun or goal == 0
""",
        {"Any", "First"},
    ),
    "an init that ended": (
        """
param int n = 1
allread: int x[N_SYS] = 5
init: x[pid] = 7 // n
Go:
  pre: x[pid] > 9
  eff: x[pid] = 5
invariant Some: forall i in ID: n != 0 or x[i] == 5
""",
        {"Some"},
    ),
    "contradicting plans": (
        """
using Motion:
  sensors: Point position
  PathPlanner planner
  assume planner(goal) == []
  assume len(planner(goal)) > 0
local: int a
Go:
  pre: a < 1
  eff: a = 1
invariant One: forall i in ID: a[i] <= 1
""",
        {"One", "vacuous"},
    ),
    "contradicting axioms": (
        """
spec fun good(int x) -> bool
axiom Yes: good(x)
axiom No: not good(x)
local: int a
Go:
  pre: a < 1
  eff: a = 1
invariant One: forall i in ID: a[i] <= 1
""",
        {"One", "vacuous"},
    ),
    "a contradicting contract": (
        """
extern fun half(int x) -> int:
  ensures: result > x and result < x
local: int a
Go:
  pre: a < 1
  eff: a = 1
invariant One: forall i in ID: a[i] <= 1
""",
        {"One", "vacuous"},
    ),
    "a contract that contradicts itself for one argument": (
        """
extern fun half(int x) -> int:
  ensures: result >= x and result <= 5
local: int a
Go:
  pre: True
  eff: a = half(7)
invariant Zero: forall i in ID: a[i] == 0
""",
        {"Zero", "vacuous"},
    ),
    "priority": (
        """
local:
  int a
  int b
priority:
  First:
    pre: a == 0
    eff: a = 1
  Second:
    pre: True
    eff: b = 1
invariant Range: forall i in ID: 0 <= a[i] and a[i] <= 1
invariant After: forall i in ID: b[i] == 0 or a[i] == 1
""",
        {"Range", "After"},
    ),
    "a loop with an invariant": (
        """
local:
  int n
  int a
Go:
  pre: True
  eff:
    int k = 0
    while k < n:
      invariant k <= 0 or k <= n
      k += 2 if k + 2 <= n else 1
    a = k
invariant Any: forall i in ID: a[i] <= 0 or a[i] <= n[i]
""",
        {"Any", "line 9"},
    ),
}

VERDICTS = {**LESS, **BATTERY}
PROGRAMS = {**WRONG, **{name: text for name, (text, _) in (*VERDICTS.items(), *BROKEN.items())}}
