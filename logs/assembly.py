"""Turn the messages of a recording into samples: topic, order and times, without readings that no arm gives."""

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
    """Return the topic `name`, or the only one that ends in it under a namespace; None where there is none.

    Topics without the wanted joints are considered only where no topic has them. BadLog where several topics qualify and none
    is called `name`.
    """
    under = sorted((topic for topic in topics.values() if topic.topic.endswith(name)), key=lambda topic: topic.topic)
    read = [topic for topic in under if topic.taken] or under[:1]
    if len(read) > 1 and name not in [topic.topic for topic in read]:
        several = "; ".join(f"{topic.topic} with {', '.join(topic.wanted or ())}" for topic in read)
        raise damage.refuse("topics", f"several end in {name}: {several}", WHICH)
    return next((topic for topic in read if topic.topic == name), read[0] if read else None)


def states_of(
    topics: dict[str, JointTopic], joint_names: tuple[str, ...] | None, damage: Damage
) -> tuple[JointTopic, tuple[str, ...]]:
    """Return the topic of the samples and the joints to read from it.

    BadLog where there is no sample, or where the messages cover several sets of joints and none was chosen.
    """
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
    """Whether the writer left every stamp of the samples zero, which in ROS means unset.

    The log times are then used instead, and a finding states this.
    """
    none = len(stamp) > 1 and not stamp.any()
    if none:
        damage.note(f"no message on {states.topic} has a stamp (all are 0): the recorder's log times are used")
    return none


def in_order(
    stamp: np.ndarray, host: np.ndarray, sequence: np.ndarray, states: JointTopic, damage: Damage
) -> np.ndarray | None:
    """Return the order of the messages as samples, None for the order in the file; report losses that sequence numbers show."""
    order = time_order(stamp, host)
    if order is not None:
        stamp, sequence = stamp[order], sequence[order]
        damage.note(f"messages on {states.topic} are not in the order of their log times; they were read in that order")
    report_losses(stamp, sequence, states, damage)
    return order


def left_out(t: np.ndarray, names: tuple[str, ...], measured: dict[str, np.ndarray], damage: Damage) -> np.ndarray | None:
    """(N,) bool: samples with a value that no arm gives; None where every sample is sound.

    BadLog where no sample is sound, or where one is bad and a partial file is not accepted.
    """
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
    """Metadata in one dictionary: keys of the record `recording` as they are, those of other records as `record.key`."""
    words = {key: value for name, record in metadata.items() if name == RECORDING for key, value in record.items()}
    return words | {
        f"{name}.{key}": value for name, record in metadata.items() if name != RECORDING for key, value in record.items()
    }


def assembled(
    topics: dict[str, JointTopic], events: list[tuple[int, int, str, str]], metadata: dict[str, dict[str, str]], state: State,
    joint_names: tuple[str, ...] | None, damage: Damage,
) -> Log:  # fmt: skip
    """Return one log from the messages of the topics; BadLog where they are not a recording of an arm."""
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
    """Return the topic with its columns in the order of `joints`; None where it is not there, or does not name them all."""
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
