"""Plan of a campaign: the list of all runs with their parameters. The plan is complete before the first run begins."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from koordgen.experiment.campaign import vary

FORMAT = "koord-campaign/1"
CAMPAIGN, VALIDATION, PROBES = "campaign", "validation", "probing of a platform"


@dataclass(frozen=True)
class PlannedRun:
    """One simulation run in the plan of a campaign.

    `varied`: name -> value of everything that differs between runs. Three of the other fields divide these values:
    `params`: params of the Koord program, which are built into the run's bundle.
    `settings`: settings of the simulation harness, which are written to a settings file.
    `flags`: options of the run's command line."""

    number: int
    varied: Mapping[str, str]
    params: Mapping[str, str]
    settings: Mapping[str, str]
    flags: Mapping[str, str]

    @property
    def name(self) -> str:
        """Return the name of the run's folder: the run's number with at least four digits."""
        return f"{self.number:04d}"


@dataclass(frozen=True)
class CampaignPlan:
    """Identity of a campaign. A campaign can be resumed only with an equal plan.

    `app`: name of the Koord program.
    `bundle`: digest of the simulation bundle that is built without varied params.
    `verdict`: digest of the user's script that judges runs; "" if there is no script.
    `fixed`: command-line options that all runs have.
    `vary`: arguments of the `--vary` options.
    `runs`: number of runs.
    `what`: purpose of the runs: a campaign, a validation or the probing of a platform."""

    app: str
    bundle: str
    verdict: str
    fixed: tuple[str, ...]
    vary: tuple[str, ...]
    runs: int
    what: str = CAMPAIGN

    def json(self) -> dict[str, Any]:
        """Return the plan as a JSON object, in the form of `plan.json`."""
        return {"format": FORMAT, **asdict(self), "fixed": list(self.fixed), "vary": list(self.vary)}


def runs(varied: Sequence[vary.Varied], count: int, settings: Collection[str]) -> list[PlannedRun]:
    """Return the first `count` runs of a campaign in which the quantities `varied` vary. Raises BadVary.

    `settings`: names of all settings of the simulation harness."""
    found = []
    for number, own in enumerate(vary.values(varied, count)):
        params = {n.removeprefix(vary.PARAM): v for n, v in own.items() if n.startswith(vary.PARAM)}
        of_harness = {n: v for n, v in own.items() if n in settings}
        flags = {n: v for n, v in own.items() if not n.startswith(vary.PARAM) and n not in of_harness}
        found.append(PlannedRun(number, own, params, of_harness, flags))
    return found


# field of a CampaignPlan -> message to the user if the stored plan differs from the wanted plan in this field
_CHANGED = {
    "app": "the program is another",
    "bundle": "the program, the fleet file or koordgen has changed since",
    "verdict": "the verdict's script has changed since",
    "fixed": "the runs' options are others",
    "vary": "other things are varied",
    "runs": "it has another number of runs",
}


def made_for(stored: Mapping[str, Any]) -> str:
    """Return the purpose that a stored plan names: VALIDATION or PROBES. Every other plan counts as CAMPAIGN."""
    what = stored.get("what")
    return what if what in (VALIDATION, PROBES) else CAMPAIGN


def difference(stored: Mapping[str, Any], wanted: CampaignPlan) -> str:
    """Return a message about the first difference between a stored plan and the wanted plan; "" if they are equal."""
    if stored.get("format") != FORMAT:
        return f"the stored plan does not have the format {FORMAT}"
    asked = wanted.json()
    for key, meaning in _CHANGED.items():
        if (value := asked[key]) != stored.get(key):
            shown = "" if key in ("bundle", "verdict") else f": {_shown(stored.get(key))}, not {_shown(value)}"
            return f"{meaning}{shown}"
    return ""


def _shown(value: Any) -> str:
    return " ".join(value) or "none" if isinstance(value, list) else str(value)
