"""Which command-line arguments are recordings: by the suffix of a file or the content of a folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from logs import is_log


def test_a_folder_is_a_recording_if_it_holds_one_and_is_no_arm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "mock-ur10e"
    folder.mkdir()
    (folder / "notes.txt").touch()
    assert not is_log("mock-ur10e")
    for name in ("part_0.mcap", "part_0.db3.zstd", "metadata.yaml"):
        (folder / name).touch()
        assert (is_log("mock-ur10e"), is_log("./mock-ur10e"), is_log(str(folder))) == (True, True, True)
        (folder / "arm.toml").touch()
        assert not is_log("./mock-ur10e")
        (folder / "arm.toml").unlink()
        (folder / name).unlink()


def test_a_file_is_a_recording_by_its_suffix() -> None:
    words = ["a.mcap", "a.CSV", "a.db3", "a.bag", "a.toml", "a", "x" * 5000, "a\0b"]
    assert [is_log(word) for word in words] == [True, True, True, True, False, False, False, False]
