"""The messages of a recording as samples: which topic counts, in which order, at which instants, and what of it is no reading of an arm."""

from __future__ import annotations

import numpy as np

from logs.align import held, report_losses, time_order
from logs.damage import Damage
from logs.joint_topic import JointTopic
from logs.log import Event, Log, State
from logs.plausible import UNIT, bad_samples, first_fault
from logs.schemas import COMMANDS, DIAGNOSTICS, NO_HOST_CLOCK, RECORDING, STATES, device_offset
from logs.timing import checked_times

WHICH = "name the arm with --arm, or record one arm alone"


def chosen(topics: dict[str, JointTopic], name: str, damage: Damage) -> JointTopic | None:
    """The topic `name`, or the only one that ends in it under a namespace; one without the joints that are read only where no other is."""
    under = sorted((topic for topic in topics.values() if topic.topic.endswith(name)), key=lambda topic: topic.topic)
    read = [topic for topic in under if topic.taken] or under[:1]
    if len(read) > 1 and name not in [topic.topic for topic in read]:
        several = "; ".join(f"{topic.topic} with {', '.join(topic.wanted or ())}" for topic in read)
        raise damage.refuse("topics", f"several end in {name}: {several}", WHICH)
    return next((topic for topic in read if topic.topic == name), read[0] if read else None)


def states_of(
    topics: dict[str, JointTopic], joint_names: tuple[str, ...] | None, damage: Damage
) -> tuple[JointTopic, tuple[str, ...]]:
    """The topic of the samples and the joints that it is read for; BadLog where there is no sample."""
    states = chosen(topics, STATES, damage)
    if states is None or not states.taken or not states.wanted:
        wanted = f" with the joints {', '.join(joint_names)}" if joint_names else ""
        raise damage.refuse(
            "topics", f"no message on {STATES}{wanted}", "record joint states, or name the joints as the log does"
        )
    several = [states.wanted, *states.others]
    if joint_names is None and max(map(len, several[1:]), default=0) >= len(states.wanted):
        sets = "; ".join(", ".join(joints) for joints in several)
        raise damage.refuse(f"topic {states.topic}", f"its messages are about several sets of joints: {sets:.300}", WHICH)
    if states.others:
        joints = "; ".join(", ".join(names) for names in states.others)
        damage.note(
            f"{sum(states.others.values())} messages on {states.topic} are about other joints ({joints:.200}) and were not read"
        )
    known = {*states.wanted, *(name for joints in states.others for name in joints)}
    beside = {name for layouts in states.layouts.values() for layout in layouts for name in layout.names} - known
    if beside:
        damage.note(f"{states.topic} also names {', '.join(sorted(beside)):.200}: not read")
    return states, states.wanted


def unstamped(stamp: np.ndarray, states: JointTopic, damage: Damage) -> bool:
    """Whether the writer of the samples left every stamp zero, which in ROS means none; their log times are the instants then, and it is said."""
    none = len(stamp) > 1 and not stamp.any()
    if none:
        damage.note(
            f"no message on {states.topic} has a stamp (all are 0): the log times were taken, which are those of the recorder"
        )
    return none


def in_order(
    stamp: np.ndarray, host: np.ndarray, sequence: np.ndarray, states: JointTopic, damage: Damage
) -> np.ndarray | None:
    """The order in which the messages are samples, None for that in which they stand; what their sequence numbers say is lost."""
    order = time_order(stamp, host)
    if order is not None:
        stamp, sequence = stamp[order], sequence[order]
        damage.note(f"messages on {states.topic} do not stand in the order of their log times; they were read in that order")
    report_losses(stamp, sequence, states, damage)
    return order


def left_out(t: np.ndarray, names: tuple[str, ...], measured: dict[str, np.ndarray], damage: Damage) -> np.ndarray | None:
    """(N,) bool, samples that hold a value that is no reading of an arm, where a partial file is accepted; None where each is sound."""
    fault = first_fault(t, measured)
    if fault is None:
        return None
    damage.report(
        f"sample {fault.sample} at {t[fault.sample]:.4f} s, {fault.channel} of {names[fault.joint]}",
        f"{fault.value:.6g} {UNIT[fault.channel]} is not a reading of an arm (rule: {fault.rule})",
    )
    bad = bad_samples(t, measured)
    if bad.all():
        raise damage.refuse("samples", "no sound sample", "record it again")
    damage.note(f"{int(bad.sum())} of {len(t)} samples left out because a value in them is not a reading of an arm")
    return bad


def words_of(metadata: dict[str, dict[str, str]]) -> dict[str, str]:
    """What a recording says of itself: the record `recording` as it stands, the keys of every other under its name."""
    words = {key: value for name, record in metadata.items() if name == RECORDING for key, value in record.items()}
    return words | {
        f"{name}.{key}": value for name, record in metadata.items() if name != RECORDING for key, value in record.items()
    }


def assembled(
    topics: dict[str, JointTopic], events: list[tuple[int, int, str, str]], metadata: dict[str, dict[str, str]], state: State,
    joint_names: tuple[str, ...] | None, damage: Damage,
) -> Log:  # fmt: skip
    """One log of what was taken from the topics; BadLog where their messages are no recording of an arm."""
    states, names = states_of(topics, joint_names, damage)
    stamp, host = np.concatenate(states.stamp), np.concatenate(states.host)
    one_clock = unstamped(stamp, states, damage)
    if one_clock:
        stamp = host
        for topic in topics.values():
            topic.stamp = topic.host
    sequence = np.concatenate(states.sequence)
    states.stamp = []
    for topic in topics.values():
        topic.host, topic.sequence = [], []
    order = in_order(stamp, host, sequence, states, damage)
    if order is not None:
        stamp, host = stamp[order], host[order]
    t, t_host, host_origin = (stamp - stamp[0]) * 1e-9, (host - host[0]) * 1e-9, int(host[0])
    del host
    if one_clock or NO_HOST_CLOCK.items() <= metadata.get(RECORDING, {}).items():
        t_host = np.full(len(t), np.nan)
    q, dq, tau = (
        values if order is None or not values.strides[0] else values[order] for values in map(states.joined, range(3))
    )
    t, clock = checked_times(t, t_host, damage, (q, dq))
    n = len(names)
    q_cmd, dq_cmd, tau_cmd = held(_named(topics, COMMANDS, names, damage), stamp, t, n, 3, damage)
    current, temperature = held(_named(topics, DIAGNOSTICS, names, damage), stamp, t, n, 2, damage, between=(0,))
    measured = {"q": q, "dq": dq, "tau": tau, "current": current, "temperature": temperature}
    arrays = {"t": t, "t_host": t_host, **measured, "q_cmd": q_cmd, "dq_cmd": dq_cmd, "tau_cmd": tau_cmd}
    bad = left_out(t, names, measured, damage)
    if bad is not None:
        arrays = {key: value[~bad] for key, value in arrays.items()}
    lines = tuple(Event((at - int(stamp[0])) * 1e-9, level, name, text) for at, level, name, text in events)
    return Log(
        names, **arrays, metadata=words_of(metadata), events=lines, findings=damage.all_findings(), path=damage.path, state=state, clock=clock,
        t_origin=int(stamp[0]) - (device_offset(metadata) or 0), t_host_origin=host_origin,
    )  # fmt: skip


def _named(topics: dict[str, JointTopic], name: str, joints: tuple[str, ...], damage: Damage) -> JointTopic | None:
    """The topic, its columns in the order of `joints`."""
    topic = chosen(topics, name, damage)
    if topic is None or not topic.taken or not topic.wanted:
        return None
    missing = [joint for joint in joints if joint not in topic.wanted]
    if missing:
        damage.note(f"{topic.topic} does not name {', '.join(missing)}; it is not used")
        return None
    if topic.wanted != joints:
        columns = [topic.wanted.index(joint) for joint in joints]
        topic.values = [[part[:, columns] for part in piece] for piece in topic.values]
        topic.wanted = joints
    return topic
