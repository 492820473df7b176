"""The page in a browser: the robot goes to a click; all is large, works by keys too, and says when it is lost."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from live_page.browser import BrowserPage, browser
from live_page.room_session import Served, replaced, room_session

from wheelsight.app.page import NEW, Access, DriveMaps, Session
from wheelsight.app.page.server import PageServer, page_app

pytestmark = [pytest.mark.browser, pytest.mark.slow]


@dataclass
class Opened:
    """A page of a robot in a room."""

    page: BrowserPage
    served: Served
    server: PageServer

    def pixel(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Of a place of the map, in the window."""
        return pixel_of(self.page, x_m, y_m)


def pixel_of(page: BrowserPage, x_m: float, y_m: float) -> tuple[float, float]:
    script = (
        "(() => { const box = canvas.getBoundingClientRect(), at = view().toPixel([%f, %f]);"
        " return [box.left + at[0], box.top + at[1]]; })()"
    )
    x, y = page.value(script % (x_m, y_m))
    return x, y


@contextmanager
def opened(chromium: str, width: int = 1280, height: int = 900, **settings: Any) -> Iterator[Opened]:
    """Once it shows the robot."""
    with room_session(**settings) as served:
        app = page_app(served.session, replaced(settings), Access(True))
        with PageServer(app, "127.0.0.1", 0, replaced(settings)) as server, browser(chromium) as page:
            page.open(f"http://127.0.0.1:{server.port}/", width, height)
            page.until("last !== null && last.robot.pose && pictures.plan && pictures.plan.image")
            yield Opened(page, served, server)
            assert page.problems == []
            assert {url.split("/")[2] for url in page.asked if url.startswith(("http", "ws"))} == {
                f"127.0.0.1:{server.port}"
            }


def test_a_click_drives_there_and_a_drag_says_where_to_look(chromium: str) -> None:
    with opened(chromium) as one:
        one.page.click(*one.pixel(3.5, 3.0))
        reported = one.served.until(lambda reported: reported["state"] == "driving" and reported["goal"])
        assert reported["goal"][:2] == pytest.approx([3.5, 3.0], abs=0.05)
        one.page.until("document.getElementById('state').textContent === 'has arrived'")
        one.page.click(*one.pixel(5.0, 3.0), to=one.pixel(5.0, 4.5))
        reported = one.served.until(lambda reported: reported["state"] == "driving" and reported["goal"][0] > 4.5)
        assert reported["goal"] == pytest.approx([5.0, 3.0, 1.571], abs=0.05)
        assert one.page.value("at('who').textContent") == "you drive"


def test_stop_is_there_for_fingers_and_keys_and_works_under_a_question(chromium: str) -> None:
    with opened(chromium) as one:
        one.page.click(*one.pixel(6.0, 3.0))
        one.served.until(lambda reported: reported["speed_m_s"] > 0.2)
        one.page.key("Escape")
        one.page.until("at('state').textContent.startsWith('stopped: somebody pressed STOP')")
        one.served.until(lambda reported: reported["speed_m_s"] == 0)
        one.page.click(*one.pixel(6.0, 3.0))
        one.served.until(lambda reported: reported["speed_m_s"] > 0.2)
        one.page.value("[...document.querySelectorAll('#maps button')][0].click()")
        assert one.page.value("at('ask').open")
        stop = one.page.value(
            "(() => { const b = at('stop').getBoundingClientRect(); return [b.left + b.width / 2, b.top + 40]; })()"
        )
        one.page.click(*stop)
        one.served.until(lambda reported: reported["stopped"])


def test_all_can_be_done_by_keys(chromium: str) -> None:
    with opened(chromium) as one:
        one.page.value("canvas.focus()")
        for key in [*8 * ["ArrowRight"], "ArrowUp", "q", "Enter"]:
            one.page.key(key)
        reported = one.served.until(lambda reported: reported["state"] == "driving" and reported["goal"])
        assert reported["goal"] == pytest.approx([3.5, 3.25, 0.262], abs=0.05)


def test_a_place_is_named_and_has_a_button(chromium: str) -> None:
    with opened(chromium) as one:
        one.page.value("at('name').value = '<b>küche</b>'; at('name-form').requestSubmit()")
        one.page.until("document.querySelector('#places button')?.textContent === '<b>küche</b>'")
        one.page.click(*one.pixel(3.0, 3.0))
        one.page.until("at('state').textContent === 'has arrived'")
        one.page.value("document.querySelector('#places button').click()")
        one.served.until(lambda reported: reported["state"] == "driving" and reported["goal"][0] < 2)


SIZES = """[...document.querySelectorAll('button, input')]
.filter((one) => one.offsetParent !== null || one.id === 'stop')
.map((one) => [one.textContent || one.id, one.offsetWidth, one.offsetHeight])"""
NAMELESS = """[...document.querySelectorAll('button, input, canvas, img')].filter((one) =>
!(one.textContent.trim() || one.getAttribute('aria-label') || one.labels?.length || one.alt)).map((one) => one.id)"""


@pytest.mark.parametrize("width", [390, 1280])
def test_buttons_are_large_named_and_within_the_window(chromium: str, width: int) -> None:
    with opened(chromium, width, 844) as one:
        sizes = one.page.value(SIZES)
        assert len(sizes) >= 9
        assert [name for name, wide, high in sizes if wide < 48 or high < 48] == []
        assert one.page.value("document.documentElement.scrollWidth") <= width
        assert one.page.value(NAMELESS) == []
        bottom = one.page.value("at('stop').getBoundingClientRect().bottom")
        assert bottom == pytest.approx(844, abs=1)


ABOVE_STOP = """((id) => { const box = at(id).getBoundingClientRect();
return box.height > 0 && box.bottom <= at('stop').getBoundingClientRect().top; })('%s')"""


def test_a_phone_shows_why_it_stands_the_plan_and_its_signs_without_scrolling(chromium: str) -> None:
    with opened(chromium, 390, 844) as one:
        one.page.click(*one.pixel(3.5, 3.0))
        one.page.until("at('state').textContent === 'has arrived'")
        one.page.until("at('why').textContent === 'arrived: (3.50, 3.00) m'")
        one.page.click(*one.pixel(6.0, 3.0))
        one.served.until(lambda reported: reported["speed_m_s"] > 0.2)
        assert one.page.value("at('why').textContent") == ""
        one.page.key("Escape")
        one.page.until("at('why').textContent === 'not arrived: somebody pressed STOP'")
        for element in ("state", "why", "plan", "legend", "costmap", "speed"):
            assert one.page.value(ABOVE_STOP % element), element
        # What was said has a heading of its own, and no fact is called safety.
        assert one.page.value("at('said').previousElementSibling.textContent") == "What happened"
        assert "Safety" not in one.page.value("document.body.textContent")


def test_what_holds_the_robot_is_said_above_the_plan(chromium: str) -> None:
    with opened(chromium, 390, 844) as one:
        held = "holds it: something in the way"
        one.page.value(f"socket.onmessage = null; last.robot.held = {held!r}; heardMs = performance.now(); show()")
        assert one.page.value("at('why').textContent") == f"collision monitor {held}"
        one.page.value("last.robot.problem = 'the port is gone'; show()")
        assert one.page.value("at('why').textContent") == "STOP failed: the port is gone"


def test_the_first_place_that_is_asked_for_brings_a_hint(chromium: str) -> None:
    with opened(chromium, 390, 844) as one:
        assert one.page.value("at('hint').hidden")
        one.page.click(*one.pixel(3.5, 3.0))
        one.page.until("!at('hint').hidden && at('hint').textContent.includes('Drag from a place')")
        one.page.value("hintMs -= HINT_MS + 1; show()")
        assert one.page.value("at('hint').hidden")
        one.page.click(*one.pixel(4.5, 3.0))
        one.served.until(lambda reported: reported["goal"] and reported["goal"][0] > 4.4)
        assert one.page.value("at('hint').hidden")


def test_the_plan_has_a_scale_and_signs(chromium: str) -> None:
    with opened(chromium, 390, 844) as one:
        signs = one.page.value("[...document.querySelectorAll('#legend li')].map((line) => line.textContent)")
        assert {"free", "in the way", "not seen yet", "robot", "driven", "planned"} <= set(signs)
        # The bar is drawn where it is said to be, as long as two metres of the plan.
        drawn = "(() => { const ratio = canvas.width / canvas.clientWidth, w = 2 * view().scale;"
        drawn += " return [12 + w / 2, 12 + w + 9].map((x) => [...pen.getImageData(Math.round(ratio * x),"
        drawn += " Math.round(ratio * (canvas.clientHeight - 12)), 1, 1).data]); })()"
        inside, outside = one.page.value(drawn)
        assert inside[3] == 255
        assert max(inside[:3]) < 90
        assert outside[3] == 0 or min(outside[:3]) > 150
        one.page.value("at('costmap').click()")
        one.page.until("at('legend').textContent.includes('forbidden')")


def test_it_says_when_it_is_alone_and_comes_back(chromium: str) -> None:
    with opened(chromium) as one:
        app = page_app(one.served.session, replaced({}), Access(True))
        one.server.__exit__(None, None, None)
        one.page.until("at('lost').textContent === 'connection lost' && !at('lost').hidden")
        assert one.page.value("at('plan-box').classList.contains('old')")
        assert one.page.value(
            "[...document.querySelectorAll('#places button, #save, #take')].every((one) => one.disabled)"
        )
        one.page.value("at('stop').click()")
        one.page.until("at('refused').textContent.startsWith('STOP did not get through')")
        with PageServer(app, "127.0.0.1", one.server.port, replaced({})):
            one.page.until("at('lost').hidden && at('state').textContent === 'stands'")
        one.page.problems.clear()  # what could not be reached meanwhile


def test_it_says_when_the_robots_program_hangs(chromium: str) -> None:
    with opened(chromium) as one:
        one.served.robot.goes_on.clear()
        one.page.until("""at('lost').textContent === "the robot's program does not answer" """)
        one.served.robot.goes_on.set()
        one.page.until("at('lost').hidden")


def test_a_simulated_robot_drives_to_a_clicked_goal_in_a_map_that_it_makes(chromium: str, tmp_path: Path) -> None:
    from wheelsight.config import load_config
    from wheelsight_sim import SimulationSettings
    from wheelsight_sim.simulator import Simulator

    config = load_config(overrides={"odometry": "wheels,dense", "loops.source": "keyframes"})
    settings = SimulationSettings("studio", realism="real", rate_hz=5.0, size=(160, 120), camera="kinect-v1")
    maps = DriveMaps(config, None, None, tmp_path / "maps", in_step=True)
    with (
        Simulator(settings, limits=config.navigation.limits) as robot,
        Session(robot, maps, config.page, paces=True) as session,
        PageServer(page_app(session, config.page, Access(True)), "127.0.0.1", 0, config.page) as server,
        browser(chromium) as page,
    ):
        begin = robot.T_world_base.copy()
        page.open(f"http://127.0.0.1:{server.port}/")
        page.until("last !== null && last.robot.pose && pictures.camera && pictures.camera.image", 120)
        page.until("pictures.plan.place[2] > 3", 60)
        page.click(*pixel_of(page, 1.2, 0.0))
        page.until("at('state').textContent === 'has arrived'", 240)
        moved = robot.T_world_base[:2, 3] - begin[:2, 3]
        assert float(moved @ moved) ** 0.5 == pytest.approx(1.2, abs=0.25)
        page.value("at('name').value = 'middle'; at('name-form').requestSubmit()")
        page.until("document.querySelector('#places button')?.textContent === 'middle'")
        page.value("at('save').click()")
        page.until(f"last.robot.phase === 'driving' && !last.robot.is_new && last.robot.map !== '{NEW}'", 120)
        page.until("document.querySelector('#places button')?.textContent === 'middle'")
        page.until("last.robot.pose", 60)
        where = json.loads(page.value("JSON.stringify([last.robot.pose, last.robot.places[0].pose])"))
        assert where[0][:2] == pytest.approx(where[1][:2], abs=0.15)
        assert page.problems == []
