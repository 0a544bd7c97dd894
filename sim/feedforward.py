"""What a controller or another simulator needs to know about an arm: friction by speed, payload, gravity, actuator parameters."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

import numpy as np

from sim.arm import Arm
from sim.effects import Stage, effect_named
from sim.flange import flange_of
from sim.mjcf import full_inertia, joint_size
from sim.mjcf_edit import mounted
from sim.own_values import effort_limits
from sim.prediction import by_stage
from sim.slip import SLIP_WIDTH
from sim.torque_path import PathState

SPEEDS = 20  # in each direction, evenly up to the joint's largest speed
RUN_IN = 10.0  # rad of slip beforehand: a hundred times the longest displacement over which friction builds up


def friction_table(arm: Arm) -> list[dict[str, Any]]:
    """Rows {joint, speed rad/s, torque N m}: friction torque in steady motion of a cold gear without load.

    tau_ff = friction(dq_cmd) + inverse dynamics is the feed-forward of a drive that accepts one (MIT mode); load-dependent
    friction is left out. At rest the torque is that of the direction in which motion begins: speeds -0.0 and 0.0.
    """
    top = np.where(np.isfinite(arm.dq_max), arm.dq_max, 1.0)
    share = np.linspace(0, 1, SPEEDS + 1)[:, None]
    ways = [(-share[::-1] * top, -1.0), (share * top, 1.0)]
    dq = np.concatenate([speeds for speeds, _ in ways])
    tau = np.concatenate([_steady(arm, speeds, way) for speeds, way in ways])
    return [
        {"joint": name, "speed": float(v), "torque": float(torque)}
        for j, name in enumerate(arm.joint_names)
        for v, torque in zip(dq[:, j], tau[:, j], strict=True)
    ]


def dry_friction(arm: Arm, load: np.ndarray) -> np.ndarray:
    """(n,) N m: half the width of the band in which the torque of joints at rest under load (n,) N m may lie."""
    rest = np.zeros((2, arm.n))
    up, down = (_steady(arm, rest, way, load) for way in (1.0, -1.0))
    return np.asarray(0.5 * np.abs(up[-1] - down[-1]))


def _steady(arm: Arm, dq: np.ndarray, way: float, load: np.ndarray | float = 0.0) -> np.ndarray:
    """Friction torque (N, n) at the speeds dq (N, n) under load, after long travel in the direction `way`, 1 or -1."""
    memory: dict[Hashable, np.ndarray] = {}
    came = np.array([[-way * RUN_IN], [0.0]]) * np.ones(arm.n)
    _friction(arm, came, dq[:2], way, load, memory)
    return _friction(arm, np.zeros_like(dq), dq, way, load, memory)


def _friction(
    arm: Arm, q: np.ndarray, dq: np.ndarray, way: float, load: np.ndarray | float, memory: dict[Hashable, np.ndarray]
) -> np.ndarray:
    zero = np.zeros_like(dq)
    state = PathState(
        t=np.zeros(len(dq)), q=zero.copy(), dq=dq.copy(), ddq=zero.copy(), load=zero + load, q_motor=q, dq_motor=dq.copy(),
        ddq_motor=zero.copy(), level=zero.copy(), width=np.full_like(dq, SLIP_WIDTH), warmth=np.ones_like(dq),
        slip=np.full_like(dq, way), tau=zero.copy(), force=np.zeros((len(dq), 3)), memory=memory,
    )  # fmt: skip
    stages = by_stage(arm.effects, arm)
    for stage in (Stage.FRICTION, Stage.MOTOR):
        for effect, joint, item in stages[stage]:
            effect.apply(state, joint, item.parameters)
        if stage is Stage.FRICTION:
            state.tau += state.warmth * state.level * state.slip
    return state.tau


def payload_table(arm: Arm) -> dict[str, Any]:
    """Payload at the flange in the flange's frame, and the gravity of the mount, also as URScript lines.

    The payload is None if the model has no payload body (the links may include one). The flange is the site `attachment_site`
    of the last link if the model has it, else the last link's frame. Mass in kg, centre of mass in m, inertia in kg m^2 about
    it with axes along the flange's; gravity in m/s^2 in the base frame.
    set_target_payload(m, cog, [Ixx, Iyy, Izz, Ixy, Ixz, Iyz]) and set_gravity(d), d the acceleration away from the earth's
    centre: Universal Robots, URScript manual.
    """
    found = mounted(arm.model_text)
    place, turn, frame = flange_of(arm)
    lines = [f"set_gravity({_list(-arm.gravity)!r})"]
    payload = None
    if found is not None:
        mass, com, inertia = float(found[0]), turn.T @ (found[1] - place), turn.T @ found[2] @ turn
        tensor = _list(np.array(full_inertia(inertia)))
        lines.insert(0, f"set_target_payload({mass!r}, {_list(com)!r}, {tensor!r})")
        named = dict(zip(("xx", "yy", "zz", "xy", "xz", "yz"), tensor, strict=True))
        payload = {"frame": frame, "mass": mass, "com": _list(com), "inertia": named}
    return {"schema": "payload/1", "arm": arm.name, "payload": payload, "gravity": _list(arm.gravity), "urscript": lines}


def isaaclab_actuator(arm: Arm) -> dict[str, Any]:
    """Keyword arguments of isaaclab.actuators.ImplicitActuatorCfg (2.2 to 3.x), and the effects that this model leaves out.

    friction is the torque needed to start from rest, dynamic_friction that while moving, N m; viscous_friction N m s/rad;
    armature kg m^2 at the joint. The gains are those of the USD. Isaac Lab's delay is that of a command, which our logs do not
    show.
    """
    rows: dict[str, dict[str, float]] = {key: {} for key in ("armature", "friction", "dynamic_friction", "viscous_friction")}
    left_out: list[dict[str, str | None]] = []
    for name in arm.joint_names:
        here = [e for e in arm.effects if e.joint == name]
        forms = {(e.effect, name): effect_named(e.effect).exported(name, e.parameters, joint_size(arm, name)) for e in here}
        dry: dict[str, float] = {}
        joint: dict[str, float] = {}
        for (effect, _), form in forms.items():
            dry |= form.dry
            own = form.mjcf.joint if form.mjcf else {}
            joint |= {key: float(own[key]) for key in ("armature", "damping") if key in own}
            held = form.form == "native" and (
                {"armature", "damping", "frictionloss"} & set(own) or "excess" in form.dry or form.limit is not None
            )
            if not held:
                left_out.append({"effect": effect, "joint": name})
        level = dry.get("level", 0.0)
        for key, value in (
            ("armature", joint.get("armature", 0.0)), ("friction", level + dry.get("excess", 0.0)), ("dynamic_friction", level),
            ("viscous_friction", joint.get("damping", 0.0)),
        ):  # fmt: skip
            rows[key][name] = value
    limits: dict[str, Any] = {
        key: {name: float(v) for name, v in zip(arm.joint_names, row, strict=True) if np.isfinite(v)}
        for key, row in (("effort_limit_sim", effort_limits(arm)), ("velocity_limit_sim", arm.dq_max))
    }
    left_out += [{"effect": e.effect, "joint": None} for e in arm.effects if e.joint is None]
    actuator: dict[str, Any] = {"joint_names_expr": list(arm.joint_names), "stiffness": None, "damping": None, **rows}
    return {
        "schema": "isaaclab/1",
        "arm": arm.name,
        "actuator": actuator | {key: row or None for key, row in limits.items()},
        "left_out": left_out,
    }


def _list(row: np.ndarray) -> list[float]:
    return [float(x) + 0.0 for x in row]
