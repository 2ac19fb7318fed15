"""lineform: the properties of the Koord program lineform.koord, by koordgen 0.1.0.

The next build writes this file anew: change the Koord program, not this.
"""

from __future__ import annotations

from koordgen.runtime.program.property import Known, Properties

from program import PROGRAM

PROPERTIES = Properties(
    program=PROGRAM,
    fleet=Known,
    step=Known,
    properties=(),
    assumptions=(),
    unchecked=(),
    measured=("Motion.position",),
)
