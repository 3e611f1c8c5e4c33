"""A browser to drive: the system's Chromium over the pipe of its DevTools protocol, which needs no driver package.

Selenium would be one more dependency, and chromedriver one more program of just the right version, for what these few
commands do: real key presses and taps, paper.
"""

from __future__ import annotations

import base64
import fcntl
import json
import os
import select
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.waiting import PATIENCE_S, until

_OPTIONS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--hide-scrollbars"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--remote-debugging-pipe"),
)
_PROBLEMS = ("Network.requestWillBeSent", "Runtime.exceptionThrown", "Log.entryAdded")
_KEYS = {"Tab": (9, ""), "Enter": (13, "\r"), "ArrowRight": (39, "")}


class Browser:
    """A headless Chromium with a user folder of its own."""

    def __init__(self, chromium: str, folder: Path) -> None:
        # The browser reads commands from descriptor 3 and writes answers to 4. Ours go out of their way first.
        theirs_in, self._out = os.pipe()
        self._in, theirs_out = os.pipe()
        high = [fcntl.fcntl(descriptor, fcntl.F_DUPFD, 20) for descriptor in (theirs_in, theirs_out)]
        code = (
            "import os, sys; os.dup2(int(sys.argv[1]), 3); os.dup2(int(sys.argv[2]), 4); "
            "os.execvp(sys.argv[3], sys.argv[3:])"
        )
        command = [chromium, *_OPTIONS, f"--user-data-dir={folder / 'user'}", "about:blank"]
        self._process = subprocess.Popen(
            [sys.executable, "-c", code, *map(str, high), *command],
            pass_fds=high,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for descriptor in (theirs_in, theirs_out, *high):
            os.close(descriptor)
        self._buffer = b""
        self._count = 0
        self.events: list[dict[str, Any]] = []

    def send(self, method: str, session: str | None = None, **parameters: Any) -> dict[str, Any]:
        """Send a command and return what it answers; events on the way are kept."""
        self._count += 1
        message: dict[str, Any] = {"id": self._count, "method": method, "params": parameters}
        if session is not None:
            message["sessionId"] = session
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self._out, data) :]
        while True:
            answer = self._message()
            if answer.get("id") == message["id"]:
                assert "error" not in answer, (method, answer["error"])
                return dict(answer["result"])
            self.events.append(answer)

    def _message(self) -> dict[str, Any]:
        end = time.monotonic() + PATIENCE_S
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._in], [], [], max(0, end - time.monotonic()))
            assert ready, "the browser does not answer"
            read = os.read(self._in, 1 << 20)
            assert read, "the browser has left"
            self._buffer += read
        first, _, self._buffer = self._buffer.partition(b"\0")
        return dict(json.loads(first))

    def event(self, method: str, session: str) -> dict[str, Any]:
        """Wait for an event and return what it says."""
        while True:
            for index, event in enumerate(self.events):
                if event.get("method") == method and event.get("sessionId") == session:
                    del self.events[index]
                    return dict(event["params"])
            self.events.append(self._message())

    def close(self) -> None:
        """End the browser."""
        if self._process.poll() is None:
            self.send("Browser.close")
        self._process.wait(PATIENCE_S)
        os.close(self._in)
        os.close(self._out)


class Page:
    """A page in a browser profile that nothing else uses."""

    def __init__(self, browser: Browser, downloads: Path, width: int, height: int) -> None:
        self._browser = browser
        self.downloads = downloads
        self.context = browser.send("Target.createBrowserContext")["browserContextId"]
        self.open_tab()
        self.send(
            "Browser.setDownloadBehavior", behavior="allow", downloadPath=str(downloads), browserContextId=self.context
        )
        self.resize(width, height)

    def open_tab(self) -> None:
        """Go on in a new tab of the same profile."""
        browser = self._browser
        self.target = browser.send("Target.createTarget", url="about:blank", browserContextId=self.context)["targetId"]
        self.tab = browser.send("Target.attachToTarget", targetId=self.target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.send(f"{domain}.enable")

    def send(self, method: str, **parameters: Any) -> dict[str, Any]:
        session = None if method.startswith("Browser.") else self.tab
        return self._browser.send(method, session, **parameters)

    def resize(self, width: int, height: int = 844) -> None:
        self.send(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 800
        )

    def open(self, address: str) -> None:
        self.send("Page.navigate", url=address)
        self._browser.event("Page.loadEventFired", self.tab)

    def reload(self) -> None:
        self.send("Page.reload")
        self._browser.event("Page.loadEventFired", self.tab)

    def run(self, code: str) -> Any:
        """The value of a JavaScript expression."""
        answer = self.send("Runtime.evaluate", expression=code, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def text(self, selector: str) -> str:
        return str(self.run(f"document.querySelector({json.dumps(selector)}).textContent")).strip()

    def click(self, selector: str) -> None:
        """Click the middle of an element with the mouse, as a person would."""
        place = self.run(
            f"(async () => {{ const e = document.querySelector({json.dumps(selector)});"
            " e.scrollIntoView({block: 'center', behavior: 'instant'});"
            # The browser finds what is under the mouse by the last frame that it drew.
            " for (let i = 0; i < 2; i++) await new Promise(requestAnimationFrame);"
            " const r = e.getBoundingClientRect();"
            " return [r.x + r.width / 2, r.y + r.height / 2]; })()"
        )
        for kind in ("mousePressed", "mouseReleased"):
            self.send("Input.dispatchMouseEvent", type=kind, x=place[0], y=place[1], button="left", clickCount=1)

    def press(self, name: str, times: int = 1, *, modifiers: int = 0) -> None:
        code, text = _KEYS[name]
        common = {"key": name, "code": name, "windowsVirtualKeyCode": code, "modifiers": modifiers}
        for _ in range(times):
            self.send("Input.dispatchKeyEvent", type="keyDown", text=text, **common)
            self.send("Input.dispatchKeyEvent", type="keyUp", **common)

    def type(self, selector: str, text: str) -> None:
        """Replace what stands in a field, by keyboard."""
        self.run(f"(() => {{ const e = document.querySelector({json.dumps(selector)}); e.focus(); e.select(); }})()")
        self.send("Input.insertText", text=text)

    def wait(self, condition: Callable[[], bool]) -> None:
        until(condition, "what the page is to show")

    def pdf(self) -> bytes:
        return base64.b64decode(self.send("Page.printToPDF", preferCSSPageSize=True)["data"])

    def problems(self) -> list[str]:
        """Network requests and complaints of the page so far."""
        events = [event for event in self._browser.events if event.get("sessionId") == self.tab]
        by_method = {name: [e["params"] for e in events if e.get("method") == name] for name in _PROBLEMS}
        asked, thrown, logged = by_method.values()
        urls = [params["request"]["url"] for params in asked]
        foreign = [url[:200] for url in urls if not url.startswith(("file:", "data:", "blob:", "about:"))]
        return foreign + [json.dumps(params) for params in (*thrown, *logged)]

    def close(self) -> None:
        self._browser.send("Target.disposeBrowserContext", browserContextId=self.context)
