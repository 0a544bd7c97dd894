"""Make a simulated robot arm move like the real one: excite, record, identify, and find the effect that the model is missing.

    from calib import diagnose, identify, load_arm, read_log, validate

The names in __all__ are the public API; they change only after a release that warns of it. Each is imported on first use.
"""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from calib.diagnosis.answer import Diagnosis as Diagnosis
    from calib.diagnosis.diagnose import diagnose as diagnose
    from calib.excitation.session import Session as Session
    from calib.identification.identify import Identification as Identification
    from calib.identification.identify import identify as identify
    from calib.sitting import plan as plan
    from calib.sitting import record as record
    from calib.validation.validate import Validation as Validation
    from calib.validation.validate import validate as validate
    from logs.log import Log as Log
    from logs.read import read_log as read_log
    from safety.plan import Plan as Plan
    from sim.arm import Arm as Arm
    from sim.arm import load_arm as load_arm
    from sim.cell import Cell as Cell
    from sim.cell import load_cell as load_cell
    from sim.errors import CalibError as CalibError
    from sim.trajectory import Trajectory as Trajectory

# public name -> the module that provides it
_FACE = {
    "Arm": "sim.arm",
    "CalibError": "sim.errors",
    "Cell": "sim.cell",
    "Diagnosis": "calib.diagnosis.diagnose",
    "Identification": "calib.identification.identify",
    "Log": "logs.log",
    "Plan": "safety.plan",
    "Session": "calib.excitation.session",
    "Trajectory": "sim.trajectory",
    "Validation": "calib.validation.validate",
    "diagnose": "calib.diagnosis.diagnose",
    "identify": "calib.identification.identify",
    "load_arm": "sim.arm",
    "load_cell": "sim.cell",
    "plan": "calib.sitting",
    "read_log": "logs.read",
    "record": "calib.sitting",
    "validate": "calib.validation.validate",
}
__all__ = list(_FACE)
_HOME = Path(__file__).resolve().parent.parent
_BESIDE = ("safety", "drivers", "logs", "sim")


class _OwnPackages:
    """Import finder that takes this project's packages from beside calib, even if the script's folder has packages of the same names."""

    @staticmethod
    def find_spec(name: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        """The spec of one of this project's packages; None for any other name."""
        return PathFinder.find_spec(name, [str(_HOME)]) if path is None and name in _BESIDE else None


def _claim_own_packages() -> None:
    for name in _BESIDE:
        found = getattr(sys.modules.get(name), "__path__", None)
        if name in sys.modules and (found is None or str(_HOME / name) not in [str(Path(p).resolve()) for p in found]):
            where = getattr(sys.modules[name], "__file__", None) or (list(found) if found else "")
            raise ImportError(
                f"a module {name!r} of another program ({where}) was imported before calib, which has a package of that name; "
                "import calib first, or rename the other module"
            )
    if not any(finder is _OwnPackages for finder in sys.meta_path):
        sys.meta_path.insert(0, _OwnPackages)


_claim_own_packages()


def __getattr__(name: str) -> Any:
    if name not in _FACE:
        raise AttributeError(f"module 'calib' has no attribute {name!r}; its public names: {', '.join(__all__)}")
    return getattr(import_module(_FACE[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
