"""Record the files in logs/samples/ again: `python tests/logs/record_samples.py`. All of them come from simulated arms."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from calib.excitation.fourier import Basis, random_fourier
from logs import Recorder
from logs.recording import INFO
from sim.arm import Arm, load_arm
from sim.joint_state import JointState
from sim.plant import Plant

FOLDER = Path(__file__).resolve().parent.parent.parent / "logs" / "samples"
HOME = np.array([0.0, -1.4, 1.3, -1.4, -1.2, 0.3])
RATE = 100.0
SKEW = 40e-6  # of the host clock against the device clock
WALL = 1_767_225_600 * 10**9  # 2026-01-01


def driven(arm: Arm, seconds: float, seed: int) -> list[tuple[JointState, np.ndarray, np.ndarray]]:
    """States and commands (q, dq) of a Fourier motion at a third of the arm's speed."""
    basis = Basis(5, seconds)
    motion = random_fourier(basis, HOME, np.random.default_rng(seed))
    speed = np.abs(basis.matrix(np.linspace(0, seconds, 400), 1) @ motion.x.T).max(axis=0)
    way = motion.scaled(arm.dq_max / 3 / speed).sampled(RATE)
    plant = Plant(arm, seed=seed)
    plant.reset(HOME)
    rng = np.random.default_rng(seed)
    out = []
    for k in range(len(way)):
        state = plant.read(t=plant.time * (1 + SKEW) + 3e-4 + rng.exponential(1e-4))
        plant.command(way.q[k], way.dq[k], np.zeros(arm.n))
        out.append((state, way.q[k], way.dq[k]))
        plant.advance(1 / RATE)
    return out


def recorded(path: Path, arm: Arm, samples: list[tuple[JointState, np.ndarray, np.ndarray]]) -> Recorder:
    path.unlink(missing_ok=True)
    recorder = Recorder(
        path, arm.joint_names, {"arm": arm.name, "driver": "sim.plant", "motion": "excitation"}, wall_clock=lambda: WALL
    )
    recorder.event(INFO, "motion", "excitation starts", 0.0)
    for state, q, dq in samples:
        recorder.write(state, q, dq, np.full(arm.n, np.nan))
    return recorder


def main() -> int:
    """Write a finished recording, one whose program was killed in the middle of a sample, and a CSV file in ur_rtde's form."""
    FOLDER.mkdir(exist_ok=True)
    servo = load_arm("servo6")
    samples = driven(servo, 8.0, seed=1)
    recorded(FOLDER / "servo6_excitation.mcap", servo, samples).close()
    killed = recorded(FOLDER / "servo6_killed.mcap", servo, samples[:120])
    journal = (FOLDER / "servo6_killed.mcap").read_bytes()
    killed.close("this copy is not kept")
    (FOLDER / "servo6_killed.mcap").write_bytes(journal[:-100])
    stems = ("actual_q", "actual_qd", "actual_current")
    rows = [",".join(["timestamp", *(f"{stem}_{j}" for stem in stems for j in range(6))])]
    for state, _, _ in driven(load_arm("ur10e"), 6.0, seed=2):
        values = [100 + state.t_device, *state.q, *state.dq, *state.current]
        rows.append(",".join(f"{value:.4f}" for value in values))
    (FOLDER / "ur10e_ur_rtde.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
