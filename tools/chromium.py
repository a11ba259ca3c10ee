"""A headless Chromium for tests and pictures, driven by its DevTools protocol over one WebSocket."""

from __future__ import annotations

import base64
import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--disable-default-apps", "--disable-extensions",
    "--disable-dev-shm-usage", "--mute-audio", "--hide-scrollbars", "--remote-debugging-port=0",
)  # fmt: skip


class ChromiumError(Exception):
    """The browser is missing, has gone, or a page did not do what was asked of it."""


def find_chromium() -> str | None:
    """Path of the browser: $CHROMIUM, or the first of its usual names on the search path."""
    return next((path for name in (os.environ.get("CHROMIUM", ""), *_NAMES) if (path := shutil.which(name))), None)


class Chromium:
    """One browser with one page, an empty profile and no network of its own; a context manager.

    complaints: what the page wrote to the console as an error, threw, or failed to load; requests: addresses of
    everything that it asked for.
    """

    def __init__(self, timeout_s: float = 60.0) -> None:
        path = find_chromium()
        if path is None:
            raise ChromiumError("no Chromium found: apt-get install chromium, or set CHROMIUM to its path")
        self.complaints: list[str] = []
        self.requests: list[str] = []
        self._timeout_s, self._last_id, self._loaded = timeout_s, 0, False
        self._profile = tempfile.mkdtemp(prefix="svc_ros_chromium_")
        self._process = subprocess.Popen(
            [path, *_FLAGS, f"--user-data-dir={self._profile}", "about:blank"],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        try:
            self._socket = self._connect()
            for domain in ("Page", "Runtime", "Log", "Network"):
                self.call(f"{domain}.enable")
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Chromium:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """End the browser with all of its processes, and remove its profile."""
        with suppress(AttributeError):
            self._socket.close()
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        shutil.rmtree(self._profile, ignore_errors=True)

    def call(self, method: str, **params: Any) -> Any:
        """Send one command of the protocol and wait for its answer, noting the events that come before it."""
        self._last_id += 1
        self._socket.send(json.dumps({"id": self._last_id, "method": method, "params": params}))
        while True:
            message = self._receive()
            if message.get("id") == self._last_id:
                if "error" in message:
                    raise ChromiumError(f"{method}: {message['error'].get('message')}")
                return message["result"]

    def open(self, path: Path) -> None:
        """Load a local file and wait until it has loaded; what was noted of the last page is forgotten."""
        self.complaints.clear()
        self.requests.clear()
        self._loaded = False
        self.call("Page.navigate", url=path.resolve().as_uri())
        while not self._loaded:
            self._receive()

    def evaluate(self, expression: str) -> Any:
        """The value of a JavaScript expression, awaited if it is a promise; ChromiumError for an exception."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise ChromiumError(_exception_text(answer["exceptionDetails"]))
        return answer["result"].get("value")

    def wait_for(self, expression: str) -> None:
        """Wait until an expression is true; ChromiumError, with the page's complaints, if it never is."""
        end = time.monotonic() + self._timeout_s
        while not self.evaluate(f"Boolean({expression})"):
            if time.monotonic() > end:
                raise ChromiumError(f"still not true: {expression}; complaints: {self.complaints}")
            time.sleep(0.05)

    def settle(self) -> None:
        """Wait until what was asked for is on the screen."""
        self.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))")

    def resize(self, width: int, height: int, phone: bool = False, scale: float = 1.0) -> None:
        """The size of the window in CSS pixels; a phone has touch, and lays pages out as phones do."""
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=scale, mobile=phone
        )
        self.call("Emulation.setTouchEmulationEnabled", enabled=phone)

    def prefer(self, scheme: str) -> None:
        """What the system prefers: `dark` or `light`."""
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])

    def press(self, key: str) -> None:
        """Press and release a key, named as in KeyboardEvent.key."""
        code = {"Tab": 9, "Enter": 13, "ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39, "ArrowDown": 40}.get(key, 0)
        text = {"Enter": "\r"}.get(key, key if len(key) == 1 else "")
        self.call("Input.dispatchKeyEvent", type="keyDown", key=key, text=text, windowsVirtualKeyCode=code)
        self.call("Input.dispatchKeyEvent", type="keyUp", key=key, windowsVirtualKeyCode=code)

    def click(self, x: float, y: float) -> None:
        """Click at a place of the window, in CSS pixels."""
        self.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def picture(self, whole_page: bool = False) -> bytes:
        """A PNG of the window, or of the whole page."""
        self.settle()
        answer = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole_page)
        return base64.b64decode(answer["data"])

    def _connect(self) -> Any:
        import websocket

        end = time.monotonic() + self._timeout_s
        port_file = Path(self._profile, "DevToolsActivePort")
        while not (port_file.is_file() and port_file.read_text().count("\n")):
            if self._process.poll() is not None or time.monotonic() > end:
                raise ChromiumError(f"the browser did not start (exit code {self._process.poll()})")
            time.sleep(0.05)
        port, address = port_file.read_text().split("\n")[:2]
        browser = websocket.create_connection(
            f"ws://127.0.0.1:{port}{address}", timeout=self._timeout_s, suppress_origin=True,
            http_no_proxy=["127.0.0.1"],
        )  # fmt: skip
        browser.send(json.dumps({"id": 0, "method": "Target.getTargets"}))
        targets = json.loads(browser.recv())["result"]["targetInfos"]
        browser.close()
        page = next(target["targetId"] for target in targets if target["type"] == "page")
        return websocket.create_connection(
            f"ws://127.0.0.1:{port}/devtools/page/{page}", timeout=self._timeout_s, suppress_origin=True,
            http_no_proxy=["127.0.0.1"],
        )  # fmt: skip

    def _receive(self) -> dict[str, Any]:
        message: dict[str, Any] = json.loads(self._socket.recv())
        if "method" in message:
            self._note(message["method"], message["params"])
        return message

    def _note(self, method: str, params: dict[str, Any]) -> None:
        if method == "Page.loadEventFired":
            self._loaded = True
        elif method == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])
        elif method == "Runtime.exceptionThrown":
            self.complaints.append(_exception_text(params["exceptionDetails"]))
        elif method == "Runtime.consoleAPICalled" and params["type"] in ("error", "assert"):
            self.complaints.append(" ".join(str(a.get("value", a.get("description"))) for a in params["args"]))
        elif method == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.complaints.append(params["entry"]["text"])


def _exception_text(details: dict[str, Any]) -> str:
    return str(details.get("exception", {}).get("description") or details.get("text"))
