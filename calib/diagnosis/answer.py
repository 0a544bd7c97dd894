"""diagnosis.json: the answer of a diagnosis as data, and the corrected arm that goes with it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from calib.claims.of_diagnosis import claims
from calib.diagnosis.candidates import Key
from calib.diagnosis.corrected import ArmChange
from calib.diagnosis.hypothesis import CONTACT
from calib.diagnosis.parameters import nominal_values, seen
from calib.diagnosis.scoring import Scored
from calib.diagnosis.selection import SearchResult
from calib.gate import GateCheck
from sim.arm import Arm, ArmEffect
from sim.arm_folder import write_arm
from sim.effects import driven_by, effect_named
from sim.effects.effect import Parameter


@dataclass
class Diagnosis:
    """The answer as data (`diagnosis.json`), the named effects, and drive limits, which no fit of torques shows.

    found: the search with its fits, which hold arrays of the recordings; steps: the best candidates at every step of it.
    """

    answer: dict[str, Any]
    accepted: tuple[ArmEffect, ...]
    found: SearchResult | None
    correction: ArmChange | None = None
    limits: tuple[ArmEffect, ...] = ()
    steps: Sequence[Sequence[Scored]] = ()

    def __post_init__(self) -> None:
        self.answer["claims"] = [claim.as_dict() for claim in claims(self.answer)]

    def without_fits(self) -> Diagnosis:
        """The same without the search, whose fits take memory."""
        return replace(self, found=None)

    def write(self, folder: Path, arm: Arm) -> None:
        """Write the corrected arm, then diagnosis.json, which refers to it.

        No arm is written if every correction was refused. A contact is an event and not part of the arm.
        """
        if self.answer["arm_out"] is not None:
            change = self.correction or ArmChange({}, ())
            stay = [e for e in (*self.accepted, *self.limits) if e.effect != CONTACT]
            why = {f"{e.effect} {e.joint or ''}".strip(): "found by calib diagnose" for e in stay}
            write_arm(folder / self.answer["arm_out"], arm, effects=change.effects, inertials=change.inertials, provenance=why)
        (folder / "diagnosis.json").write_text(json.dumps(self.answer, indent=1, allow_nan=False) + "\n")


def unusable(arm: Arm, trusted: Sequence[GateCheck]) -> Diagnosis:
    """The answer for unusable recordings; no arm is written, because nothing was corrected."""
    return Diagnosis(answer(arm, "bad_data", [], [], None, "", trusted) | {"arm_out": None}, (), None)


def answer(
    arm: Arm,
    verdict: str,
    effects: list[dict[str, Any]],
    odd: list[dict[str, Any]],
    gap: dict[str, Any] | None,
    log: str,
    trusted: Sequence[GateCheck],
) -> dict[str, Any]:
    """What diagnosis.json holds."""
    none: dict[str, list[float]] = {"noise_floor": [], "before": [], "refit": [], "after": []}
    return {
        "schema": "diagnosis/1",
        "arm": arm.name,
        "verdict": verdict,
        "effects": effects,
        "unexplained": odd,
        "gap": {"unit": "N*m", "log": log, "joints": list(arm.joint_names), **(gap or none)},
        "data_checks": [c.entry() for c in trusted],
        "arm_out": "arm",
    }


def deviation(p: Parameter, value: float, std: float, by_law: float) -> dict[str, Any]:
    """Standard deviation of a parameter, and its part due to the choice of law; None if it is not identifiable."""
    if not seen(p, value, std):
        return {"std": None, "identifiable": False}
    return {"std": float(np.hypot(np.nan_to_num(std), by_law)), **({"std_by_law": by_law} if by_law else {})}


def entry(
    arm: Arm,
    item: ArmEffect,
    std: dict[str, float],
    confidence: float,
    share: float,
    rivals: Sequence[Key] = (),
    by_law: Mapping[str, float] = MappingProxyType({}),
    written: ArmEffect | None = None,
) -> dict[str, Any]:
    """One effect as diagnosis.json has it.

    by_law: the part of each standard deviation, within `std`, due to the choice of law (calib.diagnosis.model_form).
    written: the effect in the corrected arm, which holds no lead of the reading or of friction, so other values predict best.
    """
    effect = effect_named(item.effect)
    nominal, through = nominal_values(arm, item), driven_by(arm.joint_names, item)
    return {
        "effect": item.effect,
        "joint": item.joint,
        **({} if through is None else {"driven_by": through}),
        "parameters": {
            p.name: {
                "value": float(item.parameters[p.name]),
                **deviation(p, item.parameters[p.name], std[p.name], by_law.get(p.name, 0.0)),
                **({"written": float(written.parameters[p.name])} if written else {}),
                "nominal": nominal[p.name],
                "unit": p.unit,
            }
            for p in effect.parameters
        },
        "confidence": confidence,
        "gap_share": float(min(1.0, max(0.0, share))),
        "indistinguishable_from": [{"effect": name, "joint": joint} for name, joint in rivals],
        "experiment": effect.experiment or None if rivals else None,
    }
