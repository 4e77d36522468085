"""The page in headless Chromium: what a hand on the mouse and the keyboard does to the file."""

from __future__ import annotations

import shutil
import threading

import pytest

from navsim.editor.file import EditedFile
from navsim.editor.server import EditorServer
from navsim.worldfile import load_world

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
DRIVER = shutil.which("chromedriver")
pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(
        CHROMIUM is None or DRIVER is None, reason="needs Chromium and chromedriver (Debian: chromium, chromium-driver)"
    ),
]
ROOM = """\
# A room for one test.
format: 1
size: [6.0, 6.0]

obstacles:
  - box: {name: desk, at: [1.0, 0.0], size: [1.0, 0.5], height: 1.0}   # by the window
  - cylinder: {at: [-1.0, 1.5], radius: 0.2, height: 0.5}
  # Three corners.
  - polygon: {points: [[-2.0, -2.0], [-1.0, -2.0], [-1.5, -1.0]], height: 1.0}
starts:
  - {at: [-2.0, 0.0], yaw_deg: 0}
goals:
  - [2.5, 0.0]  # the door
"""


@pytest.fixture(scope="module")
def browser():
    webdriver = pytest.importorskip("selenium.webdriver", reason="needs selenium (pip install selenium)")
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"):
        options.add_argument(argument)
    options.add_argument("--window-size=1500,1000")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    yield driver
    driver.quit()


class Page:
    """The page of one file, by what can be seen and done on it."""

    def __init__(self, browser, server: EditorServer) -> None:
        from selenium.webdriver.support.ui import WebDriverWait

        self.browser, self.server = browser, server
        self._wait = WebDriverWait(browser, 15, poll_frequency=0.03)
        browser.get(server.url)
        self.until("return document.querySelectorAll('#plan .obstacle').length > 0")
        self.until("return document.getElementById('readout').textContent.startsWith('nearest')")

    def script(self, script: str, *arguments):
        return self.browser.execute_script(script, *arguments)

    def until(self, script: str, *arguments) -> None:
        """Waits until the script returns something true, and the plan shows it: it is painted with the next frame."""
        from selenium.common.exceptions import TimeoutException

        try:
            self._wait.until(lambda _: self.script(script, *arguments))
        except TimeoutException:
            pytest.fail(f"never true: {script} {arguments}; the text is\n{self.text}")
        self.browser.execute_async_script("requestAnimationFrame(() => requestAnimationFrame(arguments[0]))")

    @property
    def text(self) -> str:
        return self.script("return document.getElementById('text').value")

    def until_text(self, part: str) -> None:
        self.until("return document.getElementById('text').value.includes(arguments[0])", part)

    @property
    def image(self) -> str:
        return self.script("return document.getElementById('depth').toDataURL()")

    def until_image_is_not(self, image: str) -> None:
        self.until("return document.getElementById('depth').toDataURL() !== arguments[0]", image)

    def centre(self, selector: str) -> tuple[float, float]:
        return tuple(
            self.script(
                "const b = document.querySelector(arguments[0]).getBoundingClientRect();"
                "return [b.left + b.width / 2, b.top + b.height / 2]",
                selector,
            )
        )

    @property
    def pixels_per_metre(self) -> float:
        return self.script("return document.querySelector('#plan .floor').getBoundingClientRect().width") / 6.0

    def at(self, x: float, y: float) -> tuple[float, float]:
        """Where a place of the room is on the screen."""
        u, v = self.centre("#plan .floor")
        return u + x * self.pixels_per_metre, v - y * self.pixels_per_metre

    def drag(self, begin, end, *, press: bool = True, release: bool = True) -> None:
        from selenium.webdriver.common.actions.action_builder import ActionBuilder

        actions = ActionBuilder(self.browser, duration=20)
        pointer = actions.pointer_action
        pointer.move_to_location(*map(round, begin))
        if press:
            pointer.pointer_down()
        pointer.move_to_location(*(round((a + b) / 2) for a, b in zip(begin, end, strict=True)))
        pointer.move_to_location(*map(round, end))
        if release:
            pointer.pointer_up()
        actions.perform()

    def release(self) -> None:
        from selenium.webdriver.common.actions.action_builder import ActionBuilder

        actions = ActionBuilder(self.browser)
        actions.pointer_action.pointer_up()
        actions.perform()

    def click(self, place) -> None:
        from selenium.webdriver.common.actions.action_builder import ActionBuilder

        actions = ActionBuilder(self.browser, duration=10)
        actions.pointer_action.move_to_location(*map(round, place)).pointer_down().pointer_up()
        actions.perform()

    def keys(self, *keys: str, control: bool = False) -> None:
        from selenium.webdriver import ActionChains, Keys

        chain = ActionChains(self.browser, duration=10)
        if control:
            chain.key_down(Keys.CONTROL)
        chain.send_keys(*keys)
        if control:
            chain.key_up(Keys.CONTROL)
        chain.perform()

    def write(self, old: str, new: str) -> None:
        """Replaces a part of the text as typing does."""
        self.script(
            "const area = document.getElementById('text'), at = area.value.indexOf(arguments[0]);"
            "area.focus(); area.setSelectionRange(at, at + arguments[0].length);"
            "document.execCommand('insertText', false, arguments[1])",
            old,
            new,
        )

    def save(self) -> None:
        self.keys("s", control=True)
        self.until("return document.getElementById('unsaved').hidden")


@pytest.fixture
def page(browser, tmp_path):
    path = tmp_path / "room.yaml"
    path.write_text(ROOM)
    with EditorServer(EditedFile(path)) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
        thread.start()
        yield Page(browser, server)
        complaints = [entry for entry in browser.get_log("browser") if "status of 4" not in entry["message"]]
        browser.get("about:blank")
        server.shutdown()
        thread.join()
    assert not complaints


def test_dragging_an_obstacle_changes_its_numbers_in_the_file_and_nothing_else(page):
    before = page.image
    page.drag(page.at(1.0, 0.0), page.at(1.5, 1.0), release=False)
    page.until_text("at: [1.5, 1.0]")
    page.until_image_is_not(before)  # while the mouse is still down
    page.release()
    assert page.server.file.path.read_text() == ROOM
    assert not page.script("return document.getElementById('unsaved').hidden")
    assert page.script("return !window.dispatchEvent(new Event('beforeunload', {cancelable: true}))")
    page.save()
    moved = ROOM.replace("at: [1.0, 0.0]", "at: [1.5, 1.0]")
    assert page.server.file.path.read_text() == moved
    page.keys("z", control=True)
    page.until("return document.getElementById('text').value === arguments[0]", ROOM)
    page.keys("y", control=True)
    page.until("return document.getElementById('text').value === arguments[0]", moved)
    assert page.script("return window.dispatchEvent(new Event('beforeunload', {cancelable: true}))")


def test_typing_moves_things_in_the_plan_and_mistakes_are_told_where_they_are(page):
    left = page.centre('[data-list="obstacles"][data-index="0"]')
    page.write("at: [1.0, 0.0]", "at: [-1.0, 0.0]")
    page.until(
        "return document.querySelector(arguments[0]).getBoundingClientRect().left < arguments[1]",
        '[data-list="obstacles"][data-index="0"]',
        left[0] - 1.5 * page.pixels_per_metre,
    )
    page.write("radius: 0.2", "radius: -0.2")
    page.until("return document.querySelector('.problem')?.textContent.startsWith('7:')")
    assert "must be greater than 0, not -0.2" in page.script("return document.querySelector('.problem').textContent")
    assert page.script("return document.querySelectorAll('#plan .obstacle').length") == 3  # as it was before
    assert page.script("return document.querySelector('#plan .obstacle.bad').dataset.index") == "1"
    assert not page.script("return document.getElementById('stale').hidden")
    page.script("document.getElementById('plan').focus(); document.querySelector('.problem').click()")
    assert (
        page.script("const t = document.getElementById('text'); return t.value.slice(t.selectionStart, t.selectionEnd)")
        == "-0.2"
    )
    page.keys("z", control=True)
    page.until("return !document.querySelector('.problem') && document.getElementById('stale').hidden")
    page.write("at: [-1.0, 0.0]", "at: [2.5, 0.0]")
    page.until("return document.querySelector('.problem')?.textContent.includes(\"is inside 'desk'\")")
    assert page.script("return document.querySelector('#plan .goal.bad') !== null")
    assert page.script("return document.querySelector('#plan .obstacle.bad').dataset.index") == "0"


def test_things_are_added_turned_duplicated_and_deleted(page):
    page.keys("b")
    page.drag(page.at(0.0, -2.0), page.at(1.0, -1.0))
    page.until_text("  - box: {at: [0.5, -1.5], size: [1.0, 1.0], height: 0.8}\nstarts:")
    page.drag(page.centre(".handle.turn[data-handle=turn]"), page.at(0.5, -0.5))
    page.until_text("height: 0.8, yaw_deg: 90}")
    page.keys("d", control=True)
    page.until("return document.querySelectorAll('#plan .obstacle').length === 5")
    page.keys("\ue017")  # Delete
    page.until("return document.querySelectorAll('#plan .obstacle').length === 4")
    page.click(page.at(0.5, -1.5))
    page.keys("\ue017")
    page.until("return document.getElementById('text').value === arguments[0]", ROOM)
    page.keys("g")
    page.click(page.at(2.0, 2.0))
    page.until_text("  - [2.5, 0.0]  # the door\n  - [2.0, 2.0]\n")
    page.click(page.at(2.5, 0.0))
    page.keys("\ue017")
    page.until("return !document.getElementById('text').value.includes('the door')")
    page.save()
    assert load_world(page.server.file.path).goals[0].at == (2.0, 2.0)


def test_handles_resize_and_move_corners_and_the_panel_takes_numbers(page):
    page.click(page.at(1.0, 0.0))
    page.drag(page.at(1.5, 0.0), page.at(2.0, 0.1))
    page.until_text("at: [1.25, 0.0], size: [1.5, 0.5]")
    page.click(page.at(-1.5, -1.6))
    page.drag(page.at(-1.5, -1.0), page.at(-1.5, -0.5))
    page.until_text("points: [[-2.0, -2.0], [-1.0, -2.0], [-1.5, -0.5]]")
    page.drag(page.at(-1.5, -2.0), page.at(-1.5, -2.5))
    page.until_text("points: [[-2.0, -2.0], [-1.5, -2.5], [-1.0, -2.0], [-1.5, -0.5]]")
    page.click(page.at(-1.0, 1.5))
    page.until("return document.querySelector('#panel input[name=radius]')?.value === '0.2'")
    page.script(
        "const base = document.querySelector('#panel input[name=base]'); base.value = '0.75';"
        "base.dispatchEvent(new Event('change'))"
    )
    page.until_text("- cylinder: {at: [-1.0, 1.5], radius: 0.2, base: 0.75, height: 0.5}")


def test_what_moves_takes_its_way_along(page):
    motion = "motion: {path: [[0.0, -1.0], [0.0, 2.0]], speed: 1}"
    walker = f"  - cylinder: {{at: [0.0, -1.0], radius: 0.2, height: 1.7, {motion}}}\n"
    page.write("starts:\n", walker + "starts:\n")
    page.until("return document.querySelectorAll('#plan .obstacle').length === 4")
    page.drag(page.at(0.0, -1.0), page.at(0.5, -1.5))
    moved = walker.replace("at: [0.0, -1.0]", "at: [0.5, -1.5]").replace(
        "[[0.0, -1.0], [0.0, 2.0]]", "[[0.5, -1.5], [0.5, 1.5]]"
    )
    page.until_text(moved)
    page.drag(page.centre(".handle.way"), page.at(1.0, 2.0))
    page.until_text(moved.replace("[0.5, 1.5]", "[1.0, 2.0]"))


def test_a_handle_of_what_moves_takes_its_way_along(page):
    page.write("height: 1.0}   # by", "height: 1.0, motion: {path: [[1.0, 0.0], [1.0, 2.0]], speed: 1}}   # by")
    page.click(page.at(1.0, 0.0))
    page.until("return document.querySelectorAll('.handle.way').length > 0")
    page.drag(page.at(1.5, 0.0), page.at(2.0, 0.1))
    page.until_text("at: [1.25, 0.0], size: [1.5, 0.5], height: 1.0, motion: {path: [[1.25, 0.0], [1.25, 2.0]]")


def test_the_camera_shows_what_is_in_front_of_it_and_how_far(page):
    before = page.image
    page.drag(page.centre(".camera"), page.at(-2.0, 2.0))
    page.until_image_is_not(before)
    before = page.image
    page.drag(page.centre("[data-handle=camera-turn]"), page.at(-2.0, 2.6))
    page.until_image_is_not(before)
    page.until("return document.getElementById('readout').textContent.startsWith('nearest')")
    box = page.script(
        "const b = document.getElementById('depth').getBoundingClientRect(); return [b.left, b.top, b.width, b.height]"
    )
    page.drag((box[0] + 0.5 * box[2], box[1] + 0.45 * box[3]), (box[0] + 0.5 * box[2] + 1, box[1] + 0.45 * box[3]))
    readout = page.script("return document.getElementById('readout').textContent")
    # The camera looks north, 8.7 cm behind the robot, which is 1 m from the wall.
    assert float(readout.split(" m")[0]) == pytest.approx(1.087, abs=0.02)
    assert page.text == ROOM


def test_a_press_that_finds_the_file_changed_does_not_put_the_old_text_back(page):
    x, y = page.at(1.0, 0.0)
    page.drag((x, y), (x + 1, y), release=False)  # too little to be a drag
    page.server.file.path.write_text("# Theirs.\n" + ROOM)
    page.script("window.dispatchEvent(new Event('focus'))")
    page.until_text("# Theirs.\n# A room for one test.")
    page.drag((x + 1, y), (x + 90, y), press=False)
    assert page.text.startswith("# Theirs.\n")
    page.save()
    assert page.server.file.path.read_text().startswith("# Theirs.\n")


def test_the_plan_follows_the_text_while_a_polygon_is_begun(page):
    page.keys("p")
    page.click(page.at(2.0, 2.0))
    page.write("  - cylinder: {at: [-1.0, 1.5], radius: 0.2, height: 0.5}\n", "")
    page.until("return document.querySelectorAll('#plan .obstacle').length === 2")


def test_a_file_that_has_changed_meanwhile_is_asked_about(page):
    page.write("# A room for one test.", "# Mine.")
    page.server.file.path.write_text("# Theirs.\n" + ROOM)
    page.keys("s", control=True)
    page.until("return document.getElementById('conflict').open")
    assert "changed by another program" in page.script("return document.getElementById('conflict-text').textContent")
    page.script("document.querySelector('#conflict button[value=reload]').click()")
    page.until_text("# Theirs.\n# A room for one test.")
    page.keys("z", control=True)
    page.until_text("# Mine.")
    page.save()
    assert page.server.file.path.read_text() == ROOM.replace("# A room for one test.", "# Mine.")
