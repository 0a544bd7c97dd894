"""The public recordings of real arms, and the facts given for each."""

from __future__ import annotations

from dataclasses import dataclass

from sim.arm import load_arm


@dataclass(frozen=True)
class Set:
    """Recordings of one arm.

    new: words after `calib`, with DATA for the recordings' folder. train, test: (file, from s, to s). cutoff: Hz. reference:
    N m per joint, empty if none is published. columns: meaning of columns whose names do not state it. assume: words for
    `--assume`. identify: further words for `calib identify`.
    """

    new: tuple[str, ...]
    train: tuple[tuple[str, float, float], ...]
    test: tuple[tuple[str, float, float], ...]
    cutoff: float
    reference: tuple[float, ...] = ()
    columns: tuple[str, ...] = ()
    assume: tuple[str, ...] = ()
    identify: tuple[str, ...] = ()


ALL = (0.0, 1e9)
UR10E = load_arm("ur10e").torque_constant
GEOMETRY = ("arm", "new", "--geometry-only")
DRIVE = ("arm", "drive")
DAMIAO = "damiao/20260425_{}_identify-all__group_01__motor_0{}.csv"
SETS: dict[str, Set] = {
    "ur10e": Set(
        (),
        tuple((f"ur10e/excitation_{x}.csv", *ALL) for x in ("20s_8h", "20s_10h", "30s_12h", "40s_12h")),
        tuple((f"ur10e/excitation_{x}.csv", *ALL) for x in ("20s_5h", "50s_12h", "free_b")),
        8.0,
        tuple(a * k for a, k in zip((0.352, 0.338, 0.195, 0.063, 0.079, 0.054), UR10E, strict=True)),
    ),
    "panda": Set(
        ("arm", "new", "DATA/panda/panda.urdf", "--tool", "panda_hand", "--numbers", "cad", "--torque-at", "joint",
         "--limit", "ddq_max=15,7.5,10,12.5,15,20,20", "--limit", "jerk_max=7500,3750,5000,6250,7500,10000,10000"),
        (("panda/excitation_0_15s.csv", 0.0, 10.0),),
        (("panda/excitation_0_15s.csv", 10.0, 1e9),),
        15.0,
        (0.268, 0.270, 0.246, 0.189, 0.072, 0.051, 0.056),
    ),
    "rokae": Set(
        (*GEOMETRY, "DATA/rokae/kinematics.urdf", "--torque-at", "joint", "--limit", "q_min=-3.05", "--limit", "q_max=3.05",
         "--limit", "dq_max=2.1,2.1,2.1,2.1,3.1,3.1,3.1", "--limit", "tau_max=85,85,85,85,36,36,36"),
        (("rokae/rokae1.csv", 0.0, 14.0),),
        (("rokae/rokae1.csv", 14.0, 1e9),),
        10.0,
        (0.410, 1.453, 0.245, 0.550, 0.133, 0.207, 0.221),
    ),
    "sh_electric": Set(
        (*GEOMETRY, "DATA/sh_electric/kinematics.urdf", "--limit", "q_min=-6.28", "--limit", "q_max=6.28", "--limit", "dq_max=3.14",
         "--limit", "tau_max=200,200,120,60,60,40"),
        (("sh_electric/traj1.csv", 0.0, 16.0), ("sh_electric/traj2.csv", 0.0, 16.0)),
        (("sh_electric/traj1.csv", 16.0, 1e9), ("sh_electric/traj2.csv", 16.0, 1e9)),
        6.0,
        (2.18, 5.61, 3.38, 1.90, 1.20, 0.545),
    ),
    "ur5e_joint": Set(
        (*DRIVE, "ur5e_joint5", "--load", "unknown", "--limit", "q_min=-6.28", "--limit", "q_max=6.28", "--limit", "dq_max=3.14",
         "--limit", "tau_max=28"),
        (("ur5e_joint/joint_5.csv", 0.0, 0.6),),
        (("ur5e_joint/joint_5.csv", 0.6, 1.0),),
        8.0,
    ),
    **{
        f"damiao_{motor}": Set(
            (*DRIVE, name, "--limit", "q_min=-12.5", "--limit", "q_max=12.5", "--limit", f"dq_max={speed}", "--limit", f"tau_max={torque}"),
            ((DAMIAO.format("085915", motor), *ALL),),
            ((DAMIAO.format("155213", motor), *ALL),),
            8.0,
        )
        for motor, name, speed, torque in ((1, "dm8009", 16, 40), (3, "dm4340", 5.4, 27), (5, "dm4310", 20, 7))
    },
    "servo_pendulum": Set(
        (*DRIVE, "xl330", "--load", "0.49,0.1", "--limit", "q_min=-3.14", "--limit", "q_max=3.14", "--limit", "dq_max=6",
         "--limit", "tau_max=0.5"),
        (("servo_pendulum/xl330__sin_sin__m0.49_l0.1_kp400__2026-01-15_10h29m14.csv", *ALL),
         ("servo_pendulum/xl330__sin_time_square__m0.49_l0.1_kp400__2026-01-15_10h29m37.csv", *ALL)),
        (("servo_pendulum/xl330__up_and_down__m0.49_l0.1_kp400__2026-01-15_10h29m29.csv", *ALL),),
        8.0,
        (),
        ("time=t:s", "q=q1:rad", "dq=dq1:rad/s", "current=load_raw:mA"),
        ("current=int16",),
        ("--known-mass", "0.49"),
    ),
}  # fmt: skip
