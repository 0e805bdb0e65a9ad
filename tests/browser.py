"""A headless Chromium with the network off, spoken to over two pipes."""

import base64
import itertools
import json
import os
import shutil
import subprocess

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
ABSENT = "no Chromium to open the report in: install Debian's package chromium"
FLAGS = (
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
        (command, self._to), (self._from, answer) = os.pipe(), os.pipe()
        off = "--host-resolver-rules=MAP * ~NOTFOUND", "--proxy-server=127.0.0.1:9"
        arguments = [CHROMIUM, *FLAGS, *off, f"--user-data-dir={profile}", *flags, "about:blank"]

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
        self.requests, self.complaints, self._events = [], [], []
        targets = self.call("Target.getTargets")["targetInfos"]
        page = next(t["targetId"] for t in targets if t["type"] == "page")
        attached = self.call("Target.attachToTarget", targetId=page, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._process.kill()
        self._process.wait()
        os.close(self._to)
        os.close(self._from)

    def call(self, method, **params):
        """The result of one command; what happens meanwhile is noted."""
        number = next(self._ids)
        message = {"id": number, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._read()
            if answer.get("id") == number:
                assert "error" not in answer, f"{method}: {answer['error']}"
                return answer["result"]
            self._note(answer)

    def wait(self, method):
        """Go on once an event has happened since the last page was opened."""
        while method not in self._events:
            self._note(self._read())

    def open(self, path, width=1200, height=900, dark=False, mobile=False):
        """Load a file and wait until everything of it is there."""
        self._events.clear()
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": mobile}
        self.call("Emulation.setDeviceMetricsOverride", **size)
        self.call("Page.navigate", url=f"file://{path}")
        self.wait("Page.loadEventFired")

    def ask(self, expression):
        """The value of a JavaScript expression, a promise's once it is kept."""
        wanted = {"expression": expression, "returnByValue": True, "awaitPromise": True}
        found = self.call("Runtime.evaluate", **wanted)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def picture(self, clip=None):
        """PNG bytes of what is seen, or of a part (x, y, width, height) of the whole page."""
        wanted = {"format": "png"}
        if clip:
            names = ("x", "y", "width", "height")
            wanted |= {"captureBeyondViewport": True}
            wanted["clip"] = dict(zip(names, clip, strict=True)) | {"scale": 1}
        return base64.b64decode(self.call("Page.captureScreenshot", **wanted)["data"])

    def _read(self):
        while b"\0" not in self._buffer:
            part = os.read(self._from, 1 << 20)
            assert part, "Chromium ended"
            self._buffer += part
        line, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(line)

    def _note(self, event):
        name, params = event.get("method"), event.get("params", {})
        self._events.append(name)
        if name == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])
        elif name == "Runtime.exceptionThrown":
            self.complaints.append(json.dumps(params["exceptionDetails"])[:600])
        elif name == "Runtime.consoleAPICalled" and params["type"] == "error":
            self.complaints.append(json.dumps(params["args"])[:600])
        elif name == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.complaints.append(params["entry"]["text"])
