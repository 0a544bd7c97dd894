"""From recordings to parameters: the time it takes, and what the identified model gains a controller."""

from __future__ import annotations

import csv
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.known_truth import fitting_motion, recorded_on_mock, varied
from calib.identification.calibrated import write_calibrated
from calib.identification.identify import identify
from calib.validation.validate import validate
from logs import read_log
from sim.arm import Arm, load_arm
from sim.plant import Plant
from sim.trajectory import Trajectory


def run() -> list[dict[str, Any]]:
    """Rows of the table. Includes the real recordings if ARM_CALIB_DATA is set."""
    return [*_csv(), _mock_speed(), *_control(), _forward(), *_real()]


def _csv() -> list[dict[str, Any]]:
    arm = load_arm("ur10e")
    motion = fitting_motion(arm, 1, 190.0)
    log = recorded_on_mock(varied(arm, 1), arm, motion, 1)
    with tempfile.TemporaryDirectory() as place:
        file = Path(place) / "long.csv"
        kinds = (("actual_q", log.q), ("actual_qd", log.dq), ("actual_current", log.current))
        with file.open("w", newline="") as stream:
            writer = csv.writer(stream)
            writer.writerow(["timestamp", *[f"{k}_{j}" for k, _ in kinds for j in range(arm.n)]])
            writer.writerows(np.column_stack([log.t, *[x for _, x in kinds]]).tolist())
        began = time.process_time()
        read = read_log(file, arm.joint_names)
        middle = time.process_time()
        identify(arm, [read])
        ended = time.process_time()
    what = f"{len(read):,} CSV samples to parameters, CPU"
    return [_row(what, ended - began, "s", "< 5", f"reading {middle - began:.2g} s, identifying {ended - middle:.2g} s")]


def _mock_speed() -> dict[str, Any]:
    arm = load_arm("ur10e")
    motion, nothing = fitting_motion(arm, 1, 10.0), np.zeros(6)
    plant = Plant(arm)
    plant.reset(motion.q[0])
    began = time.process_time()
    for q, dq in zip(motion.q, motion.dq, strict=True):
        plant.command(q, dq, nothing)
        plant.read()
        plant.advance(0.002)
    seconds = time.process_time() - began
    return _row(
        "mock: control cycles of 2 ms a second of CPU", len(motion) / seconds, "1/s", "", f"{10 / seconds:.1f} times real time"
    )


def _control() -> list[dict[str, Any]]:
    """Feed-forward and computed torque on an unseen motion, with the nominal, the identified and the true model."""
    nominal = load_arm("ur10e")
    truth = varied(nominal, 3, 0.15)
    logs = [recorded_on_mock(truth, nominal, fitting_motion(nominal, seed), seed) for seed in (1, 2)]
    found = identify(nominal, logs).arm
    motion = fitting_motion(nominal, 8, 10.0)
    rows = []
    for kind, bandwidth in (("feed-forward, 3 Hz feedback", 3.0), ("computed torque, 1 Hz feedback", 1.0)):
        errors = [tracking(truth, drive, motion, bandwidth, computed=kind[0] == "c") for drive in (nominal, found, truth)]
        text = ", ".join(f"{name} {1e3 * e:.3g}" for name, e in zip(("nominal", "identified", "true"), errors, strict=True))
        note = f"RMS over the joints, mrad: {text} model"
        rows.append(_row(f"{kind}: tracking error, identified / nominal model", errors[1] / errors[0], "", "< 1", note))
    return rows


def tracking(truth: Arm, known: Arm, motion: Trajectory, bandwidth: float, computed: bool) -> float:
    """RMS tracking error, rad, of `truth` in MuJoCo under a controller that uses the model `known`."""
    from sim.rigid_body import RigidBody

    plant = Plant(truth)
    plant.reset(motion.q[0])
    body = RigidBody(known)
    size = RigidBody(truth).mass_matrix(motion.q[0])
    rotor, viscous, coulomb = (
        np.array([known.effect(e, j).parameters[k] for j in known.joint_names])  # type: ignore[union-attr]
        for e, k in (("rotor_inertia", "inertia"), ("viscous_friction", "viscous"), ("coulomb_friction", "coulomb"))
    )
    stiff, damp = (2 * np.pi * bandwidth) ** 2, 2 * 2 * np.pi * bandwidth
    nothing, period = np.zeros(truth.n), float(motion.t[1] - motion.t[0])
    inertia = np.diag(size) + rotor
    error = []
    for q, dq, ddq in zip(motion.q, motion.dq, motion.ddq, strict=True):
        state = plant.read()
        error.append(q - state.q)
        speed = plant.data.qvel.copy()
        push = stiff * (q - state.q) + damp * (dq - speed)
        wanted, at, rate = (ddq + push, state.q, speed) if computed else (ddq, q, dq)
        tau = body.inverse_dynamics(at[None], rate[None], wanted[None])[0] + rotor * wanted
        tau += viscous * dq + coulomb * np.tanh(dq / 0.01)
        if not computed:
            tau += inertia * push
        plant.command(q, dq, tau, nothing, nothing)
        plant.advance(period)
    return float(np.sqrt(np.mean(np.square(error))))


def _forward() -> dict[str, Any]:
    """Forward simulation of an unseen log, against its reported bound."""
    nominal = load_arm("ur5e")
    truth = varied(nominal, 105)
    logs = [recorded_on_mock(truth, nominal, fitting_motion(nominal, seed), seed) for seed in (1, 2, 3)]
    found = identify(nominal, logs[:2])
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "arm"
        arm = write_calibrated(folder, nominal, found.arm)
        found.known.write(folder, found.model)
        check = validate(arm, logs[2:]).checks[0]
    assert check.forward is not None
    assert check.bound is not None
    ratio = check.forward / check.bound
    text = " ".join(f"{1e3 * a:.2g}/{1e3 * b:.2g}" for a, b in zip(check.forward, check.bound, strict=True))
    note = f"J1..J6, mrad after 0.25 s, RMS / bound: {text}"
    return _row(
        "forward simulation of an unseen mock log over its stated bound, worst joint", float(ratio.max()), "", "<= 1", note
    )


def _real() -> list[dict[str, Any]]:
    data = os.environ.get("ARM_CALIB_DATA")
    if not data:
        return [
            _row(
                "held-out residual of the real UR10e",
                float("nan"),
                "",
                "",
                "ARM_CALIB_DATA names no folder with the recordings",
            )
        ]
    folder, arm = Path(data) / "ur10e", load_arm("ur10e")
    sets = [[read_log(folder / f"excitation_{x}.csv", arm.joint_names) for x in names] for names in (TRAINING, HELD)]
    began = time.process_time()
    found = identify(arm, *sets)
    seconds = time.process_time() - began
    gap = found.result.holdout
    assert gap is not None
    assert gap.after_ampere is not None
    newton = "/".join(f"{x:.3f}" for x in gap.after)
    return [
        _row("real UR10e, held-out residual J1..J6", "/".join(f"{x:.3f}" for x in gap.after_ampere), "A",
             "<= .370 .355 .205 .066 .083 .057", f"in N m: {newton}; {seconds:.1f} s CPU"),
    ]  # fmt: skip


TRAINING = ("20s_8h", "20s_10h", "30s_12h", "40s_12h")
HELD = ("20s_5h", "50s_12h", "free_b")


def _row(what: str, value: float | str, unit: str, bar: str = "", note: str = "") -> dict[str, Any]:
    return {"what": what, "value": value if isinstance(value, str) else f"{value:.3g}", "unit": unit, "bar": bar, "note": note}
