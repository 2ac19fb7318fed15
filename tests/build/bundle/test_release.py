"""Name of a release: equal for all robots of a build, different after any change."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from koordgen.build.bundle.plan import Files, plan, read_ingredients
from koordgen.build.pipeline import check_file
from koordgen.fleet import file as fleet
from koordgen.fleet import manifest
from koordgen.lang import resources
from koordgen.lang.source import Source
from koordgen.runtime.config.settings import BadSettings, load
from tests.golden.test_golden import PROGRAMS

PROGRAM, FLEET = PROGRAMS["lineform"]
ROBOTS = ("alice", "bert", "cleo", "dora", "emil")


def bundles(more: str = "", wanted: tuple[str, ...] = ("quad", "car", "sim")) -> dict[str, Files]:
    targets = {n: manifest.load(n) for n in manifest.available()}
    source = Source("fleet.yaml", FLEET.read_text() + more)
    read = fleet.read(source, targets, {}, lambda *told: pytest.fail(str(told)))
    checked = check_file(str(PROGRAM)).program
    ingredients = read_ingredients(checked, PROGRAM.read_bytes(), tuple(targets.values()), read, resources.package())
    return plan(ingredients, wanted)


def releases(found: dict[str, Files]) -> set[bytes]:
    own = {files["RELEASE"] for name, files in found.items() if name != "sim"}
    return own | {found["sim"][f"agents/{name}/RELEASE"] for name in ROBOTS if "sim" in found}


def test_all_robots_of_a_build_are_of_one_release_whichever_are_built() -> None:
    (release,) = releases(bundles())
    assert releases(bundles(wanted=("quad",))) == {release} == releases(bundles(wanted=("car",)))


def test_vendored_code_is_in_the_simulators_bundle_with_its_licence_and_in_no_robots() -> None:
    found = bundles()
    vendor = "targets/sim/view/web/page/vendor"
    carried = {path for path in found["sim"] if "vendor" in path}
    assert carried == {f"{vendor}/three.min.js", f"{vendor}/LICENSE"}
    assert found["sim"][f"{vendor}/LICENSE"].decode().strip() in found["sim"][f"{vendor}/three.min.js"].decode()
    assert not [path for name in ROBOTS for path in found[name] if "vendor" in path or path.endswith(".js")]


def test_another_setting_of_one_robot_is_another_release_of_all() -> None:
    assert releases(bundles()).isdisjoint(releases(bundles("\nsafety: {peer_timeout: 11}\n")))


def test_a_robot_reads_its_release_from_its_bundle(tmp_path: Path) -> None:
    files = bundles()["alice"]
    (tmp_path / "settings.json").write_bytes(files["settings.json"])
    assert load(tmp_path / "settings.json").release == ""
    (tmp_path / "RELEASE").write_bytes(files["RELEASE"])
    over = tmp_path / "over.json"
    over.write_text(json.dumps({"delta": 0.2}))
    assert load(tmp_path / "settings.json", over).release == files["RELEASE"].decode().strip()


@pytest.mark.parametrize("damaged", [b"abc\n", b"\xff\xfe", b"g" * 32])
def test_a_damaged_name_is_an_error(tmp_path: Path, damaged: bytes) -> None:
    (tmp_path / "settings.json").write_bytes(bundles()["alice"]["settings.json"])
    (tmp_path / "RELEASE").write_bytes(damaged)
    with pytest.raises(BadSettings):
        load(tmp_path / "settings.json")


def test_settings_cannot_claim_a_release(tmp_path: Path) -> None:
    (tmp_path / "settings.json").write_bytes(bundles()["alice"]["settings.json"])
    over = tmp_path / "over.json"
    over.write_text(json.dumps({"release": "0" * 32}))
    with pytest.raises(BadSettings, match="a release is not set"):
        load(tmp_path / "settings.json", over)
