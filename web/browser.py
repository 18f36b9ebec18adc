"""Chromium without a window, a page in it over its debugging pipe, and a server for a folder."""

import functools
import http.server
import json
import os
import pathlib
import signal
import subprocess
import tempfile
import threading
import time

# The software adapter is offered only to those who ask for WebGPU where it is not supported, and considered hung after
# seconds.
CHROMIUM = [
    "chromium",
    "--headless=new",
    "--enable-unsafe-webgpu",
    "--enable-webgpu-developer-features",
    "--use-webgpu-adapter=swiftshader",
    "--disable-gpu-watchdog",
    "--no-first-run",
]
# Otherwise a canvas of WebGPU has no memory that its compositor can read, and the device is lost.
WITH_CANVAS = [
    "--use-angle=swiftshader",
    "--use-vulkan=swiftshader",
    "--enable-features=Vulkan",
    "--disable-vulkan-surface",
]


def chromium(profile, *options):
    """The command that starts Chromium with the software adapter that it brings along."""
    # Its sandbox does not run as root.
    sandbox = ["--no-sandbox"] if os.getuid() == 0 else []
    return [*CHROMIUM, *sandbox, f"--user-data-dir={profile}", *options]


class BrowserError(Exception):
    pass


class Browser:
    """One page in a browser. Errors that the page or its workers report are in `errors`."""

    def __init__(self):
        self.folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        to_browser, self.write_end = os.pipe()
        self.read_end, from_browser = os.pipe()
        command = chromium(self.folder.name, "--remote-debugging-pipe", *WITH_CANVAS)

        def at_three_and_four():
            # First out of each other's way.
            ends = [os.dup(to_browser), os.dup(from_browser)]
            os.dup2(ends[0], 3)
            os.dup2(ends[1], 4)

        self.process = subprocess.Popen(
            command,
            preexec_fn=at_three_and_four,
            close_fds=False,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        os.close(to_browser)
        os.close(from_browser)
        self.number = 0
        self.answers = {}
        self.errors = []
        self.has_changed = threading.Condition()
        threading.Thread(target=self.read, daemon=True).start()
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.send("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        self.watch(self.session)
        self.call("Page.enable")

    def close(self):
        self.process.poll() is None and os.killpg(self.process.pid, signal.SIGTERM)
        self.process.wait()
        os.close(self.write_end)
        self.folder.cleanup()

    def watch(self, session):
        """Has a page or a worker report errors, and its workers, too."""
        for method in ("Runtime.enable", "Log.enable"):
            self.post(method, session)
        following = {"autoAttach": True, "waitForDebuggerOnStart": True, "flatten": True}
        self.post("Target.setAutoAttach", session, **following)
        self.post("Runtime.runIfWaitingForDebugger", session)

    def read(self):
        rest = b""
        while data := os.read(self.read_end, 1 << 16):
            *messages, rest = (rest + data).split(b"\0")
            for message in messages:
                self.take(json.loads(message))
        with self.has_changed:
            self.answers = None
            self.has_changed.notify_all()

    def take(self, message):
        params = message.get("params", {})
        method = message.get("method")
        if method == "Target.attachedToTarget" and params["targetInfo"]["type"] == "worker":
            self.watch(params["sessionId"])
        elif method == "Runtime.exceptionThrown":
            details = params["exceptionDetails"]
            self.errors.append(details.get("exception", {}).get("description", details["text"]))
        elif method == "Runtime.consoleAPICalled" and params["type"] in ("error", "warning", "assert"):
            self.errors.append(" ".join(str(arg.get("value", arg.get("description"))) for arg in params["args"]))
        elif method == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.errors.append(f"{params['entry']['text']} {params['entry'].get('url', '')}")
        if "id" in message:
            with self.has_changed:
                self.answers[message["id"]] = message
                self.has_changed.notify_all()

    def post(self, method, session=None, **params):
        self.number += 1
        message = {"id": self.number, "method": method, "params": params}
        if session:
            message["sessionId"] = session
        os.write(self.write_end, json.dumps(message).encode() + b"\0")
        return message["id"]

    def send(self, method, session=None, timeout=600, **params):
        number = self.post(method, session, **params)
        with self.has_changed:
            arrived = self.has_changed.wait_for(
                lambda: self.answers is None or number in self.answers, timeout
            )
            if not arrived or self.answers is None:
                raise BrowserError(f"no answer to {method}" if not arrived else "the browser has ended")
            answer = self.answers.pop(number)
        if "error" in answer:
            raise BrowserError(f"{method}: {answer['error']['message']}")
        return answer["result"]

    def call(self, method, **params):
        return self.send(method, self.session, **params)

    def open(self, address, width, height):
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False
        )
        self.call("Page.navigate", url=address)
        deadline = time.monotonic() + 60
        while not self.evaluate("Boolean(globalThis.demo)"):
            if time.monotonic() > deadline:
                raise BrowserError("; ".join(["the page does not start", *self.errors]))
            time.sleep(0.05)

    def evaluate(self, expression):
        answer = self.call("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in answer:
            details = answer["exceptionDetails"]
            raise BrowserError(details.get("exception", {}).get("description", details["text"]))
        return answer["result"].get("value")


class Handler(http.server.SimpleHTTPRequestHandler):
    extensions_map = {
        **http.server.SimpleHTTPRequestHandler.extensions_map,
        ".js": "text/javascript",
        ".wasm": "application/wasm",
        ".wgsl": "text/plain",
    }

    def log_message(self, *_):
        pass


def serve(folder: pathlib.Path, port=0):
    """Serves a folder to this machine, from a thread of its own; returns the address."""
    handler = functools.partial(Handler, directory=folder)
    server = http.server.ThreadingHTTPServer(("127.0.0.1", port), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return f"http://localhost:{server.server_address[1]}/"
