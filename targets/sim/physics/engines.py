"""Factory of contact engines.

PyBullet (bullet.py) or MuJoCo (mujoco_engine.py), each imported only when chosen."""

from __future__ import annotations

from targets.sim.base.scenario import PYBULLET
from targets.sim.physics.contacts import Engine, choose


def make(wanted: str, step: float, friction: float = 1.0, gui: bool = False) -> Engine:
    """Return a new engine with steps of `step` seconds. `friction` multiplies that of the floor.

    Raises NoEngine and NoWindow."""
    if choose(wanted) == PYBULLET:
        from targets.sim.physics.bullet import Bullet

        return Bullet(step, friction, gui)
    from targets.sim.physics.mujoco_engine import Mujoco

    return Mujoco(step, friction, gui)
