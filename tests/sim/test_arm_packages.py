"""An installed package may add an arm under a name of its own; a user's own folder of that name comes first."""

from pathlib import Path

import pytest

from sim.arm import load_arm
from sim.arm_folder import write_arm
from sim.errors import ConfigError
from sim.plugins import arm_origin, plugins


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Installs a package that adds an arm of the given name."""

    def install(name: str) -> Path:
        home = tmp_path / "site" / "some_arms"
        home.mkdir(parents=True)
        (home / "__init__.py").touch()
        write_arm(home / name, load_arm("servo6"))
        info = home.parent / "some_arms-1.2.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: some-arms\nVersion: 1.2\n")
        (info / "entry_points.txt").write_text(f"[arm_calib.arms]\n{name} = some_arms\n")
        monkeypatch.syspath_prepend(home.parent)
        plugins.cache_clear()
        return home / name

    yield install
    monkeypatch.undo()
    plugins.cache_clear()


def test_an_arm_of_a_package_is_known_by_its_name(package) -> None:
    folder = package("their_arm")
    arm = load_arm("their_arm")
    assert arm.model_path.parent == folder
    assert arm_origin("their_arm", arm.model_path) == "some-arms 1.2"


def test_a_folder_of_the_user_comes_first_and_is_reported_as_such(package, tmp_path: Path) -> None:
    package("their_arm")
    write_arm(tmp_path / "mine" / "arms" / "their_arm", load_arm("servo6"))
    arm = load_arm("their_arm", tmp_path / "mine")
    assert arm.model_path.is_relative_to(tmp_path / "mine")
    assert arm_origin("their_arm", arm.model_path) == "arm-calib"


def test_the_name_of_a_shipped_arm_is_refused(package) -> None:
    package("ur10e")
    with pytest.raises(
        ConfigError, match=r"some-arms 1\.2 adds arm 'ur10e', which arm-calib already has; uninstall that package"
    ):
        load_arm("ur10e")
