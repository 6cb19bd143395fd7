"""The page in a real browser, on the real studio: what somebody does with it, and what is on the screen then."""

import io
import json
from base64 import b64decode
from contextlib import ExitStack
from urllib.parse import unquote

import numpy as np
import pytest
from browsing import a_browser, a_page, until
from PIL import Image

from mmi.walks.walk import Pose, read_walk
from viewer.cells.scene_cache import cell_cache
from viewer.drawing.renderer import Renderer
from viewer.runtime.loop import FrameLoop
from viewer.serving.server import ServerOptions, ServerThread
from viewer.techniques.catalogue import make_technique
from viewer.window.options import StudioOptions
from viewer.window.stage import window_camera
from viewer.window.studio import Studio

FIRST = "globalThis.viewer?.state.header"
POSE = "viewer.state.header.pose"


@pytest.fixture(scope="module")
def studio(dataset):
    with Studio(dataset.path, StudioOptions()) as one:
        yield one


@pytest.fixture(scope="module")
def address(studio):
    with ServerThread(studio, ServerOptions(places=8)) as found:
        yield found


@pytest.fixture(scope="module")
def browser():
    with a_browser() as one:
        yield one


@pytest.fixture
def page(browser, address):
    """The page, with its first picture."""
    with a_page(browser, address) as one:
        until(one, FIRST)
        yield one


def picture_of(page):
    """(h, w, 3) what the canvas shows."""
    data = page.evaluate("document.getElementById('picture').toDataURL('image/png')")
    return np.asarray(Image.open(io.BytesIO(b64decode(data.partition(",")[2]))).convert("RGB"))


def settled(page):
    """Wait until the viewer stands and no new picture has come for a while; the header of the last one."""
    seen = [None]
    for _ in range(60):
        header = page.evaluate("viewer.state.header")
        seen.append(header["frame"])
        if header["still"] and len(seen) > 3 and len(set(seen[-3:])) == 1:
            return header
        page.wait_for_timeout(300)
    raise AssertionError(f"pictures keep coming: {seen}")


def own_picture(scene, header, technique):
    """(h, w, 3) what the run-time draws, with nothing of the viewer, from where a frame was drawn."""
    camera = window_camera(scene.camera, (header["width"], header["height"]))
    x, y, z, azimuth, pitch = header["pose"]
    with Renderer(scene.mesh, scene.ground, size=(camera.width, camera.height)) as renderer:
        cells = cell_cache({scene.name: scene}, renderer)
        try:
            loop = FrameLoop(make_technique(technique, {scene.name: scene}), renderer, cells, camera=camera)
            return loop.frame(Pose((x, y, z), azimuth, pitch), 0.0, read=True).picture.color
        finally:
            cells.close()


def walk(page, key, ms):
    page.keyboard.down(key)
    page.wait_for_timeout(ms)
    page.keyboard.up(key)


def apart(a, b):
    """Metres between two poses as the page has them."""
    return float(np.linalg.norm(np.subtract(a[:3], b[:3])))


# -------------------------------------------------------------------------------------------------------------- start


def test_it_starts_with_a_picture_and_what_a_newcomer_needs(page):
    assert page.title() == "crossroads – view-impostors"
    for words in ("walk", "to look", "help", "Compare", "Side by side", "Guided tour", "Save picture"):
        assert page.get_by_text(words, exact=False).first.is_visible(), words
    assert page.locator("#cover").is_hidden()
    shown = picture_of(page)
    assert len(np.unique(shown.reshape(-1, 3), axis=0)) > 500, "a city, not one colour"
    stage = page.locator("#stage").bounding_box()
    assert (shown.shape[1], shown.shape[0]) == (stage["width"], stage["height"])


def test_every_control_has_a_name_and_text_is_large_enough(page):
    nameless = page.evaluate(
        """[...document.querySelectorAll("button, select, input:not([hidden]), [role=slider], canvas")].filter((one) =>
            !(one.getAttribute("aria-label") || one.textContent.trim() || one.labels?.length)).map((one) => one.outerHTML)"""
    )
    assert nameless == []
    small = page.evaluate(
        """[...document.querySelectorAll("body *")].filter((one) => one.childNodes.length && one.tagName !== "KBD" &&
            [...one.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim()) &&
            parseFloat(getComputedStyle(one).fontSize) < 14).map((one) => one.outerHTML)"""
    )
    assert small == []


def test_the_screen_shows_the_picture_that_was_sent(page):
    """A screenshot of the browser, where nothing stands over the picture, against the canvas's own pixels."""
    page.keyboard.press("1")
    settled(page)
    shown, canvas = np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB"), dtype=int), picture_of(page)
    part = np.s_[70:260, 40 : canvas.shape[1] - 40]
    assert np.abs(shown[part] - canvas[part]).mean() < 2.0


# --------------------------------------------------------------------------------------------------------------- walk


def test_keys_walk_and_turn_and_the_hint_goes(page):
    start = page.evaluate(POSE)
    walk(page, "w", 500)
    there = settled(page)["pose"]
    assert apart(start, there) > 0.5
    along = np.subtract(there[:2], start[:2])
    assert np.dot(along, [np.cos(start[3]), np.sin(start[3])]) > 0.95 * np.linalg.norm(along), "forwards"
    walk(page, "ArrowLeft", 300)
    assert settled(page)["pose"][3] > there[3] + 0.1, "to the left"
    back = settled(page)["pose"]
    walk(page, "s", 300)
    assert apart(settled(page)["pose"], start) < apart(back, start) + 1.5


def test_dragging_moves_the_city_with_the_pointer(page):
    before = settled(page)["pose"]
    page.mouse.move(150, 200)
    page.mouse.down()
    page.mouse.move(250, 180, steps=5)
    page.mouse.up()
    after = settled(page)["pose"]
    assert after[3] > before[3] + 0.1, "dragged to the right: the viewer turns to the left"
    assert after[4] < before[4] - 0.01, "dragged up: it looks down"
    assert page.locator("#card").is_hidden(), "a drag is no click"


def test_keys_do_not_walk_while_somebody_chooses(page):
    before = settled(page)["pose"]
    page.locator("#right").focus()
    walk(page, "ArrowDown", 200)
    page.locator("#budget").focus()
    walk(page, "ArrowLeft", 200)
    assert apart(settled(page)["pose"], before) == 0.0


def test_a_window_that_loses_the_focus_stops_the_walk(page):
    page.keyboard.down("w")
    until(page, "viewer.state.seq > 0 && !viewer.state.header.still")
    page.evaluate("dispatchEvent(new Event('blur'))")
    assert settled(page)["still"]


def test_thumbs_walk_and_look_on_a_tablet(browser, address):
    with a_page(browser, address, size=(800, 500), touch=True) as page:
        until(page, FIRST)
        page.evaluate("document.body.classList.add('folded')")
        start = settled(page)["pose"]
        devices = page.context.new_cdp_session(page)

        def touch(kind, *points):
            spots = [{"x": x, "y": y, "id": i} for i, x, y in points]
            devices.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": spots})

        touch("touchStart", (0, 120, 350))
        touch("touchStart", (0, 120, 350), (1, 600, 200))
        for step in range(1, 9):
            touch("touchMove", (0, 120, 350 - 8 * step), (1, 600 + 6 * step, 200))
            page.wait_for_timeout(40)
        assert page.locator("#stick").is_visible()
        touch("touchEnd")
        end = settled(page)["pose"]
        assert apart(start, end) > 0.3
        assert end[3] > start[3] + 0.02
        assert page.locator("#stick").is_hidden()


def test_on_a_tablet_the_hint_does_not_cover_what_was_asked(browser, address):
    with a_page(browser, address, size=(1024, 700), touch=True) as page:
        until(page, FIRST)
        assert page.locator("#hint").is_visible()
        page.touchscreen.tap(600, 300)
        until(page, "!document.getElementById('card').hidden")
        assert page.evaluate(
            """() => {
                const box = document.getElementById("card-title").getBoundingClientRect();
                const top = document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2);
                return document.getElementById("card").contains(top);
            }"""
        )
        assert not page.locator("#hint").is_visible()
        page.locator("#card-close").tap()
        assert page.locator("#hint").is_visible()


def test_the_map_is_clicked_to_go_somewhere(page):
    before = settled(page)["pose"]
    box = page.locator("#map-picture").bounding_box()
    page.mouse.click(box["x"] + 0.5 * box["width"] + 20, box["y"] + 0.5 * box["height"] + 5)
    until(page, f"Math.abs({POSE}[0] - {before[0]}) + Math.abs({POSE}[1] - {before[1]}) > 1")


# ------------------------------------------------------------------------------------------------------------ compare


def test_the_line_is_dragged_and_each_side_is_its_technique(page, scene):
    page.evaluate("document.body.classList.add('folded')")
    page.locator("#lossless").evaluate("(one) => one.click()")
    settled(page)
    box = page.locator("#divider").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    page.mouse.move(260, box["y"] + 100, steps=6)
    page.mouse.up()
    header = settled(page)
    share = page.evaluate("viewer.state.look.swipe")
    assert abs(share * header["width"] - 260) < 3
    assert page.locator("#divider").get_attribute("aria-valuenow") == str(round(100 * share))
    shown, cut = picture_of(page), round(share * header["width"])
    full, layered = (own_picture(scene, header, name) for name in ("full", "multi-mesh"))
    np.testing.assert_array_equal(shown[:, :cut], full[:, :cut])
    np.testing.assert_array_equal(shown[:, cut:], layered[:, cut:])


@pytest.mark.parametrize("technique", ["full", "multi-mesh"])
def test_lossless_pictures_are_the_run_times_pixel_for_pixel(page, scene, technique, tmp_path):
    page.keyboard.press("1")
    page.locator("#right").select_option(technique)
    page.locator("#lossless").check()
    walk(page, "w", 300)
    header = settled(page)
    assert header["format"] == "png"
    own = own_picture(scene, header, technique)
    np.testing.assert_array_equal(picture_of(page), own)
    with page.expect_download() as saved:
        page.keyboard.press("k")
    saved.value.save_as(tmp_path / "saved.png")
    with Image.open(tmp_path / "saved.png") as image:
        np.testing.assert_array_equal(np.asarray(image), own)
        assert json.loads(image.text["pose"]) == header["pose"]


@pytest.mark.parametrize("mode", ["one", "side", "swipe", "blink", "difference", "wrong"])
def test_modes_show_what_they_say(page, mode):
    page.locator(f"[data-mode={mode}]").click()
    until(page, f"viewer.state.look.mode === '{mode}'")
    page.wait_for_timeout(700)
    header = page.evaluate("viewer.state.header") if mode == "blink" else settled(page)
    pressed = page.locator("#modes [aria-pressed=true]")
    assert pressed.count() == 1
    assert pressed.get_attribute("data-mode") == mode
    assert page.locator("#divider").is_visible() == (mode == "swipe")
    assert page.locator("#left-name").is_visible() == (mode != "one")
    assert page.locator("#numbers thead th").count() == (2 if mode == "one" else 3)
    shown = picture_of(page).astype(int)
    assert shown.shape[:2] == (header["height"], header["width"])
    if mode == "side":
        assert np.abs(shown[:, : shown.shape[1] // 2] - shown[:, -(shown.shape[1] // 2) :]).mean() < 12.0
    if mode == "difference":
        assert shown.mean() < 40.0
    page.keyboard.press("3")


def test_what_pixels_show_is_chosen(page):
    seen = {}
    for key, name in (("n", "picture"), ("l", "layers"), ("z", "depth"), ("o", "objects")):
        page.keyboard.press(key)
        until(page, f"viewer.state.look.show === '{name}'")
        settled(page)
        assert page.locator(f"[data-show={name}]").get_attribute("aria-pressed") == "true"
        seen[name] = picture_of(page).astype(int)
    for name in ("layers", "depth", "objects"):
        assert (np.abs(seen[name] - seen["picture"]).max(axis=2) > 20).mean() > 0.005, name
    page.keyboard.press("n")


def test_frozen_impostors_can_be_flown_around(page):
    before = settled(page)["pose"]
    page.keyboard.press("g")
    until(page, "viewer.state.header.frozen")
    assert page.get_by_text("Frozen:").is_visible()
    assert page.locator("#fly").is_checked()
    walk(page, "e", 400)
    assert settled(page)["pose"][2] > before[2] + 0.5
    page.get_by_role("button", name="Unfreeze").click()
    until(page, "!viewer.state.header.frozen")
    assert not page.locator("#fly").is_checked()
    page.wait_for_timeout(100)
    assert page.get_by_text("Frozen:").count() == 0


def test_a_building_is_clicked_and_its_card_says_why(page, scene):
    page.keyboard.press("p")
    page.locator("#map").evaluate("(one) => { one.hidden = true; }")
    page.keyboard.press("o")
    until(page, "viewer.state.header.width === 900")
    header = settled(page)
    shown = picture_of(page)
    page.keyboard.press("n")
    settled(page)
    sky, ground = shown[2, 2], shown[-3, header["width"] // 4]
    building = (shown != sky).any(axis=2) & (shown != ground).any(axis=2)
    building[:80] = False  # what stands over the picture
    building[:, : header["width"] // 2 + 30] = False  # right of the line: impostors
    rows, columns = np.nonzero(building)
    middle = len(rows) // 2
    page.mouse.click(float(columns[middle]), float(rows[middle]))
    page.locator("#card").wait_for()
    assert page.locator("#card-title").inner_text() in scene.objects
    page.get_by_text("It stays geometry:").or_(page.get_by_text("It is in layer")).wait_for(timeout=40_000)
    assert page.locator("#card").get_by_text("distance").is_visible()
    page.keyboard.press("Escape")
    assert page.locator("#card").is_hidden()


def test_the_worst_region_is_boxed_when_the_viewer_stands_still(page):
    page.keyboard.press("1")
    page.keyboard.press("b")
    until(page, "viewer.state.header.worst", seconds=30.0)
    worst = page.evaluate("viewer.state.header.worst")
    assert (
        page.locator("#promise").inner_text().startswith(("Promised here", "Nothing is promised", worst["why"] or "-"))
    )
    if worst["box"] is None:
        assert "Nothing is wrong" in page.locator("#promise").inner_text()
        return
    box = page.locator("#box").bounding_box()
    np.testing.assert_allclose((box["x"], box["y"]), worst["box"][:2], atol=1.0)
    assert f"{worst['thickness_px']:.1f} px thick" in page.locator("#box").inner_text()
    walk(page, "w", 300)
    assert page.evaluate("viewer.state.header.worst") is None or page.evaluate("viewer.state.header.still")


def test_the_map_knows_the_cell_and_what_it_draws_how(page):
    until(page, "document.querySelectorAll('#map-key span').length > 3")
    page.keyboard.press("m")
    assert page.get_by_text("near: geometry").is_visible()
    page.wait_for_timeout(200)
    data = page.evaluate("document.getElementById('map-picture').toDataURL()")
    shown = np.asarray(Image.open(io.BytesIO(b64decode(data.partition(",")[2]))).convert("RGB")).reshape(-1, 3)
    colours = {tuple(one) for one in shown}
    assert (255, 255, 255) in colours, "near"
    assert (230, 159, 0) in colours, "layer 0, in the colour that tinted pictures have"
    assert (255, 209, 102) in colours, "the cell that the viewer is in, which the viewer's own mark does not hide"
    assert (138, 116, 64) in colours, "where else impostors were built, to be told from the ground"
    assert page.get_by_text("other cells").is_visible()
    page.keyboard.press("m")


# --------------------------------------------------------------------------------------------------------------- keep


def test_pictures_follow_the_size_of_the_window(page):
    page.set_viewport_size({"width": 1000, "height": 430})
    until(page, "viewer.state.header.height === 430")
    settled(page)
    assert picture_of(page).shape[0] == 430
    wide = page.evaluate("viewer.state.header.width")
    page.keyboard.press("p")
    until(page, f"viewer.state.header.width > {wide}")
    assert page.locator("#panel").is_hidden()
    page.keyboard.press("p")
    until(page, f"viewer.state.header.width === {wide}")
    page.locator("#scale").select_option("0.5")
    until(page, "viewer.state.header.height === 215")


def test_a_link_restores_the_view(browser, page):
    walk(page, "w", 300)
    page.keyboard.press("2")
    page.keyboard.press("l")
    pose = settled(page)["pose"]
    page.keyboard.press("c")
    until(page, "location.hash.length > 10")
    link = page.evaluate("location.href")
    assert '"mode":"side"' in unquote(link)
    with a_page(browser, link) as other:
        until(other, FIRST)
        until(other, f"Math.abs({POSE}[0] - {pose[0]}) < 0.001 && viewer.state.look.mode === 'side'")
        np.testing.assert_allclose(settled(other)["pose"], pose, atol=1e-3)
        assert other.evaluate("viewer.state.look.show") == "layers"


def test_a_walk_is_recorded_and_replayed(page, tmp_path):
    page.keyboard.press("r")
    page.locator("#record", has_text="Stop").wait_for()
    walk(page, "w", 500)
    page.keyboard.press("r")
    with page.expect_download() as saved:
        page.get_by_role("button", name="Save the file").click()
    saved.value.save_as(tmp_path / "walk.json")
    recorded = read_walk(tmp_path / "walk.json")
    assert recorded.metres > 0.5
    there = settled(page)["pose"]
    page.get_by_role("button", name="Replay").click()
    until(page, "viewer.state.header.playing === 'walk'")
    until(page, "viewer.state.header.playing === null")
    assert apart(settled(page)["pose"], there) < 0.3


def test_a_guided_tour_goes_until_somebody_walks(page):
    before = settled(page)["pose"]
    page.keyboard.press("t")
    until(page, "viewer.state.header.playing === 'tour'")
    assert page.get_by_role("button", name="Stop the walk").is_visible()
    page.wait_for_timeout(500)
    page.keyboard.press("t")
    until(page, "viewer.state.header.playing === null")
    assert apart(settled(page)["pose"], before) > 0.1


def test_help_opens_and_closes(page):
    page.keyboard.press("?")
    assert page.get_by_text("step left, right").is_visible()
    before = page.evaluate(POSE)
    walk(page, "w", 150)
    assert page.evaluate(POSE) == before, "nobody walks behind the help"
    page.keyboard.press("Escape")
    assert page.get_by_text("step left, right").is_hidden()


# ------------------------------------------------------------------------------------------------- server, and its end


def test_the_page_connects_again_after_the_server_restarts_and_stands_where_it_stood(browser, studio):
    with ExitStack() as stack:
        first = ExitStack()
        address = first.enter_context(ServerThread(studio, ServerOptions()))
        port = int(address.rstrip("/").rpartition(":")[2])
        page = stack.enter_context(a_page(browser, address))
        until(page, FIRST)
        walk(page, "w", 300)
        page.keyboard.press("2")
        pose = settled(page)["pose"]
        first.close()
        until(page, "!document.getElementById('cover').hidden")
        assert page.get_by_text("The viewer does not answer").is_visible()
        stack.enter_context(ServerThread(studio, ServerOptions(port=port)))
        until(page, "document.getElementById('cover').hidden && viewer.state.header")
        header = settled(page)
        np.testing.assert_allclose(header["pose"], pose, atol=1e-3)
        assert page.evaluate("viewer.state.look.mode") == "side"
        walk(page, "w", 300)
        assert apart(settled(page)["pose"], pose) > 0.2


def test_a_fifth_page_waits_and_is_let_in(browser, studio):
    with ServerThread(studio, ServerOptions(places=1)) as address, a_page(browser, address) as page:
        until(page, FIRST)
        with a_page(browser, address) as other:
            until(other, "document.getElementById('cover-title').textContent === 'Others look at the moment'")
            assert other.get_by_text("You are next.").is_visible()
            page.goto("about:blank")
            until(other, FIRST)


def test_a_token_is_in_the_address_once(browser, studio):
    with ServerThread(studio, ServerOptions(token="of-the-tests-own")) as address:
        with a_page(browser, address) as page:
            until(page, FIRST)
            assert page.evaluate("location.search") == ""
            page.reload()
            until(page, FIRST)
        with browser.new_context() as context:
            stranger = context.new_page()
            stranger.goto(address.partition("?")[0])
            assert "holds the token" in stranger.inner_text("body")
