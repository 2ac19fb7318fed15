"""The fleet's ENU frame against pymap3d, to a millimetre over 10 km, wherever on earth."""

from __future__ import annotations

import math

import numpy as np
import pymap3d
import pytest
from hypothesis import given
from hypothesis import strategies as st

from koordgen.runtime.values.geodesy import LocalFrame, ecef, geodetic

MM = 1e-3
latitudes = st.one_of(st.floats(-90, 90), st.sampled_from([-90.0, -89.99999, 0.0, 89.95, 89.9999999, 90.0]))
longitudes = st.one_of(st.floats(-180, 180), st.sampled_from([-180.0, -179.99999, 0.0, 179.99999, 180.0]))
metres = st.floats(-10_000, 10_000)
heights = st.floats(-500, 9000)


def far(a: tuple[float, float, float], b: tuple[float, float, float]) -> float:
    return math.dist(a, b)


@given(latitudes, longitudes, heights, metres, metres, metres)
def test_agrees_with_pymap3d(lat: float, lon: float, alt: float, x: float, y: float, z: float) -> None:
    frame = LocalFrame(lat, lon, alt)
    there = frame.geodetic(x, y, z)
    assert -90 <= there[0] <= 90 and -180 <= there[1] <= 180
    # In ECEF, because a longitude says nothing at a pole.
    assert far(ecef(*there), pymap3d.enu2ecef(x, y, z, lat, lon, alt)) < MM
    assert far(frame.enu(*there), (x, y, z)) < MM
    assert far(frame.enu(*there), pymap3d.geodetic2enu(*there, lat, lon, alt)) < MM


def worst(count: int, seed: int) -> dict[str, float]:
    """The largest difference from pymap3d (m, or m/s of a velocity of up to 5 m/s) over random origins on the whole
    earth, a sixth of them within 10 m of a pole and a sixth about the date line, and points within 10 km of them."""
    random = np.random.default_rng(seed)
    lat = np.degrees(np.arcsin(random.uniform(-1, 1, count)))
    lon = random.uniform(-180, 180, count)
    sixth = count // 6
    lat[:sixth] = random.choice([-1, 1], sixth) * (90 - random.uniform(0, 1e-4, sixth))
    lon[sixth : 2 * sixth] = random.choice([-180, 180], sixth) + random.uniform(-1e-4, 1e-4, sixth)
    alt = random.uniform(-400, 9000, count)
    ways = random.normal(size=(3, count))
    enu = ways / np.linalg.norm(ways, axis=0) * 10_000 * np.cbrt(random.uniform(0, 1, count))
    velocity = random.uniform(-5, 5, (3, count))
    earth = np.array(pymap3d.enu2ecef(*enu, lat, lon, alt))
    there = np.array(pymap3d.ecef2geodetic(*earth))
    back = np.array(pymap3d.geodetic2enu(*there, lat, lon, alt))
    north, east, down = pymap3d.geodetic2ned(*there, lat, lon, alt)
    turned = np.array(pymap3d.uvw2enu(*pymap3d.enu2uvw(*velocity, lat, lon), there[0], there[1]))
    errors = dict.fromkeys(("to geodetic", "altitude", "to ENU", "to NED", "to ECEF", "from ECEF", "velocity"), 0.0)

    def note(what: str, error: float) -> None:
        errors[what] = max(errors[what], float(error))

    for i in range(count):
        frame, point, place = LocalFrame(lat[i], lon[i], alt[i]), tuple(enu[:, i]), tuple(there[:, i])
        ours, moving = frame.geodetic(*point), tuple(velocity[:, i])
        note("to geodetic", far(ecef(*ours), tuple(earth[:, i])))
        note("altitude", abs(ours[2] - place[2]))  # above the sea; so relative to any place, too
        note("to ENU", max(far(frame.enu(*place), tuple(back[:, i])), far(frame.enu(*ours), point)))
        x, y, z = frame.enu(*place)
        note("to NED", far((y, x, -z), (north[i], east[i], down[i])))
        note("to ECEF", far(ecef(*place), pymap3d.geodetic2ecef(*place)))
        note("from ECEF", far(ecef(*geodetic(*earth[:, i])), tuple(earth[:, i])))
        n, e, d = frame.ned(place[0], place[1], *moving)
        note(
            "velocity",
            max(far((e, n, -d), tuple(turned[:, i])), far(frame.turned(place[0], place[1], n, e, d), moving)),
        )
    return errors


def test_thousands_of_places_at_once() -> None:
    assert max(worst(3000, 5).values()) < MM


@pytest.mark.slow
def test_a_hundred_thousand_places() -> None:
    errors = worst(100_000, 6)
    print(", ".join(f"{what} {error:.1e}" for what, error in errors.items()))
    assert max(errors.values()) < MM


@given(latitudes, longitudes, st.floats(-10_000, 100_000))
def test_there_and_back(lat: float, lon: float, alt: float) -> None:
    assert far(ecef(*geodetic(*ecef(lat, lon, alt))), ecef(lat, lon, alt)) < 1e-6


def test_height_is_exact_at_the_poles() -> None:
    assert geodetic(0.0, 0.0, 6356752.314245179 + 12.5) == pytest.approx((90, 0, 12.5), abs=1e-8)


@given(latitudes, longitudes, heights, metres, metres, st.tuples(*[st.floats(-5, 5)] * 3))
def test_velocities_turn_with_the_place(
    lat: float, lon: float, alt: float, x: float, y: float, ned: tuple[float, float, float]
) -> None:
    """Against a difference of positions: a second's flight with that velocity in the NED axes of the place."""
    frame = LocalFrame(lat, lon, alt)
    place = frame.geodetic(x, y, 0.0)
    here = LocalFrame(*place)
    moved = frame.enu(*here.geodetic(ned[1], ned[0], -ned[2]))
    turned = frame.turned(place[0], place[1], *ned)
    assert far(turned, tuple(a - b for a, b in zip(moved, frame.enu(*place), strict=True))) < 1e-6  # type: ignore[arg-type]


def test_across_the_date_line_is_near() -> None:
    frame = LocalFrame(-17.0, 179.99999, 0.0)
    latitude, longitude, _ = frame.geodetic(5.0, 0.0, 0.0)
    assert -180 <= longitude < -179.99 and latitude == pytest.approx(-17.0, abs=1e-6)
    assert frame.enu(-17.0, -179.99999, 0.0)[0] == pytest.approx(2.13, abs=0.01)
