"""Bundles for commands: names of targets, params, planning and writing, with errors as Failure."""

from __future__ import annotations

from typing import TYPE_CHECKING

from koordgen.cli.base.console import SURROUNDINGS, USAGE, Failure, install, print_diagnostics

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Collection, Mapping

    from koordgen.lang.analyze.params import Value


def target_names(text: str) -> list[str]:
    """Parse the value of --target: names of targets, separated by commas. Raises Failure."""
    from koordgen.fleet import manifest

    wanted = [name.strip() for name in text.split(",") if name.strip()]
    unknown = [name for name in wanted if name not in manifest.available()]
    if unknown or not wanted:
        message = f"no target {unknown[0]!r}" if unknown else "--target names no target"
        raise Failure(USAGE, message, f"possible targets: {available_targets()}")
    return list(dict.fromkeys(wanted))


def available_targets() -> str:
    """Return the names of all targets, as text."""
    from koordgen.fleet import manifest

    return ", ".join(manifest.available())


def left_out(bundles: Mapping[str, Mapping[str, bytes]], targets: Collection[str]) -> list[str]:
    """Return the robots for which no bundle is built; empty if `targets` names only harnesses."""
    import json

    from koordgen.fleet import manifest

    if "fleet" not in bundles or all(manifest.load(name).kind != "agent" for name in targets):
        return []
    facts = json.loads(bundles["fleet"]["fleet.json"])
    inner = {
        squad["name"]: [f"{squad['name']}.{robot}" for robot in squad["robots"]] for squad in facts.get("squads", ())
    }
    robots = [name for peer in facts["peers"] for name in inner.get(peer["name"], [peer["name"]])]
    return [name for name in robots if name not in bundles]


def planned(
    options: Namespace, targets: list[str] | None, more: Mapping[str, Value] = {}, squads: bool = False
) -> tuple[dict[str, dict[str, bytes]], str]:
    """Return the bundles, and the name of the app, or of the fleet if its file names the programs.

    Raises Rejected, Failure.

    `more`: values of params, replaced by those of the options --param. `squads`: True if the command can work with
    robots that are fleets themselves. Warnings and notes are printed; for a command
    that prints one JSON document they are added to `options.collected` instead.
    """
    from koordgen.build.pipeline import fleet_name, plan_file, plan_fleet_file
    from koordgen.cli.base.values import is_fleet
    from koordgen.fleet.manifest import ManifestError
    from koordgen.lang.analyze.params import BadParam

    try:
        if is_fleet(options.program):
            refuse_options_of_programs(options)
            diagnostics, bundles = plan_fleet_file(options.program, targets)
            name = fleet_name(options.program)
        else:
            given = {**more, **params(options.param)}
            checked, bundles = plan_file(options.program, targets, options.fleet, given, options.functions, squads)
            diagnostics = [*((checked.source, d) for d in checked.diagnostics), *checked.elsewhere]
            name = checked.program.name
    except BadParam as error:
        raise Failure(USAGE, str(error)) from None
    except ManifestError as error:
        raise Failure(SURROUNDINGS, str(error), "the target's folder is damaged; reinstall koordgen") from None
    if options.format == "json" and (collected := getattr(options, "collected", None)) is not None:
        collected += diagnostics
    else:
        print_diagnostics(diagnostics, options)
    return bundles, name


def fleet_path(options: Namespace) -> str:
    """Return the path of the fleet file, which stands in place of the program or in --fleet. Raises Failure."""
    from koordgen.cli.base.values import is_fleet

    found = options.program if is_fleet(options.program) else options.fleet
    if found is None:
        help = "add --fleet fleet.yaml, or give a fleet file with `applications` in place of the program"
        raise Failure(USAGE, "the fleet file is missing", help)
    return str(found)


def invocation(options: Namespace) -> list[str]:
    """Return the arguments that name program, fleet file, params and functions file for another koordgen command."""
    found = [options.program] + ([f"--fleet={options.fleet}"] if options.fleet else [])
    found += [f"--param={text}" for text in options.param]
    return found + ([f"--functions={options.functions}"] if options.functions else [])


def refuse_options_of_programs(options: Namespace) -> None:
    """Raise Failure for options that concern a single program, given with a fleet file instead of a program."""
    for option, given, help in (
        ("--fleet", options.fleet, "name one fleet file only"),
        ("--param", options.param, "write params into the `applications` of the fleet file"),
        ("--functions", options.functions, "put the functions file beside its program, as PROGRAM_functions.py"),
    ):
        if given:
            raise Failure(USAGE, f"{option} needs a program, but {options.program} is a fleet file", help)


def params(given: list[str]) -> dict[str, Value]:
    """Parse the values of --param, each NAME=VALUE. Raises Failure."""
    if not given:
        return {}
    from koordgen.lang.analyze.params import BadParam, parse_value

    values = {}
    for text in given:
        name, equals, value = text.partition("=")
        if not equals:
            raise Failure(USAGE, f"--param {text}: expected NAME=VALUE", "for example --param step=2.0")
        try:
            values[name] = parse_value(value)
        except BadParam as error:
            raise Failure(USAGE, f"--param {text}: {error}") from None
    return values


def write(bundles: dict[str, dict[str, bytes]], folder: object) -> None:
    """Write bundles to disk. Raises Failure."""
    from pathlib import Path

    from koordgen.build.bundle.write import CannotWrite
    from koordgen.build.bundle.write import write as write_all

    try:
        write_all(bundles, Path(str(folder)))
    except CannotWrite as error:
        raise Failure(SURROUNDINGS, str(error), error.hint) from None


def require_packages() -> None:
    """Raise Failure if this Python lacks a package that a harness or an agent needs: both run with this Python."""
    from importlib.metadata import PackageNotFoundError, version

    from koordgen.fleet import manifest
    from koordgen.runtime.ops.host import needed

    def is_missing(name: str) -> bool:
        try:
            version(name)
        except PackageNotFoundError:
            return True
        return False

    missing = set()
    for target in map(manifest.load, manifest.available()):
        wanted = set(filter(None, map(needed, target.requirements)))
        missing |= set(filter(is_missing, wanted - set(target.one_of)))
        if target.one_of and all(map(is_missing, target.one_of)):
            missing.add(" or ".join(target.one_of))
    if missing:
        message = f"packages are missing: {', '.join(sorted(missing))}"
        raise Failure(SURROUNDINGS, message, install("koordgen[sim]"))
