"""Pre-flight checks of a car, without motion: drive, watchdog, position source, settings and motor lag."""

from __future__ import annotations

import os
from itertools import pairwise

from koordgen.runtime.config.settings import Box
from koordgen.runtime.values.geodesy import LocalFrame
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.datagrams import waiting
from koordgen.runtime.vehicle.feed import Feed
from koordgen.runtime.vehicle.platform import Finding, Unready
from koordgen.runtime.vehicle.safety import inside
from targets.car.base.settings import CarSettings
from targets.car.control.lag import LONGEST_LAG, is_long
from targets.car.control.tracker import BRAKING
from targets.car.drive.drive import Drive, opened
from targets.car.drive.links import Links
from targets.car.drive.watchdog import LATE

STALE = 0.3  # seconds without a position sample after which the car brakes
_STEP, _STEPS = 0.05, 60  # seconds from poll to poll, and maximum number of polls of a check
_DRIVE_STEPS = 110  # polls to wait for the drive's answer; a silent drive raises Unready after 5 s
_CHECK_STEPS = 100  # maximum number of further polls, in which an answering drive is asked for its parameters
_WATCHED = 1.0  # seconds for which a position feed is measured
LEAST_RATE = 10.0  # Hz; a position source with a lower rate gets a warning
LEAST_STEERING = 0.8  # share of max_steering that the servo's range must allow; a smaller share gives a warning
MOST_ERPM = 100_000.0  # default of l_max_erpm in the VESC firmware


def limits(settings: CarSettings, fence: Box) -> Finding:
    """Check that the settings are consistent with each other and with the geofence.

    Calibrated settings cannot be checked without driving the car."""
    radius, room = settings.planned_radius, min(fence.hi.x - fence.lo.x, fence.hi.y - fence.lo.y)
    erpm = 0.0 if settings.is_rover else abs(settings.max_speed * settings.speed_to_erpm_gain)
    share = settings.max_speed / settings.full_speed
    pace = f"{share:.0%} of the throttle" if settings.is_rover else f"{erpm:.0f} ERPM"
    told = f"turning radius {radius:.2f} m, {settings.max_speed:g} m/s are {pace}"
    if 2 * radius > room:
        hint = "the car cannot turn round: check wheelbase, max_steering, the servo's gain and offset, the geofence"
        return Finding("limits", "fail", told, f"a turning circle that fits into the geofence, {room:g} m wide", hint)
    if settings.braking < BRAKING * settings.max_acceleration:
        slower = f"brakes with {settings.braking:g} m/s^2, {told}"
        hint = "the planned braking is harder than the brakes allow: lower max_acceleration, or repair the brakes"
        return Finding("limits", "fail", slower, f"{BRAKING * settings.max_acceleration:g} m/s^2 or more", hint)
    if settings.steering_limit < LEAST_STEERING * settings.max_steering:
        hint = "the servo cannot steer that far: check steering_to_servo_gain and steering_to_servo_offset"
        steering = f"steers {settings.steering_limit:.2f} rad, {told}"
        return Finding("limits", "warn", steering, f"max_steering, {settings.max_steering:g} rad", hint)
    if erpm > MOST_ERPM:
        hint = "a VESC with default settings refuses more: check max_speed and speed_to_erpm_gain"
        return Finding("limits", "warn", told, f"{MOST_ERPM:.0f} ERPM or less", hint)
    return Finding("limits", "ok", told)


def slow(lag: float) -> str:
    """Return a warning about a motor lag (s) that is too long, with remedies."""
    return (
        f"the motor follows its commands with a lag of {lag:.1f} s, the car is driven exactly up to {LONGEST_LAG:g} s: "
        "it overshoots and may circle its targets; tune the motor controller's speed loop, raise a rover's "
        "MOT_SLEWRATE, or lower max_speed and max_acceleration"
    )


def check_lag(lag: float | None) -> list[Finding]:
    """Check the motor's lag that was measured when the car drove last; return no check without a stored lag."""
    if lag is None:
        return []
    told = f"{lag:.1f} s when the car drove last"
    if is_long(lag):
        return [Finding("lag", "warn", told, f"{LONGEST_LAG:g} s or less", slow(lag))]
    return [Finding("lag", "ok", told)]


def check_drive(settings: CarSettings, links: Links, frame: LocalFrame) -> list[Finding]:
    """Check that the drive answers, reports no fault and has right parameters. Opens and closes the drive."""
    try:
        drive = opened(settings, links, frame)
    except Unready as error:
        return [Finding.of("drive", error)]
    checked: list[Finding] | None = None
    try:
        for i in range(_DRIVE_STEPS + _CHECK_STEPS):
            drive.ask(i * _STEP)
            links.wait(_STEP)
            drive.read(i * _STEP)
            if drive.heard and (checked := drive.checks(i * _STEP)) is not None:
                break
            if not drive.heard and i >= _DRIVE_STEPS:
                break
    except Unready as error:
        return [Finding.of("drive", error)]
    finally:
        drive.close(standing=True)
    if not drive.heard:
        return [
            Finding("drive", "fail", drive.blocked, "an answer", "switch the drive on, and check the setting `drive`")
        ]
    return [_answering(drive), *(checked or [])]


def _answering(drive: Drive) -> Finding:
    if drive.fault:
        hint = "the car brakes while the fault lasts; the VESC tool explains the fault"
        return Finding("drive", "fail", f"{drive.about}, {drive.fault}", "no fault", hint)
    if drive.doubt:
        return Finding("drive", "warn", drive.about, why=drive.doubt)
    return Finding("drive", "ok", drive.about)


def check_watchdog(links: Links) -> Finding:
    """Check that a watchdog's process starts and answers. During the check, it holds the null device."""
    watch = links.watchdog()
    nothing = os.open(os.devnull, os.O_WRONLY)
    try:
        watch.hold(nothing, b"")
        for _ in range(_STEPS):
            watch.beat()
            links.wait(_STEP)
            watch.poll()
            if not watch.trouble:
                return Finding("watchdog", "ok", f"answers; it brakes {LATE:g} s after the last command")
    finally:
        watch.close(standing=True)
        os.close(nothing)
    hint = "; ".join(watch.log_lines()) or "check whether the computer is overloaded"
    return Finding("watchdog", "fail", f"does not answer within {_STEPS * _STEP:g} s", "an answer", hint)


def check_feed(settings: CarSettings, fence: Box, feed: Feed, links: Links) -> list[Finding]:
    """Check rate and age of the position feed's samples, and that the position is inside the geofence.

    Opens and closes the feed's port."""
    try:
        datagrams = links.position(settings.position)
    except Unready as error:
        return [Finding.of("position", error)]
    feed.hear(datagrams)
    came: list[float] = []
    oldest = 0.0  # seconds
    try:
        for i in range(_STEPS):
            links.wait(_STEP)
            now = i * _STEP
            for datagram in waiting(datagrams):
                if feed.receive(datagram, now) and feed.time is not None:
                    came.append(now)
                    oldest = max(oldest, now - feed.time)
            if came and now - came[0] >= _WATCHED:
                break
    finally:
        datagrams.close()
    if feed.pose is None:
        return [Finding.of("position", Unready(*feed.silent(settings.position, _STEPS * _STEP)))]
    return [_arriving(settings, came, oldest, now), _placed(feed.pose.position, fence)]


def check_fixes(settings: CarSettings, fence: Box, links: Links, frame: LocalFrame) -> list[Finding]:
    """Check rate and place of the positions that a rover's drive estimates. Opens and closes the drive."""
    came: list[float] = []
    place = Point()
    try:
        drive = opened(settings, links, frame)
    except Unready as error:
        return [Finding.of("position", error)]
    try:
        for i in range(_STEPS):
            drive.ask(i * _STEP)
            links.wait(_STEP)
            now = i * _STEP
            drive.read(now)
            for pose, _ in drive.fixes():
                came.append(now)
                place = pose.position
            if came and now - came[0] >= _WATCHED:
                break
    except Unready as error:
        return [Finding.of("position", error)]
    finally:
        drive.close(standing=True)
    if not came:
        hint = "check that the rover's EKF has position and heading, or give the car a position feed"
        return [Finding("position", "fail", f"the rover has not reported its position for {now:.0f} s", "10 Hz", hint)]
    return [_arriving(settings, came, 0.0, now), _placed(place, fence)]


def _placed(p: Point, fence: Box) -> Finding:
    where = f"({p.x:.2f}, {p.y:.2f}) m"
    if not inside(fence, p):
        hint = "check that the base station has the fleet's origin, and tracks this robot's markers"
        return Finding("place", "fail", where, "inside the geofence", hint)
    return Finding("place", "ok", f"{where}, inside the geofence")


def _arriving(settings: CarSettings, came: list[float], oldest: float, end: float) -> Finding:
    """Check rate, age and gaps of position samples.

    Times in seconds. `came`: arrival of each sample; `oldest`: largest age; `end`: end of the check."""
    rate = sum(t > came[0] for t in came) / max(end - came[0], _STEP)
    gap = max(b - a for a, b in pairwise([*came, end]))
    found = f"{rate:.0f} Hz on {settings.position}, {oldest * 1e3:.0f} ms old, longest gap {gap:.2f} s"
    wanted = f"{LEAST_RATE:g} Hz or more, none older than {STALE:g} s"
    if gap + oldest > STALE:
        return Finding(
            "position", "fail", found, wanted, "the car brakes at each gap: check the base station's network"
        )
    if rate < LEAST_RATE:
        return Finding("position", "warn", found, wanted, "the car drives less exactly: raise the base station's rate")
    return Finding("position", "ok", found)
