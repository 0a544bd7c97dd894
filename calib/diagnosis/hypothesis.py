"""A hypothesis that explains recordings: an arm with the effects accepted so far, and how its dry friction builds up."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from calib.diagnosis.nuisance import DELAY_MEAN, LEAD_SPREAD, WIDTH_SPREAD, Ripple
from calib.measurement.observed import Key, Observed
from sim.arm import Arm, ArmEffect
from sim.effects import with_effect
from sim.slip import SLIP_WIDTH

CONTACT = "external_contact"


@dataclass(frozen=True)
class Hypothesis:
    """An arm with the effects accepted so far, and how its dry friction builds up: width (n,) rad, lead (n,) s, delay s.

    observed: effect parameters that another channel than the torque shows, in any recording, held-out ones too.
    written: as an arm folder can hold it, without a lead of dry friction.
    ripples: per joint the ripple of its gear, found before any effect (calib.diagnosis.gear_ripples); empty without a search.
    """

    arm: Arm
    width: np.ndarray
    lead: np.ndarray
    delay: float = DELAY_MEAN
    accepted: tuple[ArmEffect, ...] = ()
    nominal_arm: Arm | None = None
    event_log: int | None = None
    written: bool = False
    observed: Mapping[Key, Observed] = field(default_factory=dict)
    ripples: tuple[Ripple | None, ...] = ()

    @property
    def start(self) -> Arm:
        """The arm without any accepted effect."""
        return self.nominal_arm or self.arm

    def with_effects(self, accepted: tuple[ArmEffect, ...], event_log: int | None = None) -> Hypothesis:
        """The same dry friction and delay with other effects; a contact belongs to one log, by default the one it was in."""
        arm, event = self.start, self.event_log if event_log is None else event_log
        for item in accepted:
            if item.effect != CONTACT:
                arm = with_effect(arm, item)
        touched = any(item.effect == CONTACT for item in accepted)
        return replace(self, arm=arm, accepted=accepted, nominal_arm=self.start, event_log=event if touched else None)

    def event(self, log: int) -> ArmEffect | None:
        """The contact in that log, if one was accepted."""
        if log != self.event_log:
            return None
        return next((e for e in self.accepted if e.effect == CONTACT), None)

    def ripple_of(self, j: int) -> Ripple | None:
        """The ripple of joint j's gear, if one was found."""
        return self.ripples[j] if self.ripples else None

    def as_written(self) -> Hypothesis:
        """The same without what an arm folder cannot hold."""
        return replace(self, lead=np.zeros(self.arm.n), written=True)

    @staticmethod
    def nominal(arm: Arm, observed: Mapping[Key, Observed] | None = None) -> Hypothesis:
        """The hypothesis before any effect is accepted."""
        return Hypothesis(arm, np.full(arm.n, SLIP_WIDTH), np.full(arm.n, 3e-3), observed=observed or {})


def recentred(hypothesis: Hypothesis, names: list[str], theta: np.ndarray, joints: Collection[int]) -> Hypothesis:
    """The hypothesis with width and lead of `joints` moved to where the fit puts them; other nuisance stays linear."""
    at = {name: k for k, name in enumerate(names)}
    width, lead = hypothesis.width.copy(), hypothesis.lead.copy()
    for j in joints:
        width[j] *= np.exp(np.clip(WIDTH_SPREAD * theta[at[f"width_{j + 1}"]], -0.7, 0.7))
        lead[j] += np.clip(LEAD_SPREAD * theta[at[f"lead_{j + 1}"]], -4e-3, 4e-3)
    return replace(hypothesis, width=np.clip(width, 1e-5, 6e-4), lead=np.clip(lead, -5e-3, 2e-2))
