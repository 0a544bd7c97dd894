"""Work continues when nobody can read its output, and the exit code states whether the answer was read."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from sim.files import read_toml

FULL = Path("/dev/full")


def calib(redirected: str, *words: object, folder: Path) -> subprocess.CompletedProcess[str]:
    line = f'exec "$@" {redirected}'
    command = ["bash", "-c", line, "bash", sys.executable, "-m", "calib", *map(str, words)]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def without_reader(*words: object, folder: Path, both: bool = False) -> subprocess.CompletedProcess[str]:
    read, write = os.pipe()
    os.close(read)
    command = [sys.executable, "-m", "calib", *map(str, words)]
    error = subprocess.STDOUT if both else subprocess.PIPE
    done = subprocess.run(command, cwd=folder, stdout=write, stderr=error, text=True, check=False)
    os.close(write)
    return done


@pytest.mark.parametrize("words", [["help"], ["effects"], ["effects", "--json"], ["runs"], ["--help"], ["--version"]])
def test_an_answer_whose_reader_has_gone_ends_as_a_shell_expects(words: list[str], tmp_path: Path) -> None:
    done = without_reader(*words, folder=tmp_path)
    assert (done.returncode, done.stderr) == (141, "")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("both", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_run_whose_reader_has_gone_ends_with_what_it_found(tmp_path: Path, both: bool) -> None:
    done = without_reader("export", "ur10e", "--out", "run", folder=tmp_path, both=both)
    assert done.returncode == 141
    assert read_toml(tmp_path / "run/run.toml")["end"]["exit_code"] == 0


@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full")
def test_a_full_standard_output_is_named_and_the_run_is_what_it_is(tmp_path: Path) -> None:
    done = calib(">/dev/full", "export", "ur10e", "--out", "run", folder=tmp_path)
    assert done.returncode == 2
    assert (
        done.stderr.splitlines()[-1]
        == "calib: standard output cannot be written: No space left on device; the result is in run"
    )
    assert read_toml(tmp_path / "run/run.toml")["end"]["exit_code"] == 0


@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full")
@pytest.mark.parametrize("redirected", ["2>/dev/full", "2>&-"])
def test_work_goes_on_where_only_progress_cannot_be_written(redirected: str, tmp_path: Path) -> None:
    done = calib(redirected, "export", "ur10e", "--out", "run", folder=tmp_path)
    assert done.returncode == 0
    assert "run" in done.stdout
    assert read_toml(tmp_path / "run/run.toml")["end"]["exit_code"] == 0


def test_a_closed_standard_output_is_one_sentence(tmp_path: Path) -> None:
    done = calib(">&-", "runs", folder=tmp_path)
    assert (done.returncode, done.stderr) == (2, "calib: standard output cannot be written: it is closed\n")


def test_what_fails_fails_as_ever_where_nobody_reads(tmp_path: Path) -> None:
    assert without_reader("effects", "payloat", folder=tmp_path).returncode == 2
