"""Refuses settings so wide that they switch a rule off; the operator may lift each refusal by its name in the cell file.

The bounds are beyond any arm that this software is made for: the fastest joints of light servo arms, the torque of the largest
collaborative arm (UR30: 738 N m at the shoulder), a tool speed of 3 m/s (Franka FR3, libfranka's rate_limiting.h).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sim.arm import Arm
from sim.assumptions import UNUSUAL
from sim.cell import Cell
from sim.errors import SafetyStop

# lower and upper bound of each setting, in its own unit
BOUNDS: dict[str, tuple[float, float]] = {
    "following_error": (1e-4, 0.1),
    "following_error_max": (1e-4, 0.3),
    "point_speed_max": (0.01, 3.0),
    "clearance_self": (2e-3, 1.0),
    "clearance_obstacle": (5e-3, 1.0),
    "payload_mass": (0.0, 50.0),
    "payload_com": (0.0, 1.0),
    "dq_max": (1e-3, 20.0),
    "ddq_max": (1e-2, 200.0),
    "jerk_max": (0.1, 2e4),
    "tau_max": (1e-2, 2000.0),
    "rate": (10.0, 2000.0),
    "encoder_resolution": (1e-9, 5e-3),
    "velocity_noise": (0.0, 0.2),
    "torque_noise": (0.0, 30.0),
    "torque_constant": (1e-2, 500.0),
    "torque_continuous": (1e-2, 2000.0),
    "prior": (1e-3, 2.0),
}
ROUNDING = 1e-6
SHAPELESS = "payload-without-shape"


def unusual(arm: Arm, cell: Cell) -> dict[str, str]:
    """Name of each setting beyond its bounds -> its value and its bounds; NaN is beyond every bound."""
    found: dict[str, str] = {}
    for name, label, values in _settings(arm, cell):
        least, most = BOUNDS[name]
        fine = (values >= least) & (values <= most)
        if not fine.all():
            value = float(values[int(np.argmin(fine))])
            found.setdefault(name, f"{label} = {value:g}, usual is {least:g} to {most:g}")
    for name, label, wider in _beside_the_model(arm):
        if wider:
            found.setdefault(name, label)
    return found


def check_plausible(arm: Arm, cell: Cell) -> None:
    """SafetyStop that names the first setting beyond its bounds that the cell file does not allow by name.

    A payload without a shape counts as one, since nothing would keep it clear of the arm and the cell.
    """
    load = cell.table.payload
    if load is not None and load.mass > 0 and not cell.table.tool and SHAPELESS not in cell.assumed:
        raise SafetyStop(
            f"{cell.path.name}: payload.mass = {load.mass:g} kg has no shape, so nothing keeps it clear of the arm and of the cell; "
            f'describe it with [[tool]], or, if it lies within the last link, write assume = ["{SHAPELESS}"] at the top of the file'
        )
    for name, what in unusual(arm, cell).items():
        assumption = f"unusual-{name}"
        if assumption not in cell.assumed:
            file = cell.path.name if cell.path.suffix == ".toml" else "a cell file, and name it with --cell"
            raise SafetyStop(
                f"{what}: so wide a setting switches a rule off; correct it, or, if it is meant, write "
                f'assume = ["{assumption}"] at the top of {file}: it is then shown at every start and written into every log'
            )


def _settings(arm: Arm, cell: Cell) -> Iterator[tuple[str, str, np.ndarray]]:
    motion, sensors = cell.table.motion, arm.sensors
    for name in ("following_error", "following_error_max", "point_speed_max", "clearance_self", "clearance_obstacle"):
        yield name, f"{cell.path.name}: motion.{name}", np.array([getattr(motion, name)])
    if cell.table.payload is not None:
        yield "payload_mass", f"{cell.path.name}: payload.mass", np.array([cell.table.payload.mass])
        yield "payload_com", f"{cell.path.name}: distance of payload.com", np.array([np.linalg.norm(cell.table.payload.com)])
    for name in ("dq_max", "ddq_max", "jerk_max", "tau_max"):
        yield name, f"{arm.name}: limits.{name}", np.asarray(getattr(arm, name), dtype=float)
    yield "rate", f"{arm.name}: sensors.rate", np.array([sensors.rate])
    yield "encoder_resolution", f"{arm.name}: sensors.encoder_resolution", np.array([sensors.encoder_resolution])
    yield "velocity_noise", f"{arm.name}: sensors.velocity_noise", np.array(sensors.velocity_noise)
    yield "torque_noise", f"{arm.name}: sensors.torque_noise", np.array(sensors.torque_noise)
    if arm.torque_constant is not None:
        yield "torque_constant", f"{arm.name}: torque_constant", np.asarray(arm.torque_constant, dtype=float)
    if arm.torque_continuous is not None:
        yield "torque_continuous", f"{arm.name}: torque_continuous", np.asarray(arm.torque_continuous, dtype=float)
    for key, value in arm.prior.model_dump().items():
        if isinstance(value, float | int):
            yield "prior", f"{arm.name}: prior.{key}", np.array([float(value)])


def _beside_the_model(arm: Arm) -> Iterator[tuple[str, str, bool]]:
    """Limits of arm.toml that are wider than those of the model file, where it has any."""
    tree = arm.tree
    for name, own, model in (
        ("q_max", arm.q_max, tree.q_max),
        ("q_min", -arm.q_min, -tree.q_min),
        ("tau_max", arm.tau_max, tree.tau_max),
    ):
        wider = np.isfinite(model) & (own > model + ROUNDING * np.abs(model))
        if wider.any():
            j = int(np.argmax(wider))
            value, limit = (float(x[j]) * (-1 if name == "q_min" else 1) for x in (own, model))
            yield (
                "limits_of_model",
                f"{arm.name}: limits.{name} of {arm.joint_names[j]} = {value:g}, its model file has {limit:g}",
                True,
            )


assert set(BOUNDS) | {"limits_of_model"} == set(UNUSUAL)
