"""After the validation of an identified arm, the diagnosis of its recordings with the arm as it was before."""

from pathlib import Path

import pytest
import tomli_w

from calib.terminal.diagnosis_of_fit import diagnosis_of_fit


def identified(folder: Path, *words: str, verb: str = "identify", directory: Path | None = None) -> str:
    (folder / "arm").mkdir(parents=True)
    run = {"verb": verb, "arm": "servo6", "started": "2026-01-01T00:00:00+00:00", "arguments": [verb, *words]}
    end = {"end": {"exit_code": 0, "sentence": "good"}}
    (folder / "run.toml").write_text(tomli_w.dumps(run | {"directory": str(directory or Path.cwd())} | end))
    return str(folder / "arm")


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def words(arm: str) -> str | None:
    found = diagnosis_of_fit(arm)
    return None if found is None else " ".join(map(str, found))


def test_the_recordings_are_those_of_the_identification() -> None:
    arm = identified(
        Path("fit"), "servo6", "a.mcap", "b.mcap", "--holdout", "c.mcap", "d.mcap", "--cutoff", "9", "--out", "fit"
    )
    assert words(arm) == "diagnose servo6 a.mcap b.mcap --holdout c.mcap d.mcap"
    arm = identified(Path("more"), "servo6", "a.mcap", "--assume", "t=ms", "--accept-partial")
    assert words(arm) == "diagnose servo6 a.mcap --accept-partial --assume t=ms"


def test_only_the_identified_arm_has_torque_constants_from_a_known_mass() -> None:
    arm = identified(Path("fit"), "servo6", "a.mcap", "--loaded", "w.mcap", "--known-mass", "2")
    assert words(arm) == f"diagnose {arm} a.mcap"


def test_of_any_other_arm_nothing_is_known() -> None:
    assert words("servo6") is None
    assert words("nowhere/arm") is None
    assert words(identified(Path("a"), "servo6", "a.mcap", verb="diagnose")) is None
    assert words(identified(Path("b"), "servo6", "a.mcap", directory=Path("/"))) is None
    assert words(identified(Path("c"), "no-such-arm", "a.mcap")) is None
    assert words(identified(Path("d"), "servo6", "a.mcap", "--gone")) is None
