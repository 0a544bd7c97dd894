"""Tables of other programs become logs: every format gives the same motion, and names and units are guessed or mapped."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as parquet
import pytest
import scipy.io

from logs.column_guess import guess_map
from logs.column_map import ColumnMap, Columns, of_plain, read_map
from logs.damage import Damage
from logs.log import Log
from logs.table_log import log_of_table
from logs.tables import FORMATS, read_table
from sim.errors import BadLog, ConfigError

N, COUNT = 3, 300
T = 0.004 * np.arange(COUNT)
PHASE = 2.0 * T[:, None] + np.arange(N)
Q, DQ, TAU = 0.5 * np.sin(PHASE), np.cos(PHASE), 8 * np.sin(PHASE + 1)


def taken(path: Path, chosen: ColumnMap | None = None, names: tuple[str, ...] | None = None, accept: bool = False) -> Log:
    damage = Damage(path, accept)
    table = read_table(path, FORMATS, damage)
    return log_of_table(table, chosen or guess_map(table, names)[0], path, damage)


def same(log: Log, rtol: float = 1e-12) -> None:
    np.testing.assert_allclose(log.t, T, atol=1e-9)
    for name, truth in (("q", Q), ("dq", DQ), ("tau", TAU)):
        np.testing.assert_allclose(getattr(log, name), truth, rtol=rtol, atol=rtol)


def csv_text(head: str, columns: list[np.ndarray], separator: str = ",") -> str:
    rows = zip(*(x.tolist() for x in columns), strict=True)
    return "\n".join([head, *(separator.join(map(repr, row)) for row in rows)]) + "\n"


WIDE = [T, *Q.T, *DQ.T, *TAU.T]
PLAIN = "t," + ",".join(f"{stem}{j}" for stem in ("q", "dq", "tau") for j in (1, 2, 3))


@pytest.mark.parametrize(
    "head",
    [
        PLAIN,
        "time [s]," + ",".join(f"{stem}_{j}" for stem in ("position", "velocity", "effort") for j in range(3)),
        "timestamp," + ",".join(f"joint{j}_{stem}" for stem in ("pos", "vel", "torque") for j in (1, 2, 3)),
        "Time," + ",".join(f"{j}.{stem}" for stem in ("position", "velocity", "effort") for j in ("hip", "knee", "ankle")),
        "t," + ",".join(f"{stem}_{j}" for stem in ("q_actual", "qd_actual", "tau_measured") for j in range(1, 4)),
        "sec," + ",".join(f"{stem}[{j}]" for stem in ("qpos", "qvel", "torques") for j in range(3)),
    ],
)
def test_names_that_people_give_to_columns(tmp_path: Path, head: str) -> None:
    file = tmp_path / "a.csv"
    file.write_text(csv_text(head, WIDE))
    log = taken(file)
    same(log)
    assert len(set(log.joint_names)) == 3
    assert "hip" not in head or log.joint_names == ("hip", "knee", "ankle")


@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
@pytest.mark.parametrize("head", [PLAIN, "# comment\n# " + PLAIN])
def test_csv_in_its_dialects(tmp_path: Path, separator: str, head: str) -> None:
    file = tmp_path / "a.txt"
    file.write_bytes(csv_text(head.replace(",", separator), WIDE, separator).replace("\n", "\r\n").encode("utf-8-sig"))
    same(taken(file))


def test_a_comma_as_the_decimal_sign(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    text = csv_text(PLAIN.replace(",", ";"), WIDE, ";")
    file.write_text(text.replace(".", ","))
    same(taken(file))


def test_every_format_gives_the_same_log(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", time=T, q=Q, dq=DQ, tau=TAU)
    np.savez_compressed(tmp_path / "lying.npz", time=T, q=Q.T, dq=DQ.T, tau=TAU.T, note=np.array("bench"))
    scipy.io.savemat(tmp_path / "a.mat", {"data": {"t": T, "q": Q.T, "qd": DQ.T, "torque": TAU.T}, "gain": np.eye(2)})
    parquet.write_table(pa.table({"t": T} | {f"q{j}": Q[:, j] for j in range(N)} | {f"dq{j}": DQ[:, j] for j in range(N)}
                                 | {f"tau{j}": TAU[:, j] for j in range(N)}), tmp_path / "a.parquet")  # fmt: skip
    fields = np.zeros(COUNT, dtype=[("t", "f8"), ("q", "f8", (3,)), ("dq", "f8", (3,)), ("tau", "f8", (3,))])
    fields["t"], fields["q"], fields["dq"], fields["tau"] = T, Q, DQ, TAU
    np.save(tmp_path / "a.npy", fields)
    for file in sorted(tmp_path.iterdir()):
        same(taken(file))


def test_units_in_names_and_in_the_map(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    head = "t_ms," + ",".join(f"{stem}{j}" for stem in ("pos_deg_", "vel_rpm_", "torque_nmm_") for j in (1, 2, 3))
    rpm = 60 / (2 * math.pi)
    file.write_text(csv_text(head, [1e3 * T, *np.degrees(Q).T, *(rpm * DQ).T, *(1e3 * TAU).T]))
    same(taken(file), rtol=1e-9)
    found, _ = guess_map(read_table(file, FORMATS, Damage(file)))
    assert found.channels["q"].unit == "deg"
    flipped = of_plain(
        {
            "joints": ["a", "b", "c"],
            "time": {"column": "t_ms", "unit": "ms"},
            "q": {"columns": ["pos_deg_1", "pos_deg_2", "pos_deg_3"], "unit": "deg", "factor": [1, 1, -1]},
            "tau": {"columns": ["torque_nmm_1", "", "torque_nmm_3"], "unit": "N mm", "factor": -1},
        },
        "here",
    )
    log = taken(file, flipped)
    np.testing.assert_allclose(log.q, Q * [1, 1, -1], rtol=1e-9)
    np.testing.assert_allclose(log.tau[:, [0, 2]], -TAU[:, [0, 2]], rtol=1e-9)
    assert np.isnan(log.tau[:, 1]).all()
    assert np.isnan(log.dq).all()


def test_large_positions_are_doubted_and_taken_as_degrees(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    file.write_text(csv_text(PLAIN, [T, *np.degrees(4 * Q).T, *DQ.T, *TAU.T]))
    found, doubts = guess_map(read_table(file, FORMATS, Damage(file)))
    assert found.channels["q"].unit == "deg"
    assert any("taken as deg" in doubt for doubt in doubts)


def test_a_map_is_kept_as_it_was_stated(tmp_path: Path) -> None:
    one = ColumnMap(
        ("a", "b"),
        "stamp",
        "ms",
        {"q": Columns(("x", "y"), "deg", (1.0, -0.5), 2 * math.pi), "tau": Columns(("", "z"), "N m", (1.0, 1.0))},
        None,
        {"episode_index": 4.0},
    )
    (tmp_path / "map.toml").write_text(one.text())
    assert read_map(tmp_path / "map.toml") == one
    two = ColumnMap(("a",), None, "s", {"q": Columns(("x",), "rad", (1.0,))}, 250.0)
    (tmp_path / "map.toml").write_text(two.text())
    assert read_map(tmp_path / "map.toml") == two


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"joints": ["a", "a"]}, "different names"),
        ({"time": {"column": "t", "unit": "hours"}}, "unit 'hours'"),
        ({"time": {}}, "either column"),
        ({"time": {"rate": -3}}, "between 0 and"),
        ({"time": {"rate": True}}, "not a number"),
        ({"q": {"columns": ["x"], "unit": "rad"}}, "1 names for 2 joints"),
        ({"q": {"columns": ["", "y"], "unit": "rad"}}, "joint 1 has no column; a log needs the position of every joint"),
        ({"q": {"columns": ["x", "y"], "unit": "grad"}}, "unit 'grad'"),
        ({"q": {"columns": ["x", "y"], "unit": "rad", "factor": 0}}, "other than 0"),
        ({"q": {"columns": ["x", "y"], "unit": "rad", "wraps": -1}}, "only a position wraps"),
        ({"tau": {"columns": ["x", "y"], "unit": "N m", "wraps": 6.3}}, "only a position wraps"),
        ({"torque": {}}, "unknown key 'torque'"),
        ({"q": 3}, "unknown key"),
        ({"where": 3}, "table such as"),
    ],
)
def test_a_map_that_breaks_a_rule(change: dict, words: str) -> None:
    good = {"joints": ["a", "b"], "time": {"column": "t"}, "q": {"columns": ["x", "y"], "unit": "rad"}}
    assert of_plain(good, "map").joints == ("a", "b")
    with pytest.raises(ConfigError, match=words):
        of_plain(good | change, "map")


def test_a_lerobot_data_set(tmp_path: Path) -> None:
    """Version 3: several episodes in a file, elements named in meta/info.json."""
    (tmp_path / "meta").mkdir()
    names = ["shoulder.pos", "elbow.pos", "wrist.pos"]
    features = {"observation.state": {"dtype": "float32", "shape": [3], "names": names}, "action": {"names": {"motors": names}}}
    (tmp_path / "meta/info.json").write_text(json.dumps({"codebase_version": "v3.0", "fps": 250, "features": features}))
    (tmp_path / "data/chunk-000").mkdir(parents=True)
    both = {"timestamp": np.r_[T, T], "episode_index": np.repeat([0, 1], COUNT), "frame_index": np.r_[0:COUNT, 0:COUNT]}
    lists = {
        "observation.state": [*np.degrees(Q).tolist(), *np.degrees(2 * Q + 60).tolist()],
        "action": [*Q.tolist(), *Q.tolist()],
    }
    parquet.write_table(pa.table({**both, **lists}), tmp_path / "data/chunk-000/file-000.parquet")
    damage = Damage(tmp_path)
    table = read_table(tmp_path, FORMATS, damage)
    found, doubts = guess_map(table, None, 1)
    assert found.joints == ("shoulder", "elbow", "wrist")
    assert found.where == {"episode_index": 1}
    assert any("2 episodes" in doubt for doubt in doubts)
    log = log_of_table(table, found, tmp_path, damage)
    np.testing.assert_allclose(log.q, 2 * Q + 60, rtol=1e-9)
    assert np.isfinite(log.q_cmd).all()
    with pytest.raises(BadLog, match="none with"):
        log_of_table(table, guess_map(table, None, 7)[0], tmp_path, damage)


def test_a_reading_that_starts_again_after_a_turn(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    t = 0.004 * np.arange(COUNT * 5)
    turning = np.column_stack([12 * t, -9 * t])
    wrapped = (turning + math.pi) % (2 * math.pi) - math.pi
    file.write_text(csv_text("t,q1,q2", [t, *wrapped.T]))
    log = taken(file)
    np.testing.assert_allclose(log.q, turning, atol=1e-9)
    assert any("wrapped" in finding for finding in log.findings)


REAL = {
    "panda/excitation_0_15s.csv": (7, {"q", "dq", "tau"}),
    "rokae/rokae1.csv": (7, {"q", "dq", "tau"}),
    "sh_electric/traj1.csv": (6, {"q", "dq", "tau"}),
    "sh_electric/traj2.csv": (6, {"q", "dq", "tau"}),
    "ur5e_joint/joint_5.csv": (1, {"q", "dq", "tau", "q_cmd", "dq_cmd"}),
    "ur10e/excitation_20s_8h.csv": (6, {"q", "dq", "current"}),
    "damiao": (1, {"q", "dq", "tau", "temperature", "dq_cmd"}),
    "servo_pendulum": (1, {"q", "dq", "temperature", "q_cmd"}),
}


@pytest.mark.parametrize("place", REAL)
def test_the_seven_published_sets(real_data: Path, place: str) -> None:
    """The guess from the names alone is right for every one of them, and no sample is left out."""
    joints, channels = REAL[place]
    files = sorted((real_data / place).glob("*.csv")) if not place.endswith(".csv") else [real_data / place]
    if not files or not all(file.is_file() for file in files):
        pytest.skip(f"{place} is not in ARM_CALIB_DATA")
    for file in files:
        log = taken(file)
        assert log.n == joints
        measured = {name for name in REAL["damiao"][1] | {"current", "q_cmd"} if np.isfinite(getattr(log, name)).any()}
        assert measured == channels
        with file.open() as lines:
            assert len(log) == sum(1 for _ in lines) - 1
