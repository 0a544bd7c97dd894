"""The content of a file is read within bounds or refused in one sentence, and never controls a terminal."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from sim.errors import ConfigError
from sim.files import checked_label, is_name, printable, read_bytes, read_toml, toml_table, write_atomically


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x = " + "9" * 5000, "not valid TOML"),
        ("x = " + "9" * 40, "an integer beyond 64 bits"),
        ("x = [" + "[" * 5000, "nested too deeply"),
        ("x = " + "{a=" * 5000, "nested too deeply"),
        ("a" + ".a" * 100_000 + " = 1", "line 1: a key of more than 16 dotted parts"),
        ('x = 1\n"a b"' + '."c d"' * 30 + " = 1", "line 2: a key of more than 16 dotted parts"),
        ('\\"' * 100_000, "not valid TOML"),
        ("x = '\x00'", "not valid TOML"),
    ],
)
def test_a_table_that_would_cost_too_much_is_refused(text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        toml_table(text, Path("a.toml"))


def test_dots_that_are_no_key_are_no_depth() -> None:
    text = 'a.b.c = 1\nversion = "1.2.3.4.5.6.7.8.9.10.11.12.13.14.15.16.17"\nx = [1.5, 2.5]\n'
    assert toml_table(text, Path("a.toml"))["a"] == {"b": {"c": 1}}


def test_only_regular_files_are_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.toml")
    for file, words in (
        (tmp_path / "pipe.toml", "not a regular file"),
        (Path("/dev/zero"), "not a regular file"),
        (tmp_path, "not a regular file"),
        (tmp_path / "none", "No such file"),
        (Path("a\0b"), "a.x00b: cannot be read"),
        (tmp_path / ("x" * 300), "File name too long"),
    ):
        with pytest.raises(ConfigError, match=words):
            read_toml(file)
    (tmp_path / "large").write_bytes(bytes(101))
    with pytest.raises(ConfigError, match="101 bytes, at most 100"):
        read_bytes(tmp_path / "large", 100)
    assert read_bytes(tmp_path / "large", 101) == bytes(101)


@pytest.mark.parametrize("name", ["ur10e", "7", "a" * 64, "my-arm_2.1"])
def test_names(name: str) -> None:
    assert is_name(name)
    assert checked_label(name) == name


@pytest.mark.parametrize("name", ["", "a" * 65, ".a", "-a", "_a", "a/b", "a\\b", "a b", "a\n", "ä", "a\x00", "../a", "a\u202e"])
def test_what_is_no_name(name: str) -> None:
    assert not is_name(name)


@pytest.mark.parametrize("label", ["", "a" * 201, "a\nb", "a\tb", "\x1b[31m", "a\u202eb", "\x9b2J", "\ud800"])
def test_what_is_no_label(label: str) -> None:
    with pytest.raises(ValueError, match="must h"):
        checked_label(label)


def test_control_characters_become_visible() -> None:
    assert printable("a\x1b]0;x\x07b\x9b2J\u202ec\ud800\nd\te ä 漢") == "a\\x1b]0;x\\x07b\\x9b2J\\u202ec\\ud800\nd\te ä 漢"


def test_a_file_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    file = tmp_path / "a.toml"
    for text in ("x = 1\n", "x = 2\n"):
        write_atomically(file, text)
    assert file.read_text() == "x = 2\n"
    (tmp_path / "taken").mkdir()
    with pytest.raises(OSError, match="taken"):
        write_atomically(tmp_path / "taken", "x = 3\n")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.toml", "taken"]


@pytest.mark.parametrize("step", ["replace", "fsync"])
def test_a_full_disk_leaves_the_file_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str) -> None:
    file = tmp_path / "a.toml"
    write_atomically(file, "old")

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", "somewhere")

    monkeypatch.setattr(os, step, full)
    with pytest.raises(OSError, match="No space left") as caught:
        write_atomically(file, "new")
    assert caught.value.filename == str(file)
    assert file.read_text() == "old"
    assert len(list(tmp_path.iterdir())) == 1
