"""Programs with known verdicts."""

from __future__ import annotations

LINE = """\
param Point lo = Point(0, 0, 0)
param Point hi = Point(9, 9, 3)

using Motion:
  sensors: Point position
  actuators: Point target
  assume position' in Rect(position, target)

allread: Point x[N_SYS]

init:
  x[pid] = Motion.position

TargetUpdate:
  pre: not (pid == N_SYS - 1 or pid == 0)
  eff:
    Motion.target = (x[pid + 1] + x[pid - 1]) / 2
    x[pid] = Motion.position

initially: forall i in ID: Motion.position[i] in Rect(lo, hi)

invariant Geofence:
  forall i in ID: Motion.position[i] in Rect(lo, hi) and x[i] in Rect(lo, hi)
"""
TARGETS = "  forall i in ID: Motion.target[i] in Rect(lo, hi)"
STRONG = LINE.replace("x[i] in Rect(lo, hi)\n", "x[i] in Rect(lo, hi) and Motion.target[i] in Rect(lo, hi)\n")

# Counts to three, and is said to stay below three; Small is true, and needs nothing.
COUNTER = """\
allread: int n[N_SYS]

local: float third

Up:
  pre: n[pid] < 3
  eff:
    n[pid] = n[pid] + 1
    third = n[pid] / 3

invariant Below: forall i in ID: n[i] < 3
invariant Small: forall i in ID: n[i] >= 0
"""

CONTRADICTION = """\
using Motion:
  sensors: float speed
  assume speed' > 1
  assume speed' < 0

local: int n

Go:
  pre: n < 5
  eff: n = n + 1

invariant Low: forall i in ID: n[i] <= 5
"""

# Division by what an invariant does not bound.
DIVIDES = """\
using Motion:
  sensors: float speed

local: float time

Go:
  pre: True
  eff: time = 1 / Motion.speed

invariant Positive: forall i in ID: time[i] == time[i]
"""

# Beyond every solver: Fermat's theorem of cubes.
CUBES = """\
local:
  int a
  int b
  int c
  bool wrong

Try:
  pre: a > 0 and b > 0 and c > 0 and a * a * a + b * b * b == c * c * c
  eff: wrong = True

Next:
  pre: True
  eff:
    if c > a: a += 1
    elif c > b: b += 1
    else: c += 1

invariant Right: forall i in ID: not wrong[i]
"""

# Whoever takes the token has it; two robots may both read that nobody has it.
TOKEN = """\
allwrite: int holder = -1

local: bool mine

Take:
  pre: holder < 0
  eff:
    holder = pid
    mine = True

invariant One: forall i, j in ID: i == j or not mine[i] or not mine[j]
"""

SECRET = """\
local: int n

Go:
  pre: n < 5
  eff: n = n + 1

invariant Low: n <= 5
"""
