"""Parameters of a simulated ArduPilot copter, under the names of its version.

Integers travel as floats of the same value (MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST). The defaults are those of a
copter prepared for flight with a companion computer and without a remote control."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

REAL, BYTE, SHORT = mavlink.MAV_PARAM_TYPE_REAL32, mavlink.MAV_PARAM_TYPE_INT8, mavlink.MAV_PARAM_TYPE_INT16
VERSION = "4.7"
DEVELOPMENT = "-dev"


@dataclass(frozen=True, slots=True)
class Parameter:
    """Parameter of the present version.

    Before `since` it has the name `older`, and its value is `units` times as large."""

    name: str
    value: float
    kind: int = BYTE
    since: tuple[int, int] = (0, 0)
    older: str = ""
    units: float = 1.0


PARAMETERS = (
    Parameter("BATT_CRT_VOLT", 10.8, REAL),
    Parameter("BATT_FS_CRT_ACT", 1),
    Parameter("BATT_LOW_TIMER", 10),
    Parameter("COMPASS_ENABLE", 1),
    Parameter("DISARM_DELAY", 10),
    Parameter("EK3_SRC1_POSXY", 3),
    Parameter("EK3_SRC1_POSZ", 1),
    Parameter("EK3_SRC1_VELXY", 3),
    Parameter("EK3_SRC1_VELZ", 3),
    Parameter("EK3_SRC1_YAW", 1),
    Parameter("FS_EKF_ACTION", 1),
    Parameter("FS_GCS_ENABLE", 5),
    Parameter("FS_GCS_TIMEOUT", 5, REAL),
    Parameter("FS_THR_ENABLE", 0),
    Parameter("GPS1_DELAY_MS", 0, SHORT, (4, 6), "GPS_DELAY_MS"),
    Parameter("GPS1_TYPE", 1, BYTE, (4, 6), "GPS_TYPE"),
    Parameter("GUID_OPTIONS", 0, mavlink.MAV_PARAM_TYPE_INT32),
    Parameter("GUID_TIMEOUT", 3, REAL),
    Parameter("LAND_REPOSITION", 0),
    Parameter("MAV_GCS_SYSID", 255, SHORT, (4, 7), "SYSID_MYGCS"),
    Parameter("MAV_SYSID", 1, SHORT, (4, 7), "SYSID_THISMAV"),
    Parameter("VISO_DELAY_MS", 10, SHORT),
    Parameter("VISO_TYPE", 0),
    Parameter("WP_SPD", 5, REAL, (4, 7), "WPNAV_SPEED", 100),
    Parameter("WP_SPD_DN", 1.5, REAL, (4, 7), "WPNAV_SPEED_DN", 100),
    Parameter("WP_SPD_UP", 2.5, REAL, (4, 7), "WPNAV_SPEED_UP", 100),
    Parameter("WP_YAW_BEHAVIOR", 2),
)
_GPS = {"EK3_SRC1_POSXY": 3, "EK3_SRC1_POSZ": 3, "EK3_SRC1_VELXY": 3, "EK3_SRC1_VELZ": 3, "EK3_SRC1_YAW": 2}
_VISION = {"EK3_SRC1_POSXY": 6, "EK3_SRC1_POSZ": 6, "EK3_SRC1_VELXY": 0, "EK3_SRC1_VELZ": 0, "EK3_SRC1_YAW": 6}
_EXTERNAL = {**_VISION, "VISO_TYPE": 1, "GPS1_TYPE": 0, "COMPASS_ENABLE": 0}
# Values that an operator sets for a robot's `positioning`.
PREPARED: Mapping[str, Mapping[str, float]] = {
    "gps_input": {**_GPS, "GPS1_TYPE": 14, "GPS1_DELAY_MS": 50},
    "vision": _EXTERNAL,
    "odometry": {**_EXTERNAL, "EK3_SRC1_VELXY": 6, "EK3_SRC1_VELZ": 6},
}


class SimulatedParameters(dict[str, float]):
    """Parameter values by the names of `version`; `of` reads them by their present names.

    A version that ends in DEVELOPMENT is a development build before the release."""

    def __init__(
        self, version: str = VERSION, table: tuple[Parameter, ...] = PARAMETERS, positioning: str = ""
    ) -> None:
        self.development = version.endswith(DEVELOPMENT)
        major, _, minor = version.removesuffix(DEVELOPMENT).partition(".")
        self.release = known = int(major), int(minor)
        self.positioning = positioning  # the positioning that the values were preset for
        prepared = PREPARED.get(positioning, {})
        self._table = {p.name: p for p in table}
        self._kinds: dict[str, int] = {}
        self._outside: dict[str, tuple[str, float]] = {}
        for p in table:
            name, units = (p.name, 1.0) if known >= p.since else (p.older, p.units)
            self._outside[p.name], self._kinds[name] = (name, units), p.kind
            self[name] = prepared.get(p.name, float(p.value)) * units

    def of(self, name: str) -> float:
        """Return the value in the present unit; the default if the parameter was removed."""
        outside, units = self._outside[name]
        value = self.get(outside)
        return self._table[name].value if value is None else value / units

    def kind(self, name: str) -> int:
        """Return the parameter's MAV_PARAM_TYPE."""
        return int(self._kinds.get(name, REAL))

    def value_message(self, name: str, index: int = -1) -> mavlink.MAVLink_param_value_message | None:
        """Return PARAM_VALUE of the parameter with this name, or with this index if >= 0.

        None if there is none."""
        names = list(self)
        if index >= 0:
            name = names[index] if index < len(names) else ""
        if name not in self:
            return None
        kind = self.kind(name)
        return mavlink.MAVLink_param_value_message(
            name.encode("ascii"), self[name], kind, len(names), names.index(name)
        )

    def change(self, name: str, value: float) -> bool:
        """Set a value, as PARAM_SET does. Return whether it was accepted."""
        if name not in self or not math.isfinite(value):
            return False
        whole = self.kind(name) != REAL
        self[name] = float(round(max(-32768.0, min(32767.0, value)))) if whole else value
        return True
