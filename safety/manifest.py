"""Everything that a proof and the rules of a run depend on, field by field: what was approved is what runs, to the last digit.

Every setting of the arm folder and the cell is a field under its name in the file. Further fields are the model file,
everything compiled from it, shapes and meshes; long ones are held as SHA-256. A refusal can therefore name what differs.
Defaults are fields too: a software version that changes one needs a new approval.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from pydantic import BaseModel

from drivers.driver import DeviceInfo
from safety.plan import Plan
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import SafetyStop
from sim.version import software_version

Manifest = dict[str, str]
AGAIN = "approve again with `calib record --approve`"
# facts of a driver that may differ at each connection
PASSING = ("bus",)


def manifest_of(plan: Plan, arm: Arm, cell: Cell) -> Manifest:
    """Field -> value as text, or its SHA-256 if long; the same for the same plan, arm folder, cell, meshes and software."""
    out: Manifest = {"software": software_version(), "plan": plan.sha256}
    own = {f.name: getattr(arm, f.name) for f in fields(arm) if f.name not in ("tree", "model_path", "model_text", "sha256")}
    _flatten(own, "arm", out)
    _flatten({f.name: getattr(arm.tree, f.name) for f in fields(arm.tree)}, "arm.model", out)
    out["arm.model file"] = hashlib.sha256(arm.model_text.encode()).hexdigest()
    out["arm.files"] = arm.sha256
    _flatten(cell.table.model_dump(by_alias=True), "cell", out)
    out["cell.file"] = cell.sha256
    for file, content in cell.files.items():
        out[f"cell.mesh {file}"] = hashlib.sha256(content).hexdigest()
    return out


def device_facts(info: DeviceInfo) -> Manifest:
    """Facts of a connected device that must stay: model, serial, firmware, and what its driver adds (such as a calibration)."""
    more = {key: str(value) for key, value in info.extra.items() if key not in PASSING}
    return {"device model": info.model, "serial": info.serial, "firmware": info.firmware, **more}


def digest_of(manifest: Manifest) -> str:
    """SHA-256 of all fields."""
    return hashlib.sha256(json.dumps(manifest, sort_keys=True).encode()).hexdigest()


def require_same(before: Mapping[str, str], now: Mapping[str, str], lead: str) -> None:
    """SafetyStop that names the first field that differs; `lead` begins the sentence."""
    order = sorted(set(before) | set(now), key=lambda name: (name in _WHOLE, name))
    for name in order:
        if before.get(name) != now.get(name):
            was, is_ = (str(x.get(name, "nothing"))[:24] for x in (before, now))
            raise SafetyStop(f"{lead} another {name} ({was}), now it is {is_}; look at what changed, then {AGAIN}")


# fields that differ whenever another one does, so they are named last
_WHOLE = {"arm.files", "cell.file", "arm.model file", "plan", "software"}


def _flatten(value: Any, name: str, out: Manifest) -> None:
    if isinstance(value, BaseModel):
        value = value.model_dump(by_alias=True)
    if isinstance(value, np.ndarray):
        small = value.ndim <= 1 and len(value) <= 64 and value.dtype.kind in "fiub"
        out[name] = (
            repr(value.tolist())
            if small
            else hashlib.sha256(f"{value.shape}".encode() + np.ascontiguousarray(value).tobytes()).hexdigest()
        )
    elif isinstance(value, Mapping):
        for key, part in value.items():
            _flatten(part, f"{name}.{key}", out)
    elif hasattr(value, "__dataclass_fields__"):
        _flatten({f.name: getattr(value, f.name) for f in fields(value)}, name, out)
    elif isinstance(value, (list, tuple)) and any(not isinstance(x, (int, float, str, bool)) for x in value):
        out[name] = f"{len(value)} in all"
        for k, part in enumerate(value):
            _flatten(part, f"{name}.{k}", out)
    else:
        out[name] = repr(value) if value != [] else "none"
