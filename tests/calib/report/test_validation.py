"""The page of a validation opens in a real browser and says what is left."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from calib.report import validation
from tests.calib.report import examples
from tests.calib.report.browser import Visit


def test_in_a_browser(tmp_path: Path, visit: Callable[..., Visit]) -> None:
    data = examples.motion(1500)
    rms = np.sqrt(np.mean((data["tau"] - data["before"]) ** 2, axis=0))
    entry = {"log": "validation<b>.mcap", "rms": rms, "signal": np.std(data["tau"], axis=0), "forward_rms": np.full(6, 0.004)}
    result = {"arm": "ur10e", "outcome": "The model leaves 3 N m at elbow_joint", "joints": examples.JOINTS, "logs": [entry]}
    evidence = {
        "log": "validation<b>.mcap", "t": data["t"], "tau": data["tau"], "tau_hat": data["before"], "q": data["q"], "dq": data["dq"],
        "t_forward": data["t"], "q_forward": data["q"], "q_hat_forward": data["q"] + 0.004,
    }  # fmt: skip
    seen = visit(validation.write(tmp_path / "validation.html", result, evidence, "bad"))
    assert seen.complaints == []
    text = seen.page.inner_text("body")
    assert "What is left at elbow_joint" in text
    assert "validation<b>.mcap" in text
