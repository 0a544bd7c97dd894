"""The shipped arm folders are what the generator writes from the published table."""

import runpy
from pathlib import Path

import pytest

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
SHIPPED = sorted(p.parent.name for p in CONFIGS.glob("arms/*/arm.toml"))


@pytest.fixture(scope="module")
def regenerated(tmp_path_factory):
    out = tmp_path_factory.mktemp("arms")
    runpy.run_path(str(CONFIGS / "generate_arms.py"))["generate"](out)
    return out


def test_every_shipped_arm_comes_from_the_table(regenerated):
    assert sorted(p.name for p in regenerated.iterdir()) == SHIPPED


@pytest.mark.parametrize("name", SHIPPED)
@pytest.mark.parametrize("file", ["arm.toml", "model.xml"])
def test_files_are_reproduced_byte_for_byte(regenerated, name, file):
    assert (CONFIGS / "arms" / name / file).read_bytes() == (regenerated / name / file).read_bytes()
