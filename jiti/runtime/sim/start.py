"""Where episodes begin beyond LIBERO's own initial states: every object moved and turned a little."""

from typing import Any

import numpy as np

from jiti.runtime.sim.world import World

JITTER_M = 0.015
"""Greatest shift along x and along y. Our choice: LIBERO's own 50 states spread by 7 to 9 mm where they vary, and some
objects do not at all."""
JITTER_RAD = 0.09
"""Greatest turn about the vertical, about 5 degrees. Our choice: books must not turn into each other."""
CLEARANCE_M = 0.004
"""What objects must keep apart after it, or what they kept apart before where that was less; those that began inside
each other, as in some of LIBERO's states, must part. Our choice."""
_DRAWS = 40
"""Draws for one object until it is free; then it stays where it was."""


def jitter(world: World, random: np.random.Generator) -> None:
    """Move and turn each object of a scene about its place, in the order of their names, into nothing else."""
    import mujoco as engine

    mujoco: Any = engine
    for name in sorted(world.names.objects):
        body = world.model.body(f"{name}_main")
        address = int(world.model.jnt_qposadr[body.jntadr[0]])
        before = world.data.qpos[address : address + 7].copy()
        others = [n for n in (*world.names.objects, *world.names.fixtures) if n != name]
        apart = {n: world.gap_m(name, n, most_m=CLEARANCE_M) or CLEARANCE_M for n in others}
        for _ in range(_DRAWS):
            shift, turn = random.uniform(-JITTER_M, JITTER_M, 2), random.uniform(-JITTER_RAD, JITTER_RAD)
            world.data.qpos[address : address + 2] = before[:2] + shift
            mujoco.mju_mulQuat(
                world.data.qpos[address + 3 : address + 7],
                np.array([np.cos(turn / 2), 0, 0, np.sin(turn / 2)]),
                before[3:],
            )
            mujoco.mj_forward(world.model, world.data)
            if all(world.gap_m(name, n, most_m=CLEARANCE_M) >= apart[n] for n in others):
                break
        else:
            world.data.qpos[address : address + 7] = before
            mujoco.mj_forward(world.model, world.data)
