"""Find the drives on a bus: every identifier is queried in every protocol, in classical CAN and CAN FD. No torque is switched on.

CubeMars drives, and Damiao drives without registers, answer only commands. The mildest is off, so they are queried only if the arm is
supported; no other query switches torque off.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import can

from drivers.can_servo.bring_up import PROTOCOLS, Enquiry
from drivers.can_servo.drive import Drive, SelfDescription
from drivers.can_servo.link import Link
from sim.can_wiring import CanOptions, ServoTable
from sim.clock import Clock
from sim.errors import DeviceError

NODES = {"damiao": range(1, 128), "robstride": range(1, 128), "odrive": range(63), "cubemars": range(1, 128)}
BURST, BURST_TIME, LINGER = 4, 0.002, 0.05  # frames sent together, s until the next ones, s for the last answers to arrive
HEARTBEAT_TIME = 0.15  # s in which an ODrive sends a heartbeat
ODRIVE_CYCLIC = (0x01, 0x09, 0x14, 0x15, 0x17, 0x1C)  # what an ODrive sends unasked
CUBEMARS_STATUS = 0x29  # bits 28-8 of the identifier of what CubeMars drives send unasked in servo mode


@dataclass(frozen=True)
class Found:
    """A drive that answered: its identifiers and frame format, what it reports about itself, and the object that commands it."""

    protocol: str
    node: int
    feedback: int
    fd: bool
    described: SelfDescription
    drive: Drive

    @property
    def name(self) -> str:
        """Its maker and identifier, as part of a sentence."""
        return f"{self.protocol} node {self.node}"


@dataclass(frozen=True)
class Scan:
    """The drives on a bus, and sentences about what else was received or not queried."""

    found: tuple[Found, ...]
    notes: tuple[str, ...]


def scan(link: Link, clock: Clock, options: CanOptions, supported: bool = False) -> Scan:
    """Query every identifier; DeviceError if the bus is not sound. `supported`: drives may be queried with the command off."""
    link.claim()
    beating, notes = _unrequested(link, clock)
    seen: dict[tuple[str, int], list[can.Message]] = {}
    for protocol, kind in PROTOCOLS.items():
        if kind.question_switches_off and not supported:
            notes.append(
                f"{protocol} drives were not asked: they answer only commands, of which off is the mildest; add --supported if the arm cannot drop"
            )
            continue
        for fd in (False, True):
            if fd and (protocol != "damiao" or options.data_bitrate is None):
                continue
            taken = {node for _, node in seen}
            nodes = [
                n for n in NODES[protocol] if not (kind.question_switches_off and n in taken) and (protocol, n) not in seen
            ]
            for node, message in _sweep(link, clock, kind, nodes, fd):
                seen.setdefault((protocol, node), []).append(message)
    notes += [
        f"node {node} sends heartbeats as an ODrive does, but no serial number: firmware before 0.6; write its servo by hand"
        for node in sorted(beating)
        if ("odrive", node) not in seen
    ]
    enquiry = Enquiry(link, clock, patience=0.05, tries=2)
    found = [
        _described(enquiry, protocol, node, answers, options, supported) for (protocol, node), answers in sorted(seen.items())
    ]
    serials = Counter(f.described.serial for f in found if f.described.serial)
    notes += [f"{n} drives report the serial number {s}: it does not distinguish them" for s, n in serials.items() if n > 1]
    if link.error_frames:
        notes.append(
            f"{link.error_frames} error frames: a drive with another bit rate or with CAN FD on a classical bus, or a faulty cable"
        )
    return Scan(tuple(found), tuple(notes))


def _unrequested(link: Link, clock: Clock) -> tuple[set[int], list[str]]:
    """Traffic before any query: nodes with an ODrive's heartbeat, and sentences about everything that an ODrive does not send."""
    end, counts = clock.now() + HEARTBEAT_TIME, Counter[tuple[bool, int]]()
    while (message := link.receive(end)) is not None:
        counts[message.is_extended_id, message.arbitration_id] += 1
    notes = []
    for (wide, identifier), count in sorted(counts.items()):
        if wide and identifier >> 8 == CUBEMARS_STATUS:
            notes.append(
                f"node {identifier & 0xFF} looks like a CubeMars drive in servo mode: set it to MIT mode with the maker's tool"
            )
        elif wide or identifier & 0x1F not in ODRIVE_CYCLIC:
            notes.append(
                f"identifier {identifier:#x} was on the bus before any query ({count} frames): is another program running?"
            )
    return {identifier >> 5 for wide, identifier in counts if not wide and identifier & 0x1F == 1}, notes


def _sweep(link: Link, clock: Clock, kind: type[Drive], nodes: Sequence[int], fd: bool) -> Iterator[tuple[int, can.Message]]:
    """The answers to the question of one protocol, each with its node."""
    for first in range(0, len(nodes), BURST):
        questions = [kind.question(node) for node in nodes[first : first + BURST]]
        for question in questions:
            question.is_fd = question.bitrate_switch = fd
        link.send(questions)
        yield from _answers(link, clock.now() + BURST_TIME, kind, nodes)
    yield from _answers(link, clock.now() + LINGER, kind, nodes)


def _answers(link: Link, end: float, kind: type[Drive], nodes: Sequence[int]) -> Iterator[tuple[int, can.Message]]:
    while (message := link.receive(end)) is not None:
        answer = kind.answering(message)
        if answer is not None and answer[0] in nodes:
            yield answer[0], message


def _described(
    enquiry: Enquiry, protocol: str, node: int, answers: list[can.Message], options: CanOptions, supported: bool
) -> Found:
    kind = PROTOCOLS[protocol]
    (_, feedback), fd = kind.answering(answers[0]) or (node, 0), answers[0].is_fd
    servo = ServoTable(joint=f"{protocol} node {node}", node=node, feedback=min(feedback, 0x7FF), fd=fd)
    drive = kind(servo, options)
    drive.may_ask_by_off = supported
    if len(answers) > 1:
        described = SelfDescription(
            problems=(
                f"{drive.name}: {len(answers)} drives answer to this identifier; give each its own with the maker's tool",
            )
        )
    else:
        try:
            described = drive.describe(enquiry.ask)
        except DeviceError as error:
            described = SelfDescription(problems=(str(error),))
    return Found(protocol, node, feedback, fd, described, drive)
