"""The fleet's ENU frame against pymap3d, to a millimetre over 10 km, wherever on earth."""

from __future__ import annotations

import math

import numpy as np
import pymap3d
import pytest
from hypothesis import given
from hypothesis import strategies as st

from koordgen.runtime.geodesy import LocalFrame, ecef, geodetic

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


def test_thousands_of_places_at_once() -> None:
    random = np.random.default_rng(5)
    lat = np.degrees(np.arcsin(random.uniform(-1, 1, 3000)))
    lat[:500] = random.choice([-1, 1], 500) * (90 - random.uniform(0, 1e-4, 500))  # within 10 m of a pole
    lon = random.uniform(-180, 180, 3000)
    lon[500:1000] = random.choice([-180, 180], 500) + random.uniform(-1e-4, 1e-4, 500)  # about the date line
    alt = random.uniform(-400, 9000, 3000)
    enu = random.uniform(-10_000, 10_000, (3, 3000))
    expected = np.array(pymap3d.enu2ecef(*enu, lat, lon, alt)).T
    for place, point, earth in zip(zip(lat, lon, alt, strict=True), enu.T, expected, strict=True):
        frame = LocalFrame(*place)
        there = frame.geodetic(*point)
        assert far(ecef(*there), tuple(earth)) < MM
        assert far(frame.enu(*there), tuple(point)) < MM


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
