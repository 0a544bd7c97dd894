"""The catalogue's effects as the exam hides them, each with its joints and doses.

Each effect changes a `TrueArm` by a dose and returns the answer, the catalogue's parameters at their true values. `form` 0 and
1 are forms of the truth; 1 is farther from the textbook and is drawn for hard cases. Doses are physical: `first` guesses one
for an arm, and `severity.py` scales it to the visibility requested.
"""

from __future__ import annotations

from benchmarks.exam.body_effects import contact, link, payload, pull, tilt
from benchmarks.exam.friction_effects import (
    asymmetric,
    coulomb,
    load_friction,
    presliding,
    speed_law,
    stribeck,
    thermal,
    viscous,
)
from benchmarks.exam.gear_effects import backlash, coupling, elasticity, ripple, rotor, saturation, spring
from benchmarks.exam.hidden import (
    ALL,
    ELBOW,
    LIFT,
    LOADED,
    PAN,
    WRIST_1,
    WRIST_2,
    WRIST_3,
    Hidden,
    always,
    dry,
    noise,
    of_mass,
    per_noise,
    softest,
)
from benchmarks.exam.reading_effects import delay, eccentricity, encoder_offset, gain, offset

CHANGES = (0.25, 0.5, 0.9)
EFFECTS = (
    Hidden("coulomb_friction", coulomb, ALL, always(0.3), always(1.2), CHANGES),
    Hidden("viscous_friction", viscous, ALL, always(0.3), always(1.8), CHANGES),
    Hidden("asymmetric_friction", asymmetric, ALL, per_noise(1.0), lambda a, j: 0.45 * dry(a, j)),
    Hidden("stribeck_friction", stribeck, ALL, per_noise(2.0), lambda a, j: 1.2 * dry(a, j)),
    Hidden("nonlinear_viscous_friction", speed_law, ALL, per_noise(2.0), lambda a, j: 1.2 * dry(a, j)),
    Hidden("load_dependent_friction", load_friction, LOADED, always(0.08), always(0.35)),
    Hidden("thermal_friction", thermal, ALL, always(0.2), always(0.55)),
    Hidden("presliding_friction", presliding, ALL, always(4e-3), always(2.5e-2), (1.2e-3, 3e-3, 6e-3)),
    Hidden("rotor_inertia", rotor, ALL, always(0.3), always(1.5), CHANGES),
    Hidden("joint_elasticity", elasticity, (PAN, LIFT, ELBOW, WRIST_1), lambda a, j: 0.3 * softest(a, j), lambda a, j: softest(a, j)),
    Hidden("backlash", backlash, (PAN, WRIST_1, WRIST_2), always(2e-3), lambda a, j: 0.012 if a.name == "servo6" else 0.006),
    Hidden("torque_ripple", ripple, ALL, per_noise(1.0), lambda a, j: 0.6 * dry(a, j)),
    Hidden("joint_spring", spring, ALL, per_noise(2.0), lambda a, j: 1.5 * dry(a, j)),
    Hidden("torque_gain", gain, ALL, always(0.08), always(0.3)),
    Hidden("torque_offset", offset, ALL, per_noise(1.0), lambda a, j: 0.8 * dry(a, j)),
    Hidden("torque_saturation", saturation, (PAN, LIFT, ELBOW), always(0.15), always(0.4)),
    Hidden("encoder_offset", encoder_offset, LOADED, always(0.02), always(0.08)),
    Hidden("encoder_eccentricity", eccentricity, LOADED, always(0.02), always(0.08)),
    Hidden("time_delay", delay, (), always(3e-3), always(0.02), (2e-3, 4e-3, 8e-3)),
    Hidden("payload", payload, (), of_mass(0.02), of_mass(0.4)),
    Hidden("link_inertia", link, LOADED, always(0.15), always(1.0), (0.1, 0.18, 0.3)),
    Hidden("base_tilt", tilt, (), always(0.02), always(0.07)),
    Hidden("tool_force", pull, (), lambda a, j: 3 * noise(a, LIFT), lambda a, j: 60 * noise(a, LIFT)),
    Hidden("external_contact", contact, (), lambda a, j: 6 * noise(a, LIFT), lambda a, j: 90 * noise(a, LIFT)),
    Hidden("transmission_coupling", coupling, (WRIST_1, WRIST_2, WRIST_3), always(0.3), always(1.2)),
)  # fmt: skip
