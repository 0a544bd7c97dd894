"""RTDE variables of the emulated controller: type, first versions, and source of the value."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

Version = tuple[int, int, int]


@dataclass(frozen=True)
class Output:
    """An output variable; `since` lists its first version in each major version that has it."""

    type: str
    value: Callable[[Any], float | Sequence[float]]
    since: tuple[tuple[int, int, int], ...] = ((3, 0, 0), (5, 0, 0), (10, 0, 0))

    def known_to(self, version: Version) -> bool:
        """Whether a controller of this version has the variable."""
        return any(version[0] == first[0] and version >= first for first in self.since)


PAYLOAD = ((3, 11, 0), (5, 5, 1), (10, 0, 0))
PAYLOAD_INERTIA = ((3, 15, 0), (5, 11, 0), (10, 0, 0))
FT = ((5, 9, 0), (10, 0, 0))
TORQUE = ((5, 23, 0), (10, 11, 0))  # release note 5.23
UPPER = ((3, 9, 0), (5, 3, 0), (10, 0, 0))


def _zeros(n: int, _robot: Any) -> list[float]:
    return [0.0] * n


def _attribute(name: str, robot: Any) -> Any:
    return getattr(robot, name)


def _zero(_robot: Any) -> int:
    return 0


def _register(bank: str, index: int, robot: Any) -> float:
    value: float = getattr(robot, bank)[index]
    return value


OUTPUT_VARIABLES: dict[str, Output] = {
    "timestamp": Output("DOUBLE", partial(_attribute, "time")),
    "target_q": Output("VECTOR6D", partial(_attribute, "target_q")),
    "target_qd": Output("VECTOR6D", partial(_attribute, "target_qd")),
    "target_qdd": Output("VECTOR6D", partial(_attribute, "target_qdd")),
    "target_current": Output("VECTOR6D", partial(_zeros, 6)),
    "target_moment": Output("VECTOR6D", partial(_zeros, 6)),
    "actual_q": Output("VECTOR6D", partial(_attribute, "actual_q")),
    "actual_qd": Output("VECTOR6D", partial(_attribute, "actual_qd")),
    "actual_current": Output("VECTOR6D", partial(_attribute, "actual_current")),
    "actual_current_as_torque": Output("VECTOR6D", partial(_attribute, "actual_torque"), TORQUE),
    "joint_control_output": Output("VECTOR6D", partial(_zeros, 6)),
    "joint_temperatures": Output("VECTOR6D", partial(_attribute, "joint_temperatures")),
    "joint_mode": Output("VECTOR6INT32", partial(_attribute, "joint_mode")),
    "actual_joint_voltage": Output("VECTOR6D", partial(_zeros, 6)),
    "robot_mode": Output("INT32", partial(_attribute, "robot_mode")),
    "safety_mode": Output("INT32", partial(_attribute, "safety_mode")),
    "safety_status": Output("INT32", partial(_attribute, "safety_mode")),
    "runtime_state": Output("UINT32", partial(_attribute, "runtime_state")),
    "robot_status_bits": Output("UINT32", partial(_attribute, "robot_status_bits")),
    "safety_status_bits": Output("UINT32", partial(_attribute, "safety_status_bits")),
    "speed_scaling": Output("DOUBLE", partial(_attribute, "speed_scaling")),
    "target_speed_fraction": Output("DOUBLE", partial(_attribute, "speed_slider")),
    "payload": Output("DOUBLE", partial(_attribute, "payload"), PAYLOAD),
    "payload_cog": Output("VECTOR3D", partial(_attribute, "payload_cog"), PAYLOAD),
    "payload_inertia": Output("VECTOR6D", partial(_zeros, 6), PAYLOAD_INERTIA),
    "ft_raw_wrench": Output("VECTOR6D", partial(_zeros, 6), FT),
    # in the variable table of Universal Robots' client library; which release introduced them was not found
    "target_gravity": Output("VECTOR3D", partial(_attribute, "target_gravity"), TORQUE),
    "tcp_offset": Output("VECTOR6D", partial(_attribute, "tcp_offset"), TORQUE),
    **{name: Output("VECTOR6D", partial(_zeros, 6)) for name in (
        "actual_TCP_pose", "actual_TCP_speed", "actual_TCP_force", "target_TCP_pose", "target_TCP_speed")},
    "actual_tool_accelerometer": Output("VECTOR3D", partial(_zeros, 3)),
    **{name: Output("UINT64", _zero) for name in ("actual_digital_input_bits", "actual_digital_output_bits")},
    **{name: Output("DOUBLE", _zero) for name in (
        "actual_execution_time", "actual_momentum", "actual_main_voltage", "actual_robot_voltage", "actual_robot_current",
        "standard_analog_input0", "standard_analog_input1", "standard_analog_output0", "standard_analog_output1")},
    **{f"output_int_register_{i}": Output("INT32", partial(_register, "output_int", i), *([] if i < 24 else [UPPER]))
       for i in range(48)},
    **{f"output_double_register_{i}": Output("DOUBLE", partial(_register, "output_double", i), *([] if i < 24 else [UPPER]))
       for i in range(48)},
}  # fmt: skip

INPUT_VARIABLES: dict[str, str] = {
    **{f"input_int_register_{i}": "INT32" for i in range(48)},
    **{f"input_double_register_{i}": "DOUBLE" for i in range(48)},
    "speed_slider_mask": "UINT32",
    "speed_slider_fraction": "DOUBLE",
    "external_force_torque": "VECTOR6D",
}
