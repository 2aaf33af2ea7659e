"""Pages in headless Chromium, controlled by chromedriver."""

import io
import json
import shutil
import time
from contextlib import contextmanager

import numpy as np
from PIL import Image
from selenium import webdriver
from selenium.webdriver import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

_NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
_FLAGS = (
    "--headless=new",
    "--no-sandbox",  # the sandbox is not available in containers
    "--disable-background-networking",
    "--disable-component-update",
    "--no-first-run",
    "--hide-scrollbars",
    "--force-device-scale-factor=1",
    "--use-gl=angle",  # WebGL without a graphics card
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)
_DRAWN = "document.body.dataset.drawn !== undefined"
_SECONDS = 30
SIZE = 800, 600


@contextmanager
def browser():
    """Yield a headless Chromium; raise AssertionError if it or chromedriver is missing."""
    program = next(filter(None, map(shutil.which, _NAMES)), None)
    driver = shutil.which("chromedriver")
    advice = "install it by ./run test or apt-get install chromium chromium-driver"
    assert program, f"Chromium, which tests of pages need, is missing; {advice}"
    assert driver, f"chromedriver, which tests of pages need, is missing; {advice}"
    options = webdriver.ChromeOptions()
    options.binary_location = program
    for flag in (*_FLAGS, f"--window-size={SIZE[0]},{SIZE[1]}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    opened = webdriver.Chrome(options, webdriver.ChromeService(driver))
    try:
        yield opened
    finally:
        opened.quit()


class Shown:
    def __init__(self, driver, address, ready=_DRAWN):
        self.driver = driver
        self.resize(*SIZE)
        for kind in ("browser", "performance"):
            driver.get_log(kind)  # discard the logs of earlier pages
        driver.get(address)
        self.until(lambda: self.script(ready))

    def resize(self, width, height, touch=False):
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": touch}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)

    def script(self, text, *given):
        return self.driver.execute_script(f"return {text}", *given)

    def drawn(self):
        """Return the time at which the surfaces were last drawn."""
        return float(self.script("document.body.dataset.drawn"))

    def until(self, condition):
        end = time.monotonic() + _SECONDS
        while not condition():
            assert time.monotonic() < end, f"timeout; the log: {self.log()}"
            time.sleep(0.02)

    def press(self, *keys):
        ActionChains(self.driver).send_keys(*keys).perform()

    def go(self, key, time):
        """Press a key, and wait until the page has drawn the given time."""
        self.press(key)
        self.until(lambda: abs(self.drawn() - time) < 1e-6)

    def find(self, selector):
        return self.driver.find_element(By.CSS_SELECTOR, selector)

    def boxes(self, selector=".view"):
        """Return the boxes of elements by CSS selector: (left, top, right, bottom) in pixels."""
        text = f"""[...document.querySelectorAll("{selector}")].map((each) => {{
            const {{ left, top, right, bottom }} = each.getBoundingClientRect();
            return [left, top, right, bottom];
        }})"""
        return self.script(text)

    def picture(self):
        """Return a screenshot, (height, width, 3)."""
        self.script(
            "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
        )
        png = self.driver.get_screenshot_as_png()
        return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)

    def surface(self, number=0, across=1.0):
        """Return a screenshot of the centre of a panel, ``across`` times its width and height."""
        left, top, right, bottom = self.boxes()[number]
        x, y, share = (left + right) / 2, (top + bottom) / 2, across / 2
        w, h = share * (right - left), share * (bottom - top)
        return self.picture()[round(y - h) : round(y + h), round(x - w) : round(x + w)]

    def centre(self, number=0):
        return np.median(self.surface(number, 0.02).reshape(-1, 3), axis=0)

    def drag(self, number, dx, dy):
        """Drag from the center of a panel."""
        left, top, right, bottom = self.boxes()[number]
        x, y = round((left + right) / 2), round((top + bottom) / 2)
        mouse = ActionChains(self.driver, duration=20)
        mouse.w3c_actions.pointer_action.move_to_location(x, y).pointer_down()
        mouse.w3c_actions.pointer_action.move_to_location(x + dx, y + dy).pointer_up()
        mouse.perform()

    def requests(self):
        """Return the addresses that were requested since the page was opened."""
        entries = [json.loads(each["message"])["message"] for each in self.log("performance")]
        requested = (each for each in entries if each["method"] == "Network.requestWillBeSent")
        return [each["params"]["request"]["url"] for each in requested]

    def log(self, kind="browser"):
        return self.driver.get_log(kind)


__all__ = ["SIZE", "ActionChains", "Keys", "Shown", "browser"]
