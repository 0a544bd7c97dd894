"""ur_rtde CSV files: what is read, and what is refused by row, column, value and rule."""

import time

import numpy as np
import pytest

from logs import State, read_log
from sim.errors import BadLog


def write(path, text):
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_columns_are_read_and_model_outputs_are_not(tmp_path, csv_text):
    log = read_log(write(tmp_path / "a.csv", csv_text()))
    assert len(log) == 50
    assert log.n == 6
    assert log.state is State.UNSTATED
    assert log.t[0] == 0
    np.testing.assert_allclose(np.diff(log.t), 0.002, atol=1e-9)
    assert log.t_origin == 357_700_000_000
    np.testing.assert_allclose(log.q[7], np.round(0.1 * np.sin(0.14 + np.arange(6)), 4))
    np.testing.assert_allclose(log.current[7], np.round(0.1 * np.sin(0.14 + np.arange(12, 18)), 4))
    for absent in (log.tau, log.tau_cmd, log.q_cmd, log.temperature):
        assert absent.shape == (50, 6)
        assert np.isnan(absent).all()
    assert np.isnan(log.t_host).all()


def test_joint_order_is_the_requested_one(tmp_path, csv_text):
    path = write(tmp_path / "a.csv", csv_text())
    plain = read_log(path)
    turned = read_log(path, plain.joint_names[::-1])
    np.testing.assert_array_equal(turned.q, plain.q[:, ::-1])
    with pytest.raises(BadLog, match=r"no 'joint_1'.*wrist_1_joint"):
        read_log(path, [f"joint_{k}" for k in range(1, 7)])


def edit(text, row, column, value):
    lines = text.splitlines()
    cells = lines[row - 1].split(",")
    cells[column] = value
    lines[row - 1] = ",".join(cells)
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        (2, "nan", r"row 9, column actual_q_1: 'nan' is not a finite number"),
        (2, "", r"row 9, column actual_q_1: '' is not a finite number"),
        (2, "0x10", r"row 9, column actual_q_1: '0x10' is not a finite number"),
        (2, "1_0", r"row 9, column actual_q_1: '1_0' is not a finite number"),
        (2, "-1e999", r"row 9, column actual_q_1: '-1e999' is not a finite number"),
        (2, "1e279", r"row 9, column actual_q_1: 1e\+279 rad is not a reading"),
        (2, "253.0", r"row 9, column actual_q_1: 253 rad is not a reading"),
        (8, "1e5", r"row 9, column actual_qd_1: 100000 rad/s is not a reading"),
        (13, "1e9", r"row 9, column actual_current_0: 1e\+09 A is not a reading"),
        (0, "1.0", r"device time runs back"),
    ],
)
def test_a_bad_value_is_named(tmp_path, csv_text, column, value, message):
    path = write(tmp_path / "a.csv", edit(csv_text(), 9, column, value))
    with pytest.raises(BadLog, match=message):
        read_log(path)
    if column:
        log = read_log(path, accept_partial=True)
        assert len(log) == 49
        assert log.state is State.CUT
        assert any("row 9" in finding for finding in log.findings)


@pytest.mark.parametrize("end", ["0.12", "0.1234"])
def test_a_last_row_without_end_of_line_is_not_trusted(tmp_path, csv_text, end):
    text = csv_text()[:-7] + end  # the last number may have had more digits
    with pytest.raises(BadLog, match="row 51: the file ends inside this row"):
        read_log(write(tmp_path / "a.csv", text))
    assert len(read_log(tmp_path / "a.csv", accept_partial=True)) == 49


def test_a_truncated_row_and_compensating_widths_are_seen(tmp_path, csv_text):
    lines = csv_text().splitlines()
    short, long = lines[10].rsplit(",", 1)[0], lines[11] + ",1.0"
    for broken in ([*lines[:10], short, *lines[11:]], [*lines[:10], short, long, *lines[12:]]):
        with pytest.raises(BadLog, match="row 11: 20 values where the header has 21 columns"):
            read_log(write(tmp_path / "a.csv", "\n".join(broken) + "\n"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"", "it is empty"),
        (b"timestamp,actual_q_0\n", r"columns actual_q_1.* are missing"),
        (b"timestamp,actual_q_0," + b"a" * 100_000, "no end of line"),
        (b"time,q0\n1,2\n", "unrecognised format"),
    ],
)
def test_a_file_that_is_none_is_refused(tmp_path, text, message):
    with pytest.raises(BadLog, match=message):
        read_log(write(tmp_path / "a.csv", text))


def test_missing_repeated_and_absent_columns(tmp_path, csv_text):
    text = csv_text()
    with pytest.raises(BadLog, match="columns actual_qd_3 are missing"):
        read_log(write(tmp_path / "a.csv", text.replace("actual_qd_3", "x")))
    with pytest.raises(BadLog, match="'actual_q_1' occurs twice"):
        read_log(write(tmp_path / "a.csv", text.replace("actual_q_2", "actual_q_1")))
    with pytest.raises(BadLog, match="a header and no samples"):
        read_log(write(tmp_path / "a.csv", text.splitlines()[0] + "\n"))


def test_gaps_and_equal_stamps_are_reported_and_kept(tmp_path, csv_text):
    lines = csv_text().splitlines()
    cells = [line.split(",") for line in lines]
    cells[30][0] = cells[29][0]
    text = "\n".join(",".join(row) for row in [*cells[:10], *cells[20:]]) + "\n"
    log = read_log(write(tmp_path / "a.csv", text))
    assert len(log) == 40
    assert any("1 gap" in finding and "about 10 samples are missing" in finding for finding in log.findings)
    assert any("1 sample carries the stamp of the sample before" in finding for finding in log.findings)


def test_windows_line_ends_byte_order_mark_and_quotes(tmp_path, csv_text):
    text = csv_text()
    plain = read_log(write(tmp_path / "a.csv", text))
    head, body = text.split("\n", 1)
    quoted = ",".join(f'"{name}"' for name in head.split(","))
    for other in (b"\xef\xbb\xbf" + text.encode(), text.replace("\n", "\r\n").encode(), f"{quoted}\n{body}".encode()):
        np.testing.assert_array_equal(read_log(write(tmp_path / "b.csv", other)).q, plain.q)


def test_real_recordings(real_data):
    folder = real_data / "ur10e"
    sound = [path for path in sorted(folder.glob("*.csv")) if path.name != "broken_values.csv"]
    assert len(sound) == 12
    for path in sound:
        log = read_log(path)
        assert len(log) > 800
        assert np.isnan(log.tau).all()
        assert np.abs(log.current).max() > 0.1
    with pytest.raises(BadLog, match="row 3, column actual_q_0: 253 rad"):
        read_log(folder / "broken_values.csv")
    survived = read_log(folder / "broken_values.csv", accept_partial=True)
    assert np.abs(survived.q).max() < 2 * np.pi
    assert len(survived) > 1100


@pytest.mark.slow
def test_a_long_file_is_read_in_bulk(tmp_path, csv_text):
    path = write(tmp_path / "a.csv", csv_text(95_000))
    start = time.process_time()
    assert len(read_log(path)) == 95_000
    assert time.process_time() - start < 20  # row by row it is several times that
