"""The preview of a plan plays, scrubs and jumps to the closest moment in a real browser, from one file."""

import hashlib
import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from calib.report import plan
from calib.report.scene import scene
from safety.collision import Witness
from sim.arm import load_arm
from sim.cell import load_cell
from sim.trajectory import Trajectory
from tests.calib.report.browser import Visit

REPORT = Path(plan.__file__).parent


@dataclass
class Motion:
    name: str
    kind: str
    trajectory: Trajectory


class Near:
    """A forearm that is closest to the table at the shoulder's greatest angle."""

    pairs = (("forearm", "table"), ("wrist_3", "base"))
    margin = np.array([0.02, 0.01])
    of_self = np.array([False, True])

    def distances(self, q: np.ndarray) -> np.ndarray:
        return np.array([0.5 - 0.3 * q[0], 0.4 + 0.3 * q[0]])

    def nearest_on(self, t: np.ndarray, q: np.ndarray) -> dict[str, Witness]:
        every = np.array([self.distances(x) for x in q])
        places = {"the cell": 0, "itself": 1}
        return {
            to: Witness(self.pairs[p], t[(k := int(every[:, p].argmin()))], every[k, p], self.margin[p])
            for to, p in places.items()
        }


class Kin(Near):
    """Links two joints apart need no margin and are the nearest pair, although another pair has less room beyond its margin."""

    pairs = (("forearm", "wrist_2"), ("forearm", "wrist_3"))
    margin = np.array([0.0, 0.01])
    of_self = np.array([True, True])

    def distances(self, q: np.ndarray) -> np.ndarray:
        return np.array([0.013, 0.02]) + 0.1 * (q[0] + 0.5)

    def nearest_on(self, t: np.ndarray, q: np.ndarray) -> dict[str, Witness]:
        return {"itself": Witness(self.pairs[0], 9.011, 0.0129, 0.0)}


def motion(name: str, seconds: float) -> Motion:
    t = np.linspace(0, seconds, int(100 * seconds) + 1)
    rate = 2 * np.pi / seconds
    wave = np.outer(np.sin(rate * t), np.full(6, 0.5))
    speed = np.outer(np.cos(rate * t), np.full(6, 0.5 * rate))
    home = np.array([0.0, -1.4, 1.3, -1.4, -1.2, 0.3])
    return Motion(name, name, Trajectory(t, home + wave, speed, -wave * rate**2))


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    worth = {
        "condition": 38.2,
        "identified": ["coulomb_3", "mcx_2 - 0.6 m_3"],
        "not_identified": ["Ixx_1"],
        "notes": ["<script>alert(1)</script>"],
    }
    motions = [motion("friction", 12.0), motion("excitation", 8.0)]
    path = tmp_path_factory.mktemp("plan") / "plan.html"
    return plan.write(path, load_arm("ur10e"), load_cell("mock-ur10e"), motions, Near(), worth)


@pytest.mark.parametrize("dark", [False, True])
def test_it_plays_and_scrubs(page: Path, visit: Callable[..., Visit], dark: bool) -> None:
    expect = pytest.importorskip("playwright.sync_api").expect
    seen = visit(page, dark=dark)
    browser = seen.page
    colours = browser.evaluate(
        """() => { const c = document.querySelector("#player canvas"), d = document.createElement("canvas");
        d.width = d.height = 64; const x = d.getContext("2d"); x.drawImage(c, 0, 0, 64, 64);
        const p = x.getImageData(0, 0, 64, 64).data, s = new Set();
        for (let i = 0; i < p.length; i += 4) s.add(`${p[i]},${p[i + 1]},${p[i + 2]}`); return s.size; }"""
    )
    assert colours > 50
    browser.get_by_role("button", name="play").click()
    expect(browser.locator("[data-part=clock]")).not_to_have_text(re.compile(r"^0\.0"))
    browser.get_by_role("button", name="pause").click()
    at, distance = browser.locator("[data-part=scrub]"), browser.locator("[data-part=distance]")
    browser.get_by_role("button", name="closest to itself", exact=True).click()
    assert float(at.input_value()) == pytest.approx(9.0, abs=0.1)
    assert distance.inner_text() == "distance to the cell 650 mm · to itself 250 mm"
    lit = "document.querySelector('[data-lit]').dataset.lit"
    assert browser.evaluate(lit) == "wrist_3 base"
    browser.get_by_role("button", name="closest to the cell", exact=True).click()
    assert float(at.input_value()) == pytest.approx(3.0, abs=0.1)
    assert distance.inner_text() == "distance to the cell 350 mm · to itself 550 mm"
    assert browser.evaluate(lit) == "forearm table"
    heads = browser.locator('[data-motion="friction"] .playhead')
    assert heads.count() == 6
    quarter = heads.first.evaluate("h => (h.getAttribute('x1') - h.dataset.x0) / (h.dataset.x1 - h.dataset.x0)")
    assert quarter == pytest.approx(0.25, abs=0.01)
    at.fill("5")
    assert browser.evaluate(lit) == ""
    browser.locator("[data-part=motion]").select_option("excitation")
    assert browser.locator('[data-motion="friction"]').is_hidden()
    assert browser.locator('[data-motion="excitation"]').is_visible()
    assert "/ 8.00 s" in browser.locator("[data-part=clock]").inner_text()
    assert seen.complaints == []
    assert seen.requests == []


def test_without_webgl_the_rest_still_works(page: Path, visit: Callable[..., Visit]) -> None:
    seen = visit(page, shot="plan-without-webgl", before="HTMLCanvasElement.prototype.getContext = () => null;")
    assert "This browser has no WebGL" in seen.page.inner_text("#player")
    seen.page.get_by_role("button", name="closest to the cell", exact=True).click()
    assert float(seen.page.locator("[data-part=scrub]").input_value()) == pytest.approx(3.0, abs=0.1)


def test_the_sentence_and_the_table_say_what_will_happen(page: Path) -> None:
    html = page.read_text()
    assert "ur10e will move for 20 s in mock-ur10e in 2 motions" in html
    assert "nearest to the cell: forearm and table, 350 mm; nearest to itself: wrist_3 and base, 250 mm" in html
    assert {"closest to the cell [mm]", "closest to itself [mm]"} <= set(re.findall(r">([^<>]+)</button>", html))
    assert "2 of 3 parameters improve over their nominal values" in html
    assert {"Coulomb friction", "mcx*", "Ixx"} <= set(re.findall(r">([^<>]+)</td>", html))
    assert "2 of 3 parameters" in html
    assert "<script>alert(1)" not in html
    assert len(html) < 1_500_000


def test_the_sentence_the_table_and_the_player_give_the_nearest_pair_as_the_record_table_does(tmp_path: Path) -> None:
    html = plan.write(tmp_path / "plan.html", load_arm("ur10e"), None, [motion("validation", 12.0)], Kin()).read_text()
    assert "nearest to itself: forearm and wrist_2, 13 mm" in html
    assert {"12.9", "forearm and wrist_2", "9.011"} <= set(re.findall(r">([^<>]+)</td>", html))
    assert "beyond the margin; least 10 mm" in html
    (near,) = json.loads(re.findall(r'<script[^>]*type="application/json"[^>]*>(.*?)</script>', html, re.S)[0])["motions"][0][
        "near"
    ]
    assert (near["pair"], near["at"], min(near["distance"])) == (["forearm", "wrist_2"], 9.011, 0.0129)


def test_every_shape_of_an_arm_is_drawn() -> None:
    arm = load_arm("servo6")
    assert len(scene(arm, None)["shapes"]) == max(len(arm.tree.shapes), 1)
    assert len(scene(load_arm("ur10e"), load_cell("mock-ur10e"))["shapes"]) == len(load_arm("ur10e").tree.shapes) + 1


def test_the_player_was_built_from_its_source() -> None:
    for line in (REPORT / "assets" / "player.sha256").read_text().splitlines():
        digest, name = line.split()
        assert hashlib.sha256((REPORT / "web" / name).read_bytes()).hexdigest() == digest, f"{name} changed: run `make player`"
