"""The bytes of a session with a UR, recorded without changing anything, with the names of people and programs removed.

RTDE frames as received (numbers only; text messages are left out), the answers of the dashboard server and the Robot API to the driver's
own questions, and the robot state of the primary interface. Serial numbers become zeros, program names `program`.
"""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable

from drivers.ur_rtde import dashboard, primary, robot_api
from drivers.ur_rtde.options import UrOptions
from drivers.ur_rtde.receiver import Receiver
from sim.capture import Message
from sim.errors import DeviceError

PROGRAM = "program"
STATES = r"(STOPPED|PLAYING|PAUSED) .*"


def captured(
    options: UrOptions, seconds: float, progress: Callable[[float], None] = lambda share: None
) -> tuple[dict[str, str], list[Message]]:
    """Head and messages of `seconds` s of a controller; DeviceError if it cannot be listened to. Nothing is changed."""
    messages: list[Message] = []
    begin = time.monotonic()

    def tap(from_device: bool, frame: bytes) -> None:
        messages.append(Message(time.monotonic() - begin, "rtde", from_device, frame))

    receiver = Receiver(options.host, tap)
    receiver.connect()
    try:
        end = time.monotonic() + seconds
        version = receiver.version
        messages += _interrogated(options, version, begin)
        while (now := time.monotonic()) < end:
            receiver.next(min(end, now + 1.0))
            progress(1.0 - (end - now) / seconds)
    finally:
        receiver.close()
    head = {"driver": "ur_rtde", "controller": ".".join(map(str, version))}
    return head, sorted(messages, key=lambda m: m.t)


def _interrogated(options: UrOptions, version: tuple[int, ...], begin: float) -> list[Message]:
    found = []

    def add(channel: str, question: str, answer: bytes) -> None:
        t = time.monotonic() - begin
        found.append(Message(t, channel, False, question.encode()))
        found.append(Message(t, channel, True, answer))

    if version[0] >= 10:
        for path in dict.fromkeys(path for path, _ in robot_api.QUESTIONS.values()):
            try:
                values = robot_api.fetch(options.host, options.robot_api_port, path)
            except OSError:
                break
            add("robot_api", path, json.dumps({key: _json_without_names(key, value) for key, value in values.items()}).encode())
    else:
        questions = dashboard.questions_for(version)
        for question, answer in zip(questions, dashboard.ask(options.host, *questions), strict=True):
            add("dashboard", question, without_names(question, answer).encode())
    try:
        add("primary", "", primary.state(options.host))
    except DeviceError as error:
        add("primary", str(error).split(";")[0].replace(options.host, "the controller"), b"")
    return found


def without_names(question: str, answer: str) -> str:
    """A dashboard answer with zeros for the characters of the serial number, and without program names."""
    if question == "get serial number":
        return re.sub(r"\w", "0", answer) if re.fullmatch(r"\w+", answer) else answer
    return re.sub(STATES, rf"\1 {PROGRAM}", answer) if question == "programState" else answer


def _json_without_names(key: str, value: object) -> object:
    if not isinstance(value, str):
        return value if isinstance(value, int | float) else None
    if key == "serialNumber":
        return re.sub(r"\w", "0", value)
    return value if key in ("mode", "state", "robotType", "marketingVersion") else PROGRAM
