"""Topics and ROS 2 message definitions of a recording (ros2msg encoding), as in ROS 2's own packages."""

from __future__ import annotations

import re

STAMPS_END = 2**31 * 10**9  # ns since 1970: the seconds of a ROS 2 stamp are an int32, which ends in 2038
STATES = "/joint_states"
COMMANDS = "/joint_commands"
DIAGNOSTICS = "/joint_diagnostics"
DESCRIPTION = "/robot_description"
EVENTS = "/events"
FRAME = "base_frame"  # in the record `recording`: the link that carries the first joint, frame_id of the messages
RECORDING = "recording"  # metadata record about the recording itself
FAILURE = "failure"  # metadata record of a recording that could not be written to its end
DEVICE_CLOCK = "device_clock"  # metadata record: what was added to the device clock to make the stamps wall time
NO_HOST_CLOCK = {"host_clock": "none"}  # in that record: log times repeat the device clock

RULE = "=" * 80
_TIME = f"""{RULE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
HEADER = f"""{RULE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_TIME}"""

SCHEMAS = {
    "sensor_msgs/msg/JointState": f"""std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
{HEADER}""",
    "calib_msgs/msg/JointDiagnostics": f"""std_msgs/Header header
string[] name
float64[] current
float64[] temperature
{HEADER}""",
    "std_msgs/msg/String": "string data\n",
    "rcl_interfaces/msg/Log": f"""byte DEBUG=10
byte INFO=20
byte WARN=30
byte ERROR=40
byte FATAL=50
builtin_interfaces/Time stamp
uint8 level
string name
string msg
string file
string function
uint32 line
{_TIME}""",
}
TOPICS = {
    STATES: "sensor_msgs/msg/JointState",
    COMMANDS: "sensor_msgs/msg/JointState",
    DIAGNOSTICS: "calib_msgs/msg/JointDiagnostics",
    EVENTS: "rcl_interfaces/msg/Log",
    DESCRIPTION: "std_msgs/msg/String",
}
UNITS = {
    STATES: {"position": "rad", "velocity": "rad/s", "effort": "N*m", "stamp": "device clock on wall time"},
    COMMANDS: {"position": "rad", "velocity": "rad/s", "effort": "N*m", "stamp": "device clock on wall time"},
    DIAGNOSTICS: {"current": "A", "temperature": "degC", "stamp": "device clock on wall time"},
    EVENTS: {},
    DESCRIPTION: {"format": "URDF"},
}


def device_offset(metadata: dict[str, dict[str, str]]) -> int | None:
    """ns from the device clock to the stamps, where the recording states it; None for stamps that are the device clock."""
    text = metadata.get(DEVICE_CLOCK, {}).get("offset_ns", "")
    return int(text) if re.fullmatch(r"-?[0-9]{1,19}", text, re.ASCII) else None
