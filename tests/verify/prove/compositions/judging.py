"""Verdicts of compositions, and runs that contradict them."""

from __future__ import annotations

from unittest.mock import patch

from koordgen.lang.semantics.composition import System
from koordgen.verify.attack.system_runs import SystemContradiction, attack_system
from koordgen.verify.prove.report import verdict
from koordgen.verify.prove.report.composition import CompositionVerdicts, prove_system
from koordgen.verify.prove.smt.solve import Solver
from tests.verify.attack.faults import ticks


def judged(system: System, solver: Solver) -> CompositionVerdicts:
    """Return the verdicts of a system. Failures are not explained, because that takes long."""
    with patch.object(verdict, "_explained", lambda *_: {}):
        return prove_system(system, solver)


def proved(found: CompositionVerdicts) -> set[str]:
    """Return what is PROVED, in the notation of KnownComposition."""
    return {
        f"{part.application}: {v.invariant.removeprefix('guarantee counter.')}"
        for part in found.applications
        for v in part.verdicts
        if v.verdict == "PROVED" and v.invariant != "(well-defined)"
    }


def contradiction(
    system: System, found: CompositionVerdicts, seconds: float = 0.02, seed: int = 0
) -> SystemContradiction | None:
    """Return a run that contradicts a verdict; None if none is found. The budget counts work: 0.0002 for a step."""
    names = [{v.invariant for v in part.verdicts if v.verdict == "PROVED"} for part in found.applications]
    return attack_system(system, names, seconds, ticks(), seed).contradiction
