"""A run that cannot be recorded because the disk is full changes nothing in a folder that it would continue."""

import resource
from pathlib import Path

import pytest

from calib.past_runs import FILE
from calib.run_folder import end_run, new_run


def test_a_full_disk_leaves_the_run_that_goes_on_as_it_was(tmp_path: Path) -> None:
    """A session continues in its folder; if that cannot be recorded, its record is the one before."""
    out = tmp_path / "session"
    folder = new_run("ur5e", "go", out, continues=True)
    end_run(folder, 1, "stopped")
    before = (folder / FILE).read_text()
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (40, limit[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            new_run("ur5e", "go", out, continues=True)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    assert (folder / FILE).read_text() == before
    assert sorted(f.name for f in folder.iterdir()) == [FILE]
    assert new_run("ur5e", "go", out, continues=True) == folder
