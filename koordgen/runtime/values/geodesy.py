"""WGS-84: exact conversion between geodetic coordinates and a local ENU frame, valid at poles and the date line too.

Latitudes and longitudes are in degrees, longitudes from -180 to 180. Heights and lengths are in metres. Heights above
mean sea level (AMSL), as in autopilots and fleet files, are used as if they were heights above the ellipsoid. If the
origin and the points have the same kind of height, this scales distances by less than 2e-5.

Formulas: B. Hofmann-Wellenhof, H. Lichtenegger, J. Collins, "GPS: Theory and Practice", section 10.2. The conversion to
geodetic coordinates iterates B. R. Bowring's formula (Survey Review 23, 1976) twice. Up to a height of 100 km, only
rounding errors remain."""

from __future__ import annotations

import math

Vector = tuple[float, float, float]

SEMI_MAJOR = 6378137.0
FLATTENING = 1 / 298.257223563
SEMI_MINOR = SEMI_MAJOR * (1 - FLATTENING)
_E2 = FLATTENING * (2 - FLATTENING)  # first eccentricity, squared
_EP2 = _E2 / (1 - _E2)  # second eccentricity, squared


def ecef(latitude: float, longitude: float, altitude: float) -> Vector:
    """Return the earth-centred, earth-fixed (ECEF) coordinates of a geodetic position."""
    phi, lam = math.radians(latitude), math.radians(longitude)
    normal = SEMI_MAJOR / math.sqrt(1 - _E2 * math.sin(phi) ** 2)  # radius of curvature in the prime vertical
    radius = (normal + altitude) * math.cos(phi)
    return radius * math.cos(lam), radius * math.sin(lam), (normal * (1 - _E2) + altitude) * math.sin(phi)


def geodetic(x: float, y: float, z: float) -> Vector:
    """Return latitude, longitude and altitude of an ECEF point that is not near the earth's centre."""
    p = math.hypot(x, y)
    beta = math.atan2(z * SEMI_MAJOR, p * SEMI_MINOR)  # parametric latitude
    phi = 0.0
    for _ in range(2):
        phi = math.atan2(
            z + _EP2 * SEMI_MINOR * math.sin(beta) ** 3,
            p - _E2 * SEMI_MAJOR * math.cos(beta) ** 3,
        )
        beta = math.atan2((1 - FLATTENING) * math.sin(phi), math.cos(phi))
    sine = math.sin(phi)
    # The usual formula p / cos(phi) - N for the height is unstable at the poles; this formula is stable.
    height = p * math.cos(phi) + z * sine - SEMI_MAJOR * math.sqrt(1 - _E2 * sine * sine)
    return math.degrees(phi), math.degrees(math.atan2(y, x)), height


def _axes(latitude: float, longitude: float) -> tuple[Vector, Vector, Vector]:
    """Return the unit vectors east, north and up at a geodetic position, in ECEF coordinates."""
    phi, lam = math.radians(latitude), math.radians(longitude)
    sp, cp, sl, cl = math.sin(phi), math.cos(phi), math.sin(lam), math.cos(lam)
    return (-sl, cl, 0.0), (-sp * cl, -sp * sl, cp), (cp * cl, cp * sl, sp)


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


class LocalFrame:
    """Local ENU frame whose origin is a geodetic position: x east, y north, z up.

    The plane z = 0 is parallel to the tangent plane of the ellipsoid at the origin."""

    def __init__(self, latitude: float, longitude: float, altitude: float) -> None:
        self._origin = ecef(latitude, longitude, altitude)
        self._east, self._north, self._up = _axes(latitude, longitude)

    def enu(self, latitude: float, longitude: float, altitude: float) -> Vector:
        """Return the coordinates of a geodetic position in this ENU frame."""
        x, y, z = ecef(latitude, longitude, altitude)
        d = (x - self._origin[0], y - self._origin[1], z - self._origin[2])
        return _dot(d, self._east), _dot(d, self._north), _dot(d, self._up)

    def geodetic(self, x: float, y: float, z: float) -> Vector:
        """Return latitude, longitude and altitude of a point in this ENU frame."""
        (ox, oy, oz), e, n, u = self._origin, self._east, self._north, self._up
        return geodetic(
            ox + x * e[0] + y * n[0] + z * u[0],
            oy + x * e[1] + y * n[1] + z * u[1],
            oz + x * e[2] + y * n[2] + z * u[2],
        )

    def turned(self, latitude: float, longitude: float, north: float, east: float, down: float) -> Vector:
        """Rotate a vector from the NED axes at a geodetic position to the ENU axes of this frame.

        The north axes at the position and at the frame's origin differ by the convergence of meridians. The angle is
        negligible at a distance of 100 m in middle latitudes, and up to half a turn at a pole."""
        e, n, u = _axes(latitude, longitude)
        v = (
            east * e[0] + north * n[0] - down * u[0],
            east * e[1] + north * n[1] - down * u[1],
            east * e[2] + north * n[2] - down * u[2],
        )
        return _dot(v, self._east), _dot(v, self._north), _dot(v, self._up)

    def ned(self, latitude: float, longitude: float, east: float, north: float, up: float) -> Vector:
        """Rotate a vector from the ENU axes of this frame to the NED axes at a geodetic position.

        This is the inverse of `turned`."""
        e, n, u = _axes(latitude, longitude)
        v = (
            east * self._east[0] + north * self._north[0] + up * self._up[0],
            east * self._east[1] + north * self._north[1] + up * self._up[1],
            east * self._east[2] + north * self._north[2] + up * self._up[2],
        )
        return _dot(v, n), _dot(v, e), -_dot(v, u)
