"""Plan of a campaign: all runs with their parameters. It is complete before the first run begins."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from koordgen.experiment.campaign import vary

FORMAT = "koord-campaign/1"
CAMPAIGN, VALIDATION, PROBES = "campaign", "validation", "probing of a platform"


@dataclass(frozen=True)
class PlannedRun:
    """One run of a plan.

    `varied`: name -> value of everything that is varied.
    `params`: the varied params of the program, which are built into the run's bundle.
    `settings`: the varied settings of the simulation harness, which are written to a file.
    `flags`: the varied options of the run's command line."""

    number: int
    varied: Mapping[str, str]
    params: Mapping[str, str]
    settings: Mapping[str, str]
    flags: Mapping[str, str]

    @property
    def name(self) -> str:
        """Return the name of the run's folder."""
        return f"{self.number:04d}"


@dataclass(frozen=True)
class CampaignPlan:
    """Identity of a campaign. A campaign can be resumed only with an equal plan.

    `bundle`: digest of the bundle that is built without varied params.
    `verdict`: digest of the user's script that judges runs; "" if there is none.
    `fixed`: command-line options of every run.
    `what`: the purpose of the runs."""

    app: str
    bundle: str
    verdict: str
    fixed: tuple[str, ...]
    vary: tuple[str, ...]
    runs: int
    what: str = CAMPAIGN

    def json(self) -> dict[str, Any]:
        """Return the plan as it is stored in JSON."""
        return {"format": FORMAT, **asdict(self), "fixed": list(self.fixed), "vary": list(self.vary)}


def runs(varied: Sequence[vary.Varied], count: int, settings: Collection[str]) -> list[PlannedRun]:
    """Return the runs of a plan. `settings` names the settings of the simulation harness. Raises BadVary."""
    found = []
    for number, own in enumerate(vary.values(varied, count)):
        params = {n.removeprefix(vary.PARAM): v for n, v in own.items() if n.startswith(vary.PARAM)}
        of_harness = {n: v for n, v in own.items() if n in settings}
        flags = {n: v for n, v in own.items() if not n.startswith(vary.PARAM) and n not in of_harness}
        found.append(PlannedRun(number, own, params, of_harness, flags))
    return found


# field of a plan -> message to the user if the stored plan differs in this field
_CHANGED = {
    "app": "the program is another",
    "bundle": "the program, the fleet file or koordgen has changed since",
    "verdict": "the verdict's script has changed since",
    "fixed": "the runs' options are others",
    "vary": "other things are varied",
    "runs": "it has another number of runs",
}


def made_for(stored: Mapping[str, Any]) -> str:
    """Return the purpose of the runs of a stored plan."""
    what = stored.get("what")
    return what if what in (VALIDATION, PROBES) else CAMPAIGN


def difference(stored: Mapping[str, Any], wanted: CampaignPlan) -> str:
    """Return a text that explains how a stored plan differs from the wanted one; "" if both are equal."""
    if stored.get("format") != FORMAT:
        return f"its plan has not the format {FORMAT}"
    asked = wanted.json()
    for key, meaning in _CHANGED.items():
        if (value := asked[key]) != stored.get(key):
            shown = "" if key in ("bundle", "verdict") else f": {_told(stored.get(key))}, not {_told(value)}"
            return f"{meaning}{shown}"
    return ""


def _told(value: Any) -> str:
    return " ".join(value) or "none" if isinstance(value, list) else str(value)
