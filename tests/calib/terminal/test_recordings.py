"""Commands refuse a recording that ended early, accept it with --accept-partial, and use the arm that a recording holds."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

import logs
from calib.main import main
from calib.terminal.recordings import arm_and_logs, read_logs, recorded_arm, require
from logs import Recorder, State
from logs.about import About, about_recording, attachments, is_inside
from sim.arm import Arm, load_arm
from sim.cell import load_cell
from sim.errors import BadLog, ConfigError, EmptyLog
from sim.joint_state import JointState
from sim.resources import shipped_configs
from sim.urdf import base_name

SAMPLES = Path(logs.__file__).parent / "samples"


@pytest.fixture
def aborted(tmp_path: Path) -> Path:
    """Forty samples of a UR5e, ended by a fault."""
    arm = load_arm("ur5e")
    path = tmp_path / "aborted.mcap"
    recorder = Recorder(path, arm.joint_names)
    for k in range(40):
        x = np.full(6, 0.001 * k)
        recorder.write(JointState(0.002 * k, 0.002 * k, x, x, x, x, x), x, x, x)
    recorder.close("the emergency stop was pressed")
    return path


def test_it_is_refused_unless_accepted(aborted: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arm = load_arm("ur5e")
    with pytest.raises(BadLog, match=r"emergency stop was pressed.*--accept-partial"):
        read_logs([aborted], arm)
    log = read_logs([aborted], arm, accept_partial=True)[0]
    assert (len(log), log.state) == (40, State.ABORTED)
    assert "the emergency stop was pressed" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["identify", "validate"])
def test_the_commands_refuse_it(command: str, aborted: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([command, "ur5e", str(aborted), "--out", str(aborted.parent / "out")]) == 2
    printed = capsys.readouterr().err
    assert "ended by a fault" in printed
    main([command, "ur5e", str(aborted), "--accept-partial", "--out", str(aborted.parent / "out")])
    assert "ended by a fault (the emergency stop was pressed); record" not in capsys.readouterr().err


def recorded(path: Path, model: Arm, files: dict[str, bytes], **metadata: str) -> Path:
    words = {"arm": model.name, "arm_sha256": model.sha256} | metadata
    with Recorder(path, model.joint_names, words, About("", files)) as recorder:
        for k in range(20):
            x = np.full(model.n, 0.001 * k)
            recorder.write(JointState(0.002 * k, 0.002 * k, x, x, x, x, x))
    return path


def test_a_recording_brings_its_arm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(shipped_configs() / "arms" / "servo6", "mine")
    table = Path("mine/arm.toml").read_text()
    Path("mine/arm.toml").write_text(table.replace('name = "servo6"', 'name = "nobody-has-it"'))
    arm = load_arm("mine")
    about = about_recording(arm, load_cell("mock-ur10e"))
    assert about.frame == base_name(arm)
    assert "<robot" in about.urdf
    assert ".stl" not in about.urdf
    file = recorded(tmp_path / "a.mcap", arm, dict(about.files))
    shutil.rmtree("mine")
    found, logs = arm_and_logs(str(file), [Path("b.mcap")], None)
    assert (found.name, found.sha256, found.joint_names) == (arm.name, arm.sha256, arm.joint_names)
    assert logs == [file, Path("b.mcap")]
    assert set(attachments(file)[0]) == {"arm/arm.toml", "arm/model.xml", "cell.toml"}


def test_a_folder_and_capitals_are_a_recording_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Folders and names in capitals are accepted, as the message states. A folder does not hide an arm of its name."""
    monkeypatch.chdir(tmp_path)
    for name in ("bag", "servo6"):
        Path(name).mkdir()
        recorded(Path(name) / "part_0.mcap", load_arm("servo6"), {})
    Path("X.CSV").touch()
    for word in ("bag", "./servo6"):
        found, given = arm_and_logs(word, None, None)
        assert (found.name, given) == ("servo6", [Path(word)])
    with pytest.raises(ConfigError, match=r"^X\.CSV: neither holds an arm nor names one; name it: `calib \.\.\. ARM X\.CSV`"):
        arm_and_logs("X.CSV", None, None)
    with pytest.raises(ConfigError, match=r"^there is no recording 'Y\.CSV'"):
        arm_and_logs("Y.CSV", None, None)
    recorded(Path("servo6/part_1.mcap"), load_arm("servo6"), {})
    with pytest.raises(ConfigError, match=r"^servo6: neither holds an arm"):
        arm_and_logs("./servo6", None, None)
    Path("servo6/part_1.mcap").unlink()
    arm, given = arm_and_logs("servo6", [Path("servo6")], None)
    assert [len(log) for log in read_logs(given, arm)] == [20]


def test_an_arm_that_was_changed_in_the_recording_is_refused(tmp_path: Path) -> None:
    arm = load_arm("servo6")
    files = dict(about_recording(arm).files)
    files["arm/arm.toml"] = files["arm/arm.toml"].replace(b"rate", b"# \nrate", 1)
    with pytest.raises(BadLog, match="not the one that was recorded"):
        recorded_arm(recorded(tmp_path / "a.mcap", arm, files))


@pytest.mark.parametrize(
    "name",
    [
        "arm/../../out",
        "arm//out",
        "/out",
        "arm/.hidden",
        "arm/\x1b",
        "arm/a/../b",
        "out/arm.toml",
        "arm/" + "a/" * 9 + "b",
        "arm/",
    ],
)
def test_an_attachment_is_never_made_a_file_elsewhere(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    arm = load_arm("servo6")
    file = recorded(tmp_path / "a.mcap", arm, dict(about_recording(arm).files) | {name: b"x"})
    assert not is_inside(name)
    assert recorded_arm(file).sha256 == arm.sha256
    made = {path.name for path in tmp_path.rglob("*") if path.is_file()}
    assert made == {"a.mcap", "arm.toml", "model.xml"}


def test_without_an_arm_inside_the_one_of_that_name_is_taken_and_a_change_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arm = load_arm("servo6")
    assert recorded_arm(recorded(tmp_path / "a.mcap", arm, {})).sha256 == arm.sha256
    assert capsys.readouterr().err == ""
    recorded_arm(recorded(tmp_path / "b.mcap", arm, {}, arm_sha256="0" * 64))
    assert "has changed since this was recorded" in " ".join(capsys.readouterr().err.split())
    for name in ("../servo6", "/etc", ""):
        with pytest.raises(ConfigError, match="neither holds an arm nor names one"):
            recorded_arm(recorded(tmp_path / f"c{len(name)}.mcap", arm, {}, arm=name))


def test_a_recording_without_samples_is_left_out_and_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arm = load_arm("servo6")
    full = recorded(tmp_path / "a.mcap", arm, {})
    Recorder(tmp_path / "b.mcap", arm.joint_names).close("stopped in another motion")
    assert len(read_logs([full, tmp_path / "b.mcap"], arm)) == 1
    assert "holds no sample" in capsys.readouterr().err
    with pytest.raises(EmptyLog):
        read_logs([tmp_path / "b.mcap"], arm)


@pytest.mark.parametrize(("limit", "following"), [("0.1", "calib diagnose {}"), ("0.9", "calib export servo6")])
def test_what_follows_a_validation_without_an_arms_name_can_be_typed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], limit: str, following: str
) -> None:
    file = shutil.copy(SAMPLES / "servo6_excitation.mcap", tmp_path / "a.mcap")
    main(["validate", str(file), "--no-forward", "--max-error", limit, "--out", str(tmp_path / "out"), "--json"])
    assert json.loads(capsys.readouterr().out)["next"] == following.format(file)


@pytest.mark.parametrize("out", [None, "out"])
@pytest.mark.parametrize(
    "words",
    [
        ["identify", "servo6", "typo.csv"],
        ["identify", "servo6", "a.mcap", "--holdout", "typo.csv"],
        ["identify", "servo6", "a.mcap", "--loaded", "typo.csv"],
        ["identify", "typo.csv"],
        ["identify", "servo6", "empty.csv"],
        ["diagnose", "servo6", "typo.csv"],
        ["diagnose", "servo6", "a.mcap", "--baseline", "typo.csv"],
        ["validate", "servo6", "a.mcap", "typo.csv"],
        ["polish", "servo6", "a.mcap", "--holdout", "typo.csv"],
        ["watch", "typo.csv"],
        ["import", "typo.csv"],
        ["import", "empty.csv"],
        ["import", "header.csv", "--yes"],
        ["fleet", "typo"],
    ],
)
def test_a_command_that_cannot_read_its_recordings_makes_no_folder(
    words: list[str], out: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Otherwise the corrected command would be refused, because its folder would already be a run."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(SAMPLES / "servo6_excitation.mcap", "a.mcap")
    Path("empty.csv").touch()
    Path("header.csv").write_text("t,q1,tau1\n")
    before = set(tmp_path.iterdir())
    assert main([*words, *(["--out", out] if out else [])]) == 2
    assert set(tmp_path.iterdir()) == before
    assert re.search(r"there is no recording|it is empty|no samples|is not a folder", capsys.readouterr().err)


def test_a_place_that_is_taken_is_refused_before_anything_is_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "thesis.tex").touch()
    for verb in ("identify", "diagnose", "validate"):
        assert main([verb, "servo6", str(tmp_path / "typo.csv"), "--out", str(tmp_path)]) == 2
        assert "holds files that do not belong to a run" in capsys.readouterr().err


def test_the_sentence_about_a_missing_recording_has_a_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    give = "give the path of a recording: an .mcap or .csv file or a rosbag2 folder"
    with pytest.raises(ConfigError, match=rf"^there is no recording 'a\.csv'; {give}$"):
        require(Path("a.csv"))
    Path("day-one.csv").touch()
    with pytest.raises(ConfigError, match=rf"'day-on\.csv'; did you mean 'day-one\.csv'\? {give}$"):
        require(Path("day-on.csv"))
    with pytest.raises(ConfigError, match=rf"'x\.mcap'; {give}; there are day-one\.csv$"):
        require(Path("x.mcap"))
    with pytest.raises(ConfigError, match=rf"'latest' \(`latest` names a run or an arm\); {give}"):
        require(Path("latest"))
