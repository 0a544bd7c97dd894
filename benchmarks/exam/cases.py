"""List of the cases, and how one is made: a pure function of the exam's seed and the case's number."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.exam import motions
from benchmarks.exam.arms import HARDWARE, write_model
from benchmarks.exam.effects import EFFECTS
from benchmarks.exam.hidden import Hidden
from benchmarks.exam.recording import sample, write
from benchmarks.exam.severity import LEAST, TARGET, Balance, hide, rows
from benchmarks.exam.true_arm import AMBIENT, TrueArm, build, feed_forward, run
from benchmarks.exam.true_model import write_true
from benchmarks.exam.unknowns import UNKNOWNS

# kinds of fifty cases in a row, in an order that keeps any shorter exam balanced
_ROUND = "csscpscusscsscpscstscsucspsccsscsucspcsscspcuscsspc"
KINDS = {"c": "clean", "s": "single", "p": "pair", "t": "triple", "u": "unknown"}
ARMS = tuple(HARDWARE)
# pairs that look alike: half of all pairs are drawn from here, on one joint if both are joint effects
CONFUSABLE = (
    ("coulomb_friction", "load_dependent_friction"), ("viscous_friction", "nonlinear_viscous_friction"),
    ("stribeck_friction", "presliding_friction"), ("torque_gain", "link_inertia"), ("torque_offset", "asymmetric_friction"),
    ("joint_spring", "torque_ripple"), ("payload", "base_tilt"), ("tool_force", "base_tilt"), ("joint_elasticity", "time_delay"),
    ("rotor_inertia", "joint_elasticity"), ("viscous_friction", "thermal_friction"), ("encoder_offset", "torque_offset"),
    ("external_contact", "torque_saturation"), ("payload", "tool_force"), ("backlash", "time_delay"),
    ("transmission_coupling", "coulomb_friction"),
)  # fmt: skip
PAUSE = 20  # s between the logs of a session
BY_NAME = {e.name: e for e in EFFECTS}


@dataclass(frozen=True)
class Case:
    """Definition of a case: number, kind, arm, severity, whether it is of the harder third, seed of its draws, effects."""

    number: int
    kind: str
    arm: str
    severity: int
    hard: bool
    seed: int
    chosen: tuple[tuple[str, int], ...]

    @property
    def name(self) -> str:
        """case_000 ..."""
        return f"case_{self.number:03d}"


def listed(count: int, seed: int) -> list[Case]:
    """The first `count` cases of the exam with that seed; a longer exam begins with the shorter one."""
    seen = dict.fromkeys(KINDS.values(), 0)
    out = []
    for number in range(count):
        kind = KINDS[_ROUND[number % len(_ROUND)]]
        rank, seen[kind] = seen[kind], seen[kind] + 1
        rng = np.random.default_rng([seed, number])
        arm = ARMS[(rank + rank // 24) % 3]
        severity = 1 + int(rng.integers(3))
        hard = bool(rng.uniform() < 1 / 3)
        out.append(Case(number, kind, arm, severity, hard, int(rng.integers(2**31)), _chosen(kind, rank, seed, rng)))
    return out


def _chosen(kind: str, rank: int, seed: int, rng: np.random.Generator) -> tuple[tuple[str, int], ...]:
    """Hidden effects, (effect, joint index), joint -1 for the whole arm. Singles and unknowns cycle through their lists."""
    if kind == "clean":
        return ()
    if kind in ("single", "unknown"):
        pool = EFFECTS if kind == "single" else UNKNOWNS
        order = np.random.default_rng([seed, rank // len(pool), len(pool)]).permutation(len(pool))
        effect = pool[order[rank % len(pool)]]
        return ((effect.name, _joint(effect, rng)),)
    if kind == "pair" and rank % 2:
        a, b = CONFUSABLE[int(rng.integers(len(CONFUSABLE)))]
        first, second = BY_NAME[a], BY_NAME[b]
        common = sorted(set(first.joints) & set(second.joints))
        j = int(rng.choice(common)) if common else -1
        return tuple((e.name, j if e.joints and common else _joint(e, rng)) for e in (first, second))
    picked = rng.choice(len(EFFECTS), 3 if kind == "triple" else 2, replace=False)
    return tuple((EFFECTS[k].name, _joint(EFFECTS[k], rng)) for k in picked)


def _joint(effect: Hidden, rng: np.random.Generator) -> int:
    return int(rng.choice(effect.joints)) if effect.joints else -1


def make(case: Case, folder: Path) -> None:
    """Write the case into `folder`: arm.xml, four recordings, the true arm and, last, truth.json.

    The recordings are friction.mcap, excitation.mcap, validation.mcap and final.mcap.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(case.seed)
    hardware = HARDWARE[case.arm]
    nominal = write_model(case.arm, folder / "arm.xml")
    home = motions.draw_home(rng)
    plan = _plan(rng, home, hardware.speed, hardware.control_period)
    arm = build(case.arm, nominal.tree, nominal.tau_max, hardware, home, rng, case.hard)
    arm.peak = np.abs(feed_forward(arm, plan["excitation"])).max(axis=0)
    effects = _hide(case, arm, plan, rng)

    warm, session = np.full(6, AMBIENT), 3600 * case.number
    for name, reference in plan.items():
        here = arm if name == "excitation" else _untouched(arm)
        happened = run(here, reference, motions.SETTLE, warm)
        samples = sample(here, happened, rng)
        write(folder / f"{name}.mcap", samples, nominal.joint_names, session)
        warm = AMBIENT + (happened.temperature[-1] - AMBIENT) * np.exp(-PAUSE / arm.joints["heat_time"])
        session += round(reference.duration) + PAUSE
    severity = min((e["severity"] for e in effects), default=case.severity)
    write_true(arm, nominal, effects, folder / "true")
    answer = {
        "arm": case.arm,
        "severity": severity,
        "hard": case.hard,
        "kind": case.kind,
        "effects": effects,
    }
    (folder / "truth.json").write_text(json.dumps(answer, indent=1) + "\n", encoding="utf-8")


def _plan(rng: np.random.Generator, home: np.ndarray, speed: float, period: float) -> dict[str, motions.Reference]:
    return {
        "friction": motions.friction_motion(rng, home, speed, period),
        "excitation": motions.fourier_motion(rng, home, speed, 16.0, 5, period),
        "validation": motions.fourier_motion(rng, home, speed, 11.0, 4, period),
        "final": motions.fourier_motion(rng, home, speed, 10.0, 5, period),
    }


def _hide(case: Case, arm: TrueArm, plan: dict[str, motions.Reference], rng: np.random.Generator) -> list[dict]:
    """Dose every chosen effect on the arm without any, then put all of them in."""
    pool = {e.name: e for e in (UNKNOWNS if case.kind == "unknown" else EFFECTS)}
    if not case.chosen:
        return []
    balance, out = Balance(arm.copy(), (plan["friction"], plan["excitation"]), rows), []
    for name, j in case.chosen:
        effect, form = pool[name], int(case.hard)
        spread = float(np.exp(0.2 * rng.standard_normal()))
        # if the motions cannot show the effect at any plausible dose, hide it at another joint
        for joint in (j, *rng.permutation([k for k in effect.joints if k != j])[:2].tolist()):
            seed = int(rng.integers(2**31))
            dose, seen = balance.dose(effect, joint, case.severity, form, seed, spread)
            if seen >= LEAST * TARGET[1]:
                break
        parameters = hide(effect, arm, joint, dose, form, seed)
        # the severity requested, or less if the arm's motions show less of the effect
        fits = min(case.severity, max([s for s in (2, 3) if seen >= 0.7 * TARGET[s]], default=1))
        if case.kind == "unknown":
            name, parameters = "unknown", {"form": name}
        where = arm.joint_names[joint] if joint >= 0 else None
        out.append({"effect": name, "joint": where, "parameters": parameters, "severity": fits, "rho": round(seen, 3)})
    return out


def _untouched(arm: TrueArm) -> TrueArm:
    out = arm.copy()
    out.force["touch"] = 0.0
    return out
