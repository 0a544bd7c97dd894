"""The monitor's rules as a table: quantity, unit and remedy."""

from __future__ import annotations

from typing import NamedTuple

# Consistency of readings: a sensor that still reports but no longer measures contradicts another quantity.
# s over which speed is compared with position, and for which a torque may stay constant; a fault is found within it
SPAN = 0.25
# s over which the torque must follow the motion; a fault is found within twice that
SWING = 1.0


class Rule(NamedTuple):
    """The monitored quantity, its unit, and what to check if the rule is broken."""

    quantity: str
    unit: str
    remedy: str


# in the order of `safety.cycle.cycle`
RULES = (
    Rule("reading", "", "check the driver"),
    Rule("device time between readings", "s", "readings are stale or lost: check cable, network and load of the computer"),
    Rule("age of the reading", "s", "this computer is late: stop other work on it"),
    Rule("temperature", "degC", "let the arm cool down, or warm up if it is too cold"),
    Rule("jump of the position between two readings", "rad", "check the encoder"),
    Rule("position", "rad", "move the joint back by the device's own controls"),
    Rule("speed", "rad/s", "plan a slower motion"),
    Rule("following error", "rad", "look for contact, a wrong payload or a brake; plan a slower motion if there is none"),
    Rule("readings with the same position at speed", "", "the encoder's value is frozen: check its cable"),
    Rule("speed against change of position", "rad/s", "check sign, unit and gear ratio of the encoder"),
    Rule("torque beside expectation", "N m", "look for contact or a wrong payload"),
    Rule("sudden change of torque beside expectation", "N m", "look for contact or a lost payload"),
    Rule(f"turned within {SPAN:g} s against the reported speed", "rad",
         "the speed that the device reports is not that of its encoder: check sensor, unit and sign"),
    Rule("readings with the very same torque in motion", "", "the torque is frozen: check the drive's current sensor"),
    Rule(f"swing of the torque within {SWING:g} s, for one of {{:.4g}} N m that the motion takes,", "N m",
         "the torque does not follow the motion: check the sensor"),
    Rule("the device's clock against this computer's,", "s",
         "one of the clocks runs at a wrong rate or jumped: check time synchronisation, and the rate that the device states"),
    Rule("torque of an arm without its declared load, beside expectation", "N m",
         "the load has fallen off or was never there: look at the tool, and declare what is mounted"),
)  # fmt: skip
