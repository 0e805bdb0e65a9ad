"""A headless Chromium with the network off, spoken to over two pipes."""

import base64
import itertools
import json
import os
import shutil
import subprocess

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
CHROMIUM_MISSING = "no Chromium to open the report in: install Debian's package chromium"
CHROMIUM_FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader",
    "--hide-scrollbars", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage",
    "--remote-debugging-pipe", "--allow-file-access-from-files=false",
)  # fmt: skip


class Browser:
    """Chromium on one page; requests and complaints are what the page asked for and said.

    Every request but for files is refused by a host map and a proxy that does not exist.
    """

    def __init__(self, profile, *flags):
        (command, self._command_pipe), (self._answer_pipe, answer) = os.pipe(), os.pipe()
        off = "--host-resolver-rules=MAP * ~NOTFOUND", "--proxy-server=127.0.0.1:9"
        arguments = [
            CHROMIUM,
            *CHROMIUM_FLAGS,
            *off,
            f"--user-data-dir={profile}",
            *flags,
            "about:blank",
        ]

        def at_3_and_4():
            # Chromium reads commands from 3 and answers on 4.
            kept = os.dup(command), os.dup(answer)
            os.dup2(kept[0], 3)
            os.dup2(kept[1], 4)

        self._process = subprocess.Popen(
            arguments,
            preexec_fn=at_3_and_4,
            close_fds=False,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(command)
        os.close(answer)
        self._ids, self._buffer, self._session = itertools.count(1), b"", None
        self.requested_urls, self.page_errors, self._events = [], [], []
        targets = self.send_command("Target.getTargets")["targetInfos"]
        page = next(t["targetId"] for t in targets if t["type"] == "page")
        attached = self.send_command("Target.attachToTarget", targetId=page, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.send_command(f"{domain}.enable")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._process.kill()
        self._process.wait()
        os.close(self._command_pipe)
        os.close(self._answer_pipe)

    def send_command(self, method, **params):
        """The result of one command; what happens meanwhile is noted."""
        number = next(self._ids)
        message = {"id": number, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._command_pipe, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._read_message()
            if answer.get("id") == number:
                assert "error" not in answer, f"{method}: {answer['error']}"
                return answer["result"]
            self._record_event(answer)

    def wait_for_event(self, method):
        """Go on once an event has happened since the last page was opened."""
        while method not in self._events:
            self._record_event(self._read_message())

    def open_page(self, path, width=1200, height=900, dark=False, mobile=False):
        """Load a file and wait until everything of it is there."""
        self._events.clear()
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.send_command("Emulation.setEmulatedMedia", features=[scheme])
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": mobile}
        self.send_command("Emulation.setDeviceMetricsOverride", **size)
        self.send_command("Page.navigate", url=f"file://{path}")
        self.wait_for_event("Page.loadEventFired")

    def evaluate_js(self, expression):
        """The value of a JavaScript expression, a promise's once it is kept."""
        wanted = {"expression": expression, "returnByValue": True, "awaitPromise": True}
        found = self.send_command("Runtime.evaluate", **wanted)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def take_screenshot(self, clip=None):
        """PNG bytes of what is seen, or of a part (x, y, width, height) of the whole page."""
        wanted = {"format": "png"}
        if clip:
            names = ("x", "y", "width", "height")
            wanted |= {"captureBeyondViewport": True}
            wanted["clip"] = dict(zip(names, clip, strict=True)) | {"scale": 1}
        return base64.b64decode(self.send_command("Page.captureScreenshot", **wanted)["data"])

    def _read_message(self):
        while b"\0" not in self._buffer:
            part = os.read(self._answer_pipe, 1 << 20)
            assert part, "Chromium ended"
            self._buffer += part
        line, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(line)

    def _record_event(self, event):
        name, params = event.get("method"), event.get("params", {})
        self._events.append(name)
        if name == "Network.requestWillBeSent":
            self.requested_urls.append(params["request"]["url"])
        elif name == "Runtime.exceptionThrown":
            self.page_errors.append(json.dumps(params["exceptionDetails"])[:600])
        elif name == "Runtime.consoleAPICalled" and params["type"] == "error":
            self.page_errors.append(json.dumps(params["args"])[:600])
        elif name == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.page_errors.append(params["entry"]["text"])
