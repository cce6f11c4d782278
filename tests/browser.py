"""The pages' scripts run by Node and by Chromium; tests that use them are skipped where these are not installed; for benchmarks, too."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
import time
import urllib.request
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Any

import pytest

from asterism.report import player_script

NODE, CHROMIUM = shutil.which("node"), shutil.which("chromium") or shutil.which("google-chrome")
needs_node = pytest.mark.skipif(NODE is None, reason="Node.js is not installed")
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")


def in_node(code: str, folder: Path, *, scripts: str = "", **given: Any) -> Any:
    """What the code returns, with `Asterism` and other scripts loaded and `given` defined; as JSON."""
    assert NODE is not None
    values = "\n".join(f"const {name} = {json.dumps(value)};" for name, value in given.items())
    script = folder / "run.js"
    script.write_text(
        f"{player_script()}\n{scripts}\n{values}\n(async () => {{ {code} }})().then(out => console.log(JSON.stringify(out)));",
        encoding="utf-8",
    )
    return json.loads(subprocess.run([NODE, script], capture_output=True, text=True, check=True, timeout=120).stdout)


def opened(address: str, folder: Path, wanted: str) -> str:
    """The page's elements after its scripts have run, with what is wanted. The browser's clock may run out before: three tries."""
    assert CHROMIUM is not None
    elements = ""
    for attempt in range(3):
        words = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder / f'profile-{attempt}'}"]
        budget = f"--virtual-time-budget={5000 * 4**attempt}"
        done = subprocess.run([*words, budget, "--dump-dom", address], capture_output=True, text=True, check=True, timeout=120)
        elements = re.sub(r"<script.*?</script>", "", done.stdout, flags=re.DOTALL)
        if re.search(wanted, elements):
            return elements
    raise AssertionError(f"{wanted} is not in {elements[-3000:]}")


class Tab:
    """A page in Chromium without a window, driven through its DevTools socket. Sounds are allowed, as after a person's touch."""

    def __init__(self, address: str, width: int = 1400, height: int = 900) -> None:
        from websockets.sync.client import connect

        assert CHROMIUM is not None
        self._folder = TemporaryDirectory(ignore_cleanup_errors=True)
        words = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--autoplay-policy=no-user-gesture-required"]
        words += ["--remote-debugging-port=0", f"--user-data-dir={self._folder.name}", f"--window-size={width},{height}", "about:blank"]
        # Into a file: a pipe that nobody reads would stop the browser some day.
        said = Path(self._folder.name) / "said.txt"
        with said.open("w") as stderr:
            self._process = subprocess.Popen(words, stderr=stderr)
        until, target = time.monotonic() + 60.0, None
        while target is None:
            assert time.monotonic() < until and self._process.poll() is None, f"Chromium does not start: {said.read_text()[-2000:]}"
            if (found := re.search(r"DevTools listening on ws://([^/]+)/", said.read_text())) is not None:
                tabs = json.load(urllib.request.urlopen(f"http://{found[1]}/json"))
                target = next((tab for tab in tabs if tab["type"] == "page"), None)
            time.sleep(0.05)
        self._socket = connect(target["webSocketDebuggerUrl"], max_size=None).__enter__()
        self._count = 0
        self._workers = list[str]()
        self.call("Target.setAutoAttach", autoAttach=True, waitForDebuggerOnStart=False, flatten=True)
        self.resize(width, height)
        self.call("Page.navigate", url=address)

    def __enter__(self) -> Tab:
        return self

    def __exit__(self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None) -> None:
        self._socket.__exit__(kind, problem, trace)
        self._process.kill()
        self._process.wait()
        self._folder.cleanup()

    def call(self, method: str, *, in_worker: bool = False, **given: Any) -> Any:
        """The answer of DevTools."""
        answer = self._answer(method, given, in_worker)
        assert "error" not in answer, answer
        return answer["result"]

    def _answer(self, method: str, given: dict[str, Any], in_worker: bool) -> dict[str, Any]:
        self._count += 1
        where = {"sessionId": self._workers[-1]} if in_worker else {}
        self._socket.send(json.dumps({"id": self._count, "method": method, "params": given, **where}))
        while (answer := json.loads(self._socket.recv(timeout=600))).get("id") != self._count:
            if answer.get("method") == "Target.attachedToTarget" and answer["params"]["targetInfo"]["type"] == "worker":
                self._workers.append(answer["params"]["sessionId"])
        return dict(answer)

    def value(self, code: str, *, in_worker: bool = False) -> Any:
        """The value of a piece of script, of the promise that it gives, or None where it raises or another page is being opened.

        in_worker: in the Worker that was begun last, instead of the page
        """
        answer = self._answer("Runtime.evaluate", {"expression": code, "awaitPromise": True, "returnByValue": True}, in_worker)
        return answer.get("result", {}).get("result", {}).get("value")

    def wait(self, code: str, seconds: float = 180.0, *, in_worker: bool = False) -> Any:
        """The value of a piece of script as soon as it is true."""
        until = time.monotonic() + seconds
        while not (value := self.value(code, in_worker=in_worker)):
            assert time.monotonic() < until, f"{code} is never true; the page: {self.value('document.body.innerText')}"
            time.sleep(0.05)
        return value

    def resize(self, width: int, height: int, *, is_phone: bool = False) -> None:
        """Another size of the window, or of a screen that is touched."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1 + is_phone, mobile=is_phone)
        self.call("Emulation.setTouchEmulationEnabled", enabled=is_phone)

    def picture(self, path: Path) -> None:
        """Write what it shows as PNG."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot")["data"]))
