"""`fgrecon app` in headless Chromium; skips where nicegui, playwright or Chromium is not installed."""

import io
import os
import re
import shutil
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fgrecon.io.coco_keypoints import read_coco_keypoints
from tests.pictures import COLOURS, MEAN, check_like, differences

pytestmark = pytest.mark.browser

REFERENCES = Path(__file__).parent / "references"
SIZES = [(1366, 900, "light"), (1366, 900, "dark"), (390, 844, "light"), (390, 844, "dark")]


@contextmanager
def running(*options):
    """The address of the page with these options."""
    command = [sys.executable, "-m", "fgrecon", "app", "--no-show", "--port", "0", "--max-megabytes", "4", *options]
    environment = os.environ | {"PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as server:
        yield re.search(r"http://\S+", server.stdout.readline())[0]
        server.terminate()


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    pytest.importorskip("nicegui", reason="the extra app is not installed")
    folder = tmp_path_factory.mktemp("models")
    corners = [(x, y, z) for x in (-2.0, 2.0) for y in (0.0, -1.5) for z in (-0.9, 0.9)]
    faces = [
        (1, 2, 4),
        (1, 4, 3),
        (5, 8, 6),
        (5, 7, 8),
        (1, 5, 6),
        (1, 6, 2),
        (3, 4, 8),
        (3, 8, 7),
        (1, 3, 7),
        (1, 7, 5),
    ]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {a} {b} {c}" for a, b, c in [*faces, (2, 6, 8), (2, 8, 4)]]
    (folder / "brick.obj").write_text("\n".join(lines))
    with running("--models", str(folder)) as place:
        yield place


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    chromium = next(
        (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None
    )
    if chromium is None:
        pytest.skip("Chromium is not installed (Debian's package chromium)")
    arguments = [
        "--use-fake-device-for-media-stream",
        "--use-fake-ui-for-media-stream",
        "--no-sandbox",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
    ]
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=chromium, args=arguments)
        yield opened
        opened.close()


@pytest.fixture
def open_page(browser, address):
    """Opens the page, and afterwards checks that nothing came from elsewhere and nothing failed in it."""
    hosts, places, problems, contexts = set(), set(), [], []

    def start(width=1366, height=900, scheme="light", query="", place=address):
        places.add(place.removeprefix("http://"))
        context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(60_000)
        page.on("request", lambda request: hosts.add(request.url.split("/")[2]))
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.goto(place + query)
        return page

    yield start
    for context in contexts:
        context.close()
    assert problems == []
    assert {host for host in hosts if host} <= places


def take_sample(page):
    page.get_by_role("button", name="Sample", exact=True).click()
    page.get_by_text("converged").first.wait_for()
    page.locator(".fg-picture line").first.wait_for()


def wait_for_cars(page, count):
    page.wait_for_function("n => document.querySelectorAll('.q-table tbody tr').length == n", arg=count)


def at(page, u, v):
    box = page.locator(".fg-picture").bounding_box()
    return box["x"] + u * box["width"] / 1242, box["y"] + v * box["width"] / 1242


def drag(page, start, end):
    page.mouse.move(*at(page, *start))
    page.mouse.down()
    page.mouse.move(*at(page, *end), steps=5)
    page.mouse.up()


@pytest.mark.parametrize(("width", "height", "scheme"), SIZES)
def test_the_sample_at_each_size(open_page, width, height, scheme):
    page = open_page(width, height, scheme)
    take_sample(page)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.evaluate("document.body.classList.contains('body--dark')") == (scheme == "dark")
    page.locator("img[src*='above']").wait_for()
    page.mouse.move(5, 5)
    page.wait_for_timeout(1500)
    check_like(REFERENCES / f"{width}-{scheme}.png", seen(page))
    if folder := os.environ.get("FGRECON_SCREENSHOTS"):
        page.screenshot(path=Path(folder) / f"{width}-{scheme}.png", full_page=True)


def test_a_box_is_drawn_and_removed_by_keys(open_page):
    page = open_page()
    take_sample(page)
    wait_for_cars(page, 3)
    page.get_by_role("button", name="Boxes").click()
    page.locator(".fg-edit").wait_for()
    drag(page, (900, 180), (1000, 260))
    wait_for_cars(page, 4)
    page.locator(".fg-picture").focus()
    page.keyboard.press("n")
    page.keyboard.press("Delete")
    wait_for_cars(page, 3)


def test_a_keypoint_is_dragged_and_the_result_follows(open_page):
    page = open_page()
    take_sample(page)
    before = page.locator(".q-table tbody").first.inner_text()
    page.get_by_role("button", name="Keypoints").click()
    point = page.locator(".fg-picture circle").first
    u, v = float(point.get_attribute("cx")), float(point.get_attribute("cy"))
    drag(page, (u, v), (u + 25, v + 12))
    page.wait_for_function("t => document.querySelector('.q-table tbody').innerText != t", arg=before)


def test_steps_scene_downloads_and_code(open_page):
    page = open_page()
    take_sample(page)
    page.get_by_role("tab", name="Steps").click()
    last = int(re.search(r"Step (\d+) of", page.get_by_text(re.compile("Step [0-9]+ of")).inner_text())[1])
    page.locator("[role=slider][aria-label=Step] [tabindex]").first.focus()
    page.keyboard.press("ArrowLeft")
    page.get_by_text(f"Step {last - 1} of").wait_for()
    page.get_by_role("tab", name="3D").click()
    page.locator("canvas").last.wait_for()
    page.get_by_text("brick, ").first.wait_for()
    page.get_by_role("switch", name="Closest car models").click()
    page.get_by_role("tab", name="Other poses").click()
    page.get_by_text("probability").wait_for()
    page.get_by_role("tab", name="Code").click()
    page.get_by_text("fgrecon reconstruct").first.wait_for()
    assert "size_prior=kitti" in page.get_by_role("link", name="A link").get_attribute("href")
    page.get_by_role("tab", name="Save").click()
    for label, beginning in {"GLB": b"glTF", "CSV": b"id,", "Picture": b"\x89PNG", "Recording": b"RRF"}.items():
        with page.expect_download() as download:
            page.get_by_role("button", name=label).click()
        assert Path(download.value.path()).read_bytes().startswith(beginning)


def seen(part):
    """(H, W, 3) what is shown of a page or an element."""
    image = Image.open(io.BytesIO(part.screenshot())).convert("RGB")
    return np.asarray(image.quantize(COLOURS).convert("RGB"))


def test_the_scene_turns_under_the_mouse(open_page):
    page = open_page()
    take_sample(page)
    page.get_by_role("tab", name="3D").click()
    canvas = page.locator("canvas").last
    canvas.wait_for()
    page.wait_for_timeout(3000)
    before, box = seen(canvas), canvas.bounding_box()
    u, v = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(u, v)
    page.mouse.down()
    page.mouse.move(u + 250, v + 20, steps=8)
    page.mouse.up()
    page.wait_for_timeout(1500)
    assert differences(seen(canvas), before)[1] > MEAN  # one that stands still has none


def upload(page, name, content):
    page.locator("input[type=file]").set_input_files({"name": name, "mimeType": "image/png", "buffer": content})


def test_uploads_wrong_ones_and_names_that_are_paths(open_page, sample):
    page = open_page()
    status = page.get_by_role("status")
    upload(page, "../../etc/<b>x.png", b"no image")
    page.get_by_text("Give an image that OpenCV reads").wait_for()
    assert "Traceback" not in status.inner_text()
    upload(page, "a.exe", b"MZ")
    page.get_by_text("of no known kind").wait_for()
    upload(page, "cars.json", b"[" * 50_000)
    page.get_by_text("cars.json").first.wait_for()
    upload(page, "calib.txt", (sample / "calib.txt").read_bytes())
    upload(page, "street.png", (sample / "street.png").read_bytes())
    page.get_by_text("converged").first.wait_for()
    upload(page, "cars.json", (sample / "cars.json").read_bytes())
    page.get_by_text("car-1").first.wait_for()
    upload(page, "boxes.txt", (sample / "boxes.txt").read_bytes())
    page.get_by_text("car-1").first.wait_for(state="detached")
    page.get_by_text("converged").first.wait_for()


def test_a_pasted_text_is_an_upload(open_page, sample):
    page = open_page()
    page.get_by_role("button", name="Sample", exact=True).wait_for()
    paste = """text => {const data = new DataTransfer(); data.setData('text/plain', text);
        document.body.dispatchEvent(new ClipboardEvent('paste', {clipboardData: data, bubbles: true}))}"""
    page.evaluate(paste, (sample / "cars.json").read_text())
    page.get_by_text("car-1").first.wait_for()


def test_a_video_while_the_page_is_used(open_page):
    page = open_page()
    page.get_by_role("button", name="Sample video").click()
    page.get_by_role("button", name="Stop").wait_for(timeout=120_000)
    take_sample(page)
    page.locator("video").wait_for(timeout=300_000)
    page.get_by_text("heading").first.wait_for()
    page.wait_for_function("document.querySelector('video').readyState >= 1")
    assert page.evaluate("document.querySelector('video').duration") > 0.5
    page.evaluate("document.querySelector('video').currentTime = 0.6")
    page.get_by_text(re.compile("Car 0 at 0.[56]0 s")).wait_for()
    for label, beginning in {"Film": b"\0\0\0", "JSON": b'{"format"', "CSV": b"frame,", "Recording": b"RRF"}.items():
        with page.expect_download() as download:
            page.get_by_role("button", name=label).last.click()
        assert Path(download.value.path()).read_bytes().startswith(beginning)


def test_a_video_that_is_none_is_refused_in_words(open_page):
    page = open_page()
    upload(page, "../x.mp4", b"no video" * 1000)
    page.get_by_text("x.mp4").first.wait_for()
    page.get_by_text(re.compile("Give ")).first.wait_for(timeout=120_000)
    assert "Traceback" not in page.content()


def test_by_keyboard_alone(open_page):
    page = open_page()
    page.get_by_role("button", name="Sample", exact=True).wait_for()
    go_by_tab(page, "e => (e.innerText || '').trim().toLowerCase().endsWith('sample')")
    page.keyboard.press("Enter")
    page.get_by_text("converged").first.wait_for()
    wait_for_cars(page, 3)
    go_by_tab(page, "e => (e.innerText || '').trim().toLowerCase() == 'boxes'")
    page.keyboard.press("Enter")
    page.locator(".fg-edit").wait_for()
    go_by_tab(page, "e => e.classList.contains('fg-picture')")
    page.keyboard.press("n")
    page.keyboard.press("Delete")
    wait_for_cars(page, 2)
    go_by_tab(page, "e => e.getAttribute('role') == 'tab'")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Enter")
    page.locator("canvas").last.wait_for()


def test_a_photograph_of_the_webcam_without_a_car(open_page):
    page = open_page()
    page.get_by_role("button", name="Webcam").click()
    page.wait_for_function("(document.querySelector('video') || {}).videoWidth > 0")
    page.get_by_role("button", name="Take").click()
    page.get_by_text("No car was found").wait_for()
    page.locator(".fg-picture img[src*='photograph']").wait_for()


def go_by_tab(page, fits):
    """Press Tab until the element that has the focus fits."""
    for _ in range(40):
        page.keyboard.press("Tab")
        if page.evaluate(f"({fits})(document.activeElement)"):
            return
    pytest.fail(f"Tab does not reach {fits}")


def test_a_link_brings_its_settings_and_bad_ones_are_refused_in_words(open_page):
    page = open_page(query="/?camera_height=1.7&size_prior=kitti")
    assert page.get_by_label("Height of the camera [m]").input_value() == "1.7"
    page = open_page(query="/?prior=/etc/passwd")
    page.get_by_text("Give one of").wait_for()


def test_what_was_made_is_for_its_visitor_alone_and_gone_with_him(open_page, address):
    page = open_page()
    take_sample(page)
    url = page.locator("img[src*='above']").get_attribute("src")
    assert page.request.get(address + url).status == 200
    assert page.request.get(f"{address}/made/guess/above.png").status == 404
    assert page.request.get(f"{address}/made/..%2f..%2fetc/passwd").status == 404
    page.close()
    other = open_page()
    for _ in range(60):
        if other.request.get(address + url).status == 404:
            return
        other.wait_for_timeout(1000)
    pytest.fail("it is still there")


def test_labels_of_a_folder_are_righted_and_saved(open_page, sample, tmp_path):
    for name in ("a.png", "b.png"):
        shutil.copy(sample / "street.png", tmp_path / name)
    with running("--label", str(tmp_path)) as place:
        page = open_page(query="/?camera_height=1.65&size_prior=kitti", place=place)
        page.get_by_text("2 images, 2 looked at, 0 righted.").wait_for(timeout=120_000)
        page.get_by_label("Image").click()
        page.get_by_role("option").first.click()
        wait_for_cars(page, 3)
        point = page.locator(".fg-picture circle").first
        u, v = float(point.get_attribute("cx")), float(point.get_attribute("cy"))
        before = page.locator(".q-table tbody").first.inner_text()
        drag(page, (u, v), (u + 9, v + 5))
        page.wait_for_function("t => document.querySelector('.q-table tbody').innerText != t", arg=before)
        page.get_by_role("button", name="Save, next").click()
        page.get_by_text("2 images, 2 looked at, 1 righted.").wait_for()
        page.get_by_text("Saved 3 cars in labels.json.").wait_for()
        if folder := os.environ.get("FGRECON_SCREENSHOTS"):
            page.screenshot(path=Path(folder) / "labels.png", full_page=True)
    labels = read_coco_keypoints(tmp_path / "labels.json")
    assert len(labels.vehicles) == 3
    dragged = min(np.linalg.norm(car.keypoints - (u + 9, v + 5), axis=1).min() for car in labels.vehicles)
    assert dragged < 2.0


def test_ten_visitors_at_once(open_page):
    pages = [open_page() for _ in range(10)]
    for page in pages:
        page.get_by_role("button", name="Sample", exact=True).click()
    for page in pages:
        page.get_by_text("converged").first.wait_for(timeout=180_000)
