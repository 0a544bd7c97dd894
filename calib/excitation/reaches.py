"""How far a joint can be swept about a posture while the others stand: for friction sweeps and for the choice of a home."""

from __future__ import annotations

import itertools

import numpy as np

from calib.excitation.nearness import CLEARANCE_MARGIN
from calib.excitation.room import Room
from safety.parameters import missing_facts
from sim.errors import AnswerIsNo
from sim.trajectory import Trajectory

# rad to either side that are tried for a sweep, of a joint with a range of WHOLE or more; scaled down for a smaller range
REACHES, WHOLE = (1.2, 0.9, 0.6, 0.4, 0.25, 0.12), 2.0
# shares of the speeds that are tried; the second set if the first leaves no sweep, as with a dq_max from which the arm cannot
# stop within its range
SLOWER = ((1.0, 0.7, 0.5, 0.35), (0.2, 0.1, 0.05, 0.025, 0.012, 0.006, 0.003))
# share of dq_max: as fast as the sweeps of an ordinary session
FAST = 0.25


def sweep_range(room: Room, home: np.ndarray, j: int, speeds: np.ndarray) -> tuple[float, float, np.ndarray]:
    """Ends, rad, and speeds, rad/s, of the widest sweep of joint j from `home` that fits; AnswerIsNo if the least does not."""
    arm = room.arm
    missing, held, move = "", "a body near it", ""
    reaches = np.array(REACHES) * min(1.0, (arm.q_max[j] - arm.q_min[j]) / WHOLE)
    for shares, reach in itertools.product(SLOWER, reaches.tolist()):
        low = max(home[j] - reach, arm.q_min[j] + 0.05 * (arm.q_max[j] - arm.q_min[j]))
        high = min(home[j] + reach, arm.q_max[j] - 0.05 * (arm.q_max[j] - arm.q_min[j]))
        line = np.repeat(home[None], 80, axis=0)
        line[:, j] = np.linspace(low, high, 80)
        if room.nearness.clearances(line)[0].min() < CLEARANCE_MARGIN:
            continue
        for slower in shares:
            dq = np.zeros_like(line)
            dq[:, j] = slower * speeds.max()
            step = (high - low) / 79 / dq[0, j]
            use = room.use(Trajectory(np.arange(80) * step, line, dq, np.zeros_like(line)))
            if use.fits:
                return float(low), float(high), slower * speeds
            held = f"the {use.worst[0]} limit"
            if use.worst[0] == "torque":
                missing = missing_facts(arm, int(np.argmax(use.shares["torque"])))
    still = room.use(Trajectory(np.arange(80.0), line, np.zeros_like(line), np.zeros_like(line)))  # over the smallest reach
    if still.clearance < CLEARANCE_MARGIN:
        held = f"{still.pair[0]} near {still.pair[1]}"
        move = next((f", or move {o.name}" for o in room.cell.table.obstacles if o.name in still.pair), "")
    raise AnswerIsNo(
        f"{arm.joint_names[j]}: at the start {np.round(home, 3).tolist()} rad it has less than {reaches[-1]:.2g} {'m' if arm.tree.prismatic[j] else 'rad'} "
        f"to either side; {held} restricts it: give another start with --home{move}{missing}"
    )


def sweepable(room: Room, home: np.ndarray) -> bool:
    """Whether every joint can be swept from `home`."""
    try:
        for j, speed in enumerate(FAST * room.arm.dq_max):
            sweep_range(room, home, j, np.array([speed]))
    except AnswerIsNo:
        return False
    return True
