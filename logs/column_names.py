"""What a column's name states: its words, the text in brackets at its end, its unit."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from logs.units import TIME, UNITS

TIMES = {"t", "time", "timestamp", "timestamps", "stamp", "stamps", "times", "seconds", "secs", "sec", "elapsed", "clock"}
# word in a column's name -> channel; the first of these that occurs in it decides
WORDS: dict[str, str] = {
    **dict.fromkeys(
        ("dq", "qd", "qdot", "dqs", "vel", "velocity", "velocities", "speed", "omega", "qvel", "dtheta", "rpm"), "dq"
    ),
    **dict.fromkeys(("tau", "torque", "torques", "effort", "efforts", "trq", "moment", "tauj", "taus"), "tau"),
    **dict.fromkeys(("i", "current", "currents", "cur", "curr", "iq"), "current"),
    **dict.fromkeys(("temp", "temperature", "temperatures", "temps"), "temperature"),
    **dict.fromkeys(
        ("q", "pos", "position", "positions", "qpos", "theta", "angle", "angles", "qs", "state", "enc", "encoder"), "q"
    ),
}
ACTION = "action"  # of a LeRobot data set: commanded positions, whatever else the name contains
COMMANDED = {ACTION, "cmd", "des", "desired", "d", "ref", "reference", "target", "goal", "command", "commanded", "setpoint", "sp"}  # fmt: skip
MEASURED = {"act", "actual", "meas", "measured", "real", "fb", "feedback", "observation", "m"}
ACCELERATIONS = {"ddq", "qdd", "acc", "acceleration", "accelerations", "qddot"}
VAGUE = {"state", "enc", "encoder"}  # words for positions that often mean something else: a drive's mode, raw counts
ASIDE = {"err", "error", "errors", "ext", "external", "raw", "filtered", "filt"}  # not the reading itself

KNOWN = {
    **{unit.replace(" ", "").lower(): unit for units in (TIME, *UNITS.values()) for unit in units},
    "amp": "A", "amps": "A", "c": "degC", "celsius": "degC", "f": "degF", "dps": "deg/s", "rps": "rev/s", "n-m": "N m",
    **dict.fromkeys(("1/min", "u/min", "r/min", "rev/min", "min^-1", "min-1"), "rpm"),
}  # fmt: skip
# units that occur in names without brackets; the single letters may also be names of joints
UNIT_WORDS = (
    "deg", "degree", "degrees", "rad", "mrad", "rpm", "dps", "rev", "ms", "us", "ns", "ma", "amp", "nm", "nmm", "ncm", "mnm", "celsius",
)  # fmt: skip
UNIT_LETTERS = ("s", "a", "c", "k")
_WHOLE = TIMES | set(WORDS) | COMMANDED | MEASURED | ACCELERATIONS | set(UNIT_WORDS)
_NO_UNIT = (set(WORDS) | MEASURED) - {"m"} - set(UNIT_WORDS)  # joint1 [pos]
_SPELLINGS = ((r"seconds?|secs?\b", "s"), (r"degrees?|°", "deg"), (r"radians?", "rad"), (r"turns?", "rev"), ("[µμ]", "u"))


def words_of(name: str) -> list[str]:
    """Words of a name: `actual_q_0` -> actual q 0; `jointPos[2]` -> joint pos 2; `tau1_mNm` -> tau 1 mnm."""
    words: list[str] = []
    for token in re.findall(r"[A-Za-z]+|\d+", name):
        whole = token.lower() in _WHOLE
        words += [token.lower()] if whole else re.sub(r"(?<=[a-z])(?=[A-Z])", " ", token).lower().split()
    return words


def apart(name: str) -> tuple[str, str]:
    """Split off the text in brackets at the end of a name: `q1 [deg]` -> `q1 ` and `deg`; "" where there is none."""
    found = re.search(r"[\[(]([^\[\]()]*)[\])]\s*$", name)
    return (name[: found.start()], found[1].strip()) if found else (name, "")


def unit_written(text: str) -> str:
    """The unit that a text denotes, such as `°/s`, `N*mm`, `DEG`, `deg/sec`; "" where it is not a known one."""
    short = re.sub(r"[\s*·.]", "", text).lower()
    for pattern, spelling in _SPELLINGS:
        short = re.sub(pattern, spelling, short)
    return KNOWN.get(short, "")


def stated_unit(channel: str, name: str) -> str:
    """The unit of a channel (or of "time") that a column's name states; "" where it states none."""
    units: Mapping[str, float] = TIME if channel == "time" else UNITS[channel]
    before, text = apart(name)
    words = [word for word in words_of(before)[1:] if word in UNIT_WORDS or word in UNIT_LETTERS]
    for unit in (unit_written(text), *map(unit_written, words)):
        for full in (unit, f"{unit}/s"):  # dq_deg, dq_deg_s
            if full in units:
                return full
    return ""


def unknown_unit(channel: str, columns: Sequence[str]) -> str:
    """The text in brackets of a channel's columns that is not one of its units; "" for none, or where it names joints."""
    texts = {apart(name)[1] for name in columns if name and not stated_unit(channel, name)} - {""}
    text = texts.pop() if len(texts) == 1 else ""
    return "" if text.isdigit() or set(words_of(text)) & _NO_UNIT else text
