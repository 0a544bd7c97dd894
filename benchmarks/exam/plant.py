"""Motion of the true arm: own forward dynamics, LuGre friction, soft gears, and a drive that knows only the nominal arm.

Friction is C. Canudas de Wit et al. (1995), doi:10.1109/9.376053, with the bristle stepped implicitly. The drive closes its
loop on the motor's encoder at its control instants and holds its torque between them.
"""

from __future__ import annotations

import numba
import numpy as np

from benchmarks.exam.dynamics import inertia_matrix, joint_torque, place, solve
from benchmarks.exam.records import (
    ANGLE_DRAG,
    CREEP,
    CROSS_DRAG,
    DENT,
    EXPONENTIAL,
    GREASE,
    HALF_SINE,
    HOSE,
    LAGGED_DRAG,
    POWER_LAW,
    SLOSH,
    TRAPEZOID,
)


@numba.njit(cache=True)
def reading(joint, angle):
    """Encoder reading of an angle, rad."""
    phase = joint.wobble_cycles * angle + joint.wobble_phase
    return angle + joint.encoder_offset + joint.wobble * (np.sin(phase) + joint.wobble_second * np.sin(2.0 * phase))


@numba.njit(cache=True)
def speed_friction(joint, v):
    """Speed-dependent friction beyond the proportional part, N m."""
    if joint.speed_torque == 0.0:
        return 0.0
    s = abs(v)
    if joint.speed_shape == POWER_LAW:
        size = s**joint.speed_power
    elif joint.speed_shape == GREASE:
        size = np.arcsinh(s / joint.speed_knee) / np.arcsinh(1.0 / joint.speed_knee)
    else:
        size = (s * s + joint.speed_knee * s**3) / (1.0 + joint.speed_knee)
    return np.sign(v) * joint.speed_torque * size


@numba.njit(cache=True)
def dry_level(joint, q, v, load):
    """Level of dry friction, N m, before the effect of temperature."""
    level = joint.coulomb + joint.asymmetry * np.tanh(v / 2e-3)
    if joint.stiction != 0.0:
        ratio = abs(v) / joint.stribeck_velocity
        if joint.stribeck_shape == EXPONENTIAL:
            level += joint.stiction * np.exp(-(ratio**joint.stribeck_power))
        else:
            level += joint.stiction / (1.0 + ratio**joint.stribeck_power)
    if joint.load_share != 0.0:
        level += joint.load_share * joint.load_scale * (abs(load) / joint.load_scale) ** joint.load_power
    if joint.strange == DENT:
        level += joint.a * np.exp(-(((q - joint.c) / joint.b) ** 2))
    return max(level, 0.02 * joint.coulomb)


@numba.njit(cache=True)
def gear_torque(joint, twist, rate):
    """Torque through a soft gear or one with a gap, N m. The gap has sharp sides; a gear may stiffen with load."""
    if joint.gap > 0.0:
        if abs(twist) <= joint.gap:
            return 0.0
        twist -= np.sign(twist) * joint.gap
    return joint.stiffness * twist * (1.0 + joint.stiffening * twist * twist) + joint.gear_damping * rate


@numba.njit(cache=True)
def coupled_drag(joint, w, old, dt):
    """Drag, N m, and bristle, rad, of a motor that another joint turns too, at its summed speed w.

    Bristles with extra breakaway friction, plus a power of w.
    """
    stiffness = joint.couple_coulomb / joint.couple_width
    most = joint.couple_width * (1.0 + joint.couple_rise * np.exp(-abs(w) / 0.08))
    new = (old + w * dt) / (1.0 + abs(w) * dt / most)
    drag = stiffness * new + 0.2 * np.sqrt(stiffness * joint.rotor) * (new - old) / dt
    return drag + np.sign(w) * joint.couple_viscous * abs(w) ** joint.couple_power, new


@numba.njit(cache=True)
def on_joint(joint, q, v, acceleration, other_v, state, dt):
    """Torque on the link besides that of the gear, N m; steps the state (2,) of laws with memory."""
    out = 0.0
    if joint.spring != 0.0:
        x = q - joint.spring_rest
        out -= joint.spring * x * (1.0 + joint.spring_hardening * x * x)
    if joint.ripple != 0.0:
        phase = joint.ripple_cycles * q + joint.ripple_phase
        out += joint.ripple * (np.sin(phase) + joint.ripple_second * np.sin(2.0 * phase))
    out += joint.mesh * np.sin(joint.mesh_cycles * q + joint.mesh_phase)
    kind = joint.strange
    if kind == HOSE:
        state[0] = (state[0] + v * dt / joint.b) / (1.0 + abs(v) * dt / joint.b * abs(state[0]))
        out -= joint.a * state[0] + joint.c * (q - joint.d)
    elif kind == SLOSH:
        state[1] += dt * (-acceleration - joint.b * (2.0 * joint.c * state[1] + joint.b * state[0]))
        state[0] += dt * state[1]
        out += joint.a * joint.b * joint.b * state[0]
    elif kind == CREEP:
        state[0] += dt * (q - joint.d - state[0]) / joint.b
        out -= joint.a * (q - joint.d - state[0])
    elif kind == CROSS_DRAG:
        out -= joint.a * np.tanh(other_v / joint.c)
    elif kind == ANGLE_DRAG:
        out -= joint.a * v * np.sin(joint.b * q + joint.c)
    elif kind == LAGGED_DRAG:
        state[0] += dt * (v - state[0]) / joint.b
        out -= joint.a * state[0]
    return out


@numba.njit(cache=True)
def delivered(joint, wanted):
    """Torque that the drive delivers for a wanted one: a flat limit, approached over the share `knee` of it."""
    size = abs(wanted)
    start = joint.limit * (1.0 - joint.knee)
    if size <= start:
        return wanted
    if joint.knee == 0.0:
        return np.sign(wanted) * joint.limit
    return np.sign(wanted) * (start + (joint.limit - start) * np.tanh((size - start) / (joint.limit - start)))


@numba.njit(cache=True)
def pushed(force, t, out):
    """Write the force on the last link at t s into `out` (3,)."""
    phase = (t - force.start) / force.duration
    window = 0.0
    if 0.0 < phase < 1.0:
        if force.shape == HALF_SINE:
            window = np.sin(np.pi * phase)
        elif force.shape == TRAPEZOID:
            window = min(1.0, 5.0 * min(phase, 1.0 - phase))
        else:
            window = 1.0 - abs(2.0 * phase - 1.0)
    for a in range(3):
        out[a] = force.pull[a] * (1.0 + force.sway * np.sin(0.7 * t)) + force.touch[a] * window


@numba.njit(cache=True)
def simulate(chain, gravity, joints, force, ambient, warm, q_ref, dq_ref, tau_ff, hold, dt, t_begin):
    """Follow q_ref dq_ref (K, n) with feed-forward tau_ff (K, n), each held for `hold` steps of dt s.

    The log's t = 0 is at t_begin. Returns q dq (K hold, n) of the links, tau (K hold, n) delivered, and temperature (K, n)
    degC, starting from `warm` (n,).
    """
    count, n = q_ref.shape
    total = count * hold
    q_out, dq_out, tau_out = np.empty((total, n)), np.empty((total, n)), np.empty((total, n))
    temperature = np.empty((count, n))
    turn, inertia = np.empty((n, 3, 3)), np.empty((n, 3, 3))
    origin, z, centre = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    m, factor, h, right, ddq = np.empty((n, n)), np.empty((n, n)), np.empty(n), np.empty(n), np.zeros(n)
    zero, push = np.zeros(n), np.empty(3)
    q, dq = np.empty(n), np.zeros(n)
    motor, d_motor = np.empty(n), np.zeros(n)
    bristle, common, integral, memory = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros((n, 2))
    load, tau, heat, wanted = np.zeros(n), np.zeros(n), warm.copy(), 0.0
    for j in range(n):
        # the encoder reads the reference; the offset is small, so one fixed-point step is enough
        q[j] = q_ref[0, j] - (reading(joints[j], q_ref[0, j]) - q_ref[0, j])
        motor[j] = q[j]
        memory[j, 0] = q[j] - joints[j].d if joints[j].strange == CREEP else 0.0
        load[j] = tau_ff[0, j]
    k = 0
    for instant in range(count):
        for j in range(n):
            joint = joints[j]
            seen = reading(joint, motor[j])
            error = q_ref[instant, j] - seen
            wanted = tau_ff[instant, j] + joint.kp * error + joint.kd * (dq_ref[instant, j] - d_motor[j]) + integral[j]
            tau[j] = delivered(joint, wanted)
            if abs(tau[j]) < 0.98 * joint.limit:
                integral[j] += joint.ki * error * dt * hold
            # friction power grows with speed; `heating` is the rise at a steady 0.5 rad/s
            heat[j] += dt * hold * (joint.heating * abs(d_motor[j]) / 0.5 + ambient - heat[j]) / joint.heat_time
            temperature[instant, j] = heat[j]
        for _ in range(hold):
            place(chain, q, turn, origin, z, centre, inertia)
            inertia_matrix(chain[3], origin, z, centre, inertia, m)
            pushed(force, k * dt - t_begin, push)
            joint_torque(gravity, push, chain[3], origin, z, centre, inertia, dq, zero, h)
            for j in range(n):
                joint = joints[j]
                soft = joint.stiffness > 0.0
                v = d_motor[j]
                warmth = 1.0 - joint.warm_drop * (1.0 - np.exp(-(heat[j] - ambient) / joint.warm_rise))
                level = warmth * dry_level(joint, q[j], v, load[j])
                # bristle: ds = v dt - |v| dt s/s_max |s/s_max|^(p-1), implicit in s; s_max = level over the stiffness of the bristles
                stiffness = joint.coulomb / joint.width
                most = level / stiffness
                ease = abs(bristle[j] / most) ** (joint.bristle_power - 1.0) if joint.bristle_power != 1.0 else 1.0
                old = bristle[j]
                bristle[j] = (old + v * dt) / (1.0 + abs(v) * dt / most * ease)
                drag = stiffness * bristle[j] + joint.bristle_damping * (bristle[j] - old) / dt
                drag += warmth * (joint.viscous * v + speed_friction(joint, v))
                other = 0.0
                if joint.strange == CROSS_DRAG:
                    other = dq[int(joint.b)]
                beside = on_joint(joint, q[j], dq[j], ddq[j], other, memory[j], dt)
                if soft:
                    through = gear_torque(joint, motor[j] - q[j], d_motor[j] - dq[j])
                    d_motor[j] += dt * (tau[j] - drag - through) / joint.rotor
                    motor[j] += dt * d_motor[j]
                    right[j] = through + beside - h[j]
                    load[j] = through
                else:
                    right[j] = tau[j] - drag + beside - h[j]
                    load[j] = tau[j] - drag - joint.rotor * ddq[j]
                    m[j, j] += joint.rotor
            for j in range(1, n):
                ratio = joints[j].couple_ratio
                if ratio != 0.0:
                    drag, common[j] = coupled_drag(joints[j], dq[j] + ratio * dq[j - 1], common[j], dt)
                    share = joints[j].couple_inertia
                    right[j] -= drag
                    right[j - 1] -= ratio * drag
                    m[j, j] += share
                    m[j, j - 1] += ratio * share
                    m[j - 1, j] += ratio * share
                    m[j - 1, j - 1] += ratio * ratio * share
            factor[:] = m
            solve(factor, right, ddq)
            for j in range(n):
                q_out[k, j], dq_out[k, j], tau_out[k, j] = q[j], dq[j], tau[j]
                dq[j] += dt * ddq[j]
                q[j] += dt * dq[j]
                if joints[j].stiffness == 0.0:
                    motor[j], d_motor[j] = q[j], dq[j]
            k += 1
    return q_out, dq_out, tau_out, temperature
