"""One RTDE connection as the controller sees it: handshake, recipes, claimed inputs, data."""

from __future__ import annotations

import struct
from typing import Any

from sim.emulated.ur.frames import (
    CONTROLLER_VERSION,
    DATA,
    INPUTS,
    OUTPUTS,
    PAUSE,
    START,
    TYPES,
    VERSION,
    FrameReader,
    Malformed,
    frame,
)
from sim.emulated.ur.variables import INPUT_VARIABLES, OUTPUT_VARIABLES


class RtdeSession:
    """Answers one client; `robot` holds what is read and written, `robot.claims` which client owns which input.

    `replies` collects the bytes for the client.
    """

    def __init__(self, robot: Any) -> None:
        self.robot = robot
        self.started = False
        self._reader = FrameReader()
        self._output: list[str] = []
        self._packer: struct.Struct | None = None
        self._every = 1
        self._inputs: dict[int, list[str]] = {}
        self.replies: list[bytes] = []

    def received(self, data: bytes) -> list[bytes]:
        """Replies to what a client sent; Malformed if the connection must be closed."""
        self.replies = []
        for kind, payload in self._reader.feed(data):
            self._handle(kind, payload)
        return self.replies

    def due(self, cycle: int) -> bytes | None:
        """The data frame of this controller cycle; None if none is due to the client."""
        if not self.started or self._packer is None or cycle % self._every:
            return None
        values: list[float] = []
        for name in self._output:
            value = OUTPUT_VARIABLES[name].value(self.robot)
            if isinstance(value, int | float):
                values.append(value)
            else:
                values.extend(value)
        return frame(DATA, self._packer.pack(1, *values))

    def closed(self) -> None:
        """Release the claimed inputs; their values stay as last written."""
        self.started = False
        for name in [name for name, owner in self.robot.claims.items() if owner is self]:
            del self.robot.claims[name]

    def _handle(self, kind: int, payload: bytes) -> None:
        if kind == VERSION:
            self._reply(kind, bytes([payload == b"\x00\x02"]))
        elif kind == CONTROLLER_VERSION:
            self._reply(kind, struct.pack(">4I", *self.robot.version, self.robot.build))
        elif kind == OUTPUTS:
            self._set_outputs(payload)
        elif kind == INPUTS:
            self._set_inputs(payload)
        elif kind == START:
            self.started = self._packer is not None or bool(self._inputs)
            self._reply(kind, bytes([self.started]))
        elif kind == PAUSE:
            self.started = False
            self._reply(kind, b"\x01")
        elif kind == DATA:
            self._take(payload)
        else:
            raise Malformed(f"frame kind {kind} is not known")

    def _set_outputs(self, payload: bytes) -> None:
        if len(payload) < 8:
            raise Malformed("an output request is shorter than its frequency field")
        frequency = struct.unpack_from(">d", payload)[0]
        names = _names(payload[8:])
        types = [_output_type(name, self.robot.version) for name in names]
        ok = bool(names) and "NOT_FOUND" not in types and 1.0 <= frequency <= self.robot.rate
        self._output, self._packer = [], None
        if ok:
            self._output = names
            self._packer = struct.Struct(">B" + "".join(TYPES[t][0] for t in types))
            self._every = max(1, round(self.robot.rate / frequency))
        self._reply(OUTPUTS, bytes([ok]) + ",".join(types).encode())

    def _set_inputs(self, payload: bytes) -> None:
        names = _names(payload)
        types = []
        for name in names:
            owner = self.robot.claims.get(name)
            if name not in INPUT_VARIABLES:
                types.append("NOT_FOUND")
            elif owner is not None and owner is not self:
                types.append("IN_USE")
            else:
                types.append(INPUT_VARIABLES[name])
        ok = bool(names) and not {"NOT_FOUND", "IN_USE"} & set(types)
        recipe = len(self._inputs) + 1 if ok else 0
        if ok:
            self._inputs[recipe] = names
            self.robot.claims.update(dict.fromkeys(names, self))
        self._reply(INPUTS, bytes([recipe]) + ",".join(types).encode())

    def _take(self, payload: bytes) -> None:
        names = self._inputs.get(payload[0] if payload else 0)
        if names is None or not self.started:
            return
        layout = struct.Struct(">" + "".join(TYPES[INPUT_VARIABLES[name]][0] for name in names))
        if len(payload) != 1 + layout.size:
            raise Malformed(f"recipe {payload[0]} needs {layout.size} bytes, {len(payload) - 1} arrived")
        values = iter(layout.unpack_from(payload, 1))
        for name in names:
            count = TYPES[INPUT_VARIABLES[name]][1]
            taken = [next(values) for _ in range(count)]
            self.robot.write_input(name, taken[0] if count == 1 else taken)

    def _reply(self, kind: int, payload: bytes) -> None:
        self.replies.append(frame(kind, payload))


def _names(payload: bytes) -> list[str]:
    return [name for name in payload.decode("ascii", "replace").split(",") if name]


def _output_type(name: str, version: tuple[int, int, int]) -> str:
    variable = OUTPUT_VARIABLES.get(name)
    return variable.type if variable is not None and variable.known_to(version) else "NOT_FOUND"
