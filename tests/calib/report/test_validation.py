"""The page of a validation is built from its data, opens in a real browser and states the residual."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from calib.report import validation
from tests.calib.report import examples
from tests.calib.report.browser import Visit


def test_in_a_browser(tmp_path: Path, visit: Callable[..., Visit]) -> None:
    data = examples.motion(1500)
    rms = np.sqrt(np.mean((data["tau"] - data["before"]) ** 2, axis=0)).tolist()
    signal = np.std(data["tau"], axis=0).tolist()
    signal[5] = 0.0
    forward = {"horizon_s": 0.25, "windows": 40, "unit": "rad", "rms": [0.004] * 6, "travel": [0.2] * 6}
    entry = {
        "log": "validation<b>.mcap", "residual": rms, "residual_sliding": rms, "signal": signal, "forward": forward,
        "excluded": [["elbow_joint", "saturated", 0.4]],
    }  # fmt: skip
    result = {
        "arm": "ur10e",
        "outcome": "The model leaves 3 N m at elbow_joint",
        "joints": examples.JOINTS,
        "logs": [entry],
        "verdict": "poor",
    }
    curves = {"log": "validation<b>.mcap", "tau_hat": data["before"], **{k: data[k] for k in ("t", "tau", "q", "dq")}}
    seen = visit(validation.write(tmp_path / "validation.html", result, [curves]))
    assert seen.complaints == []
    assert seen.requests == []
    text = seen.page.inner_text("body")
    assert text.index("?") < text.index("The model leaves 3 N m")
    assert "Residual at elbow_joint" in text
    assert "validation<b>.mcap" in text
    assert "error after 0.25 s [mrad]" in text
    assert "saturated" in text
