"""Serves the page of scripts/browser to a browser, and prints what the page reports.

Fails if an answer is wrong, if a variant is not compiled that should be, if the page reports an error, or if the
browser ends or falls silent before the page has finished.
"""

import argparse
import collections
import contextlib
import http.server
import json
import pathlib
import queue
import subprocess
import sys
import tempfile
import threading

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1] / "web"))
from browser import chromium  # noqa: E402

PAGE = {"/": "index.html", "/page.js": "page.js"}
TYPES = {".html": "text/html", ".js": "text/javascript"}


def arguments():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=pathlib.Path, required=True, help="folder of cases.json and its files")
    parser.add_argument("--variants", type=pathlib.Path, help="folder of WGSL files to compile")
    parser.add_argument("--allow", action="append", default=[], help="def of variants that may be refused")
    parser.add_argument("--port", type=int, default=0)
    parser.add_argument("--silence", type=float, default=600.0, help="seconds between reports, at most")
    parser.add_argument("--serve", action="store_true", help="print the address instead of opening it in Chromium")
    return parser.parse_args()


def handler(options, reports):
    class Handler(http.server.BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def handle(self):
            # A browser that is told to end closes its connections.
            with contextlib.suppress(ConnectionError):
                super().handle()

        def log_message(self, *_):
            """Reports are printed instead."""

        def answer(self, body, status=200, content_type="application/octet-stream"):
            self.send_response(status)
            self.send_header("Content-Type", content_type)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(body)

        def file(self, path):
            """The bytes that are asked for of a file."""
            wanted = self.headers.get("Range")
            if wanted is None:
                self.answer(path.read_bytes(), content_type=TYPES.get(path.suffix, "application/octet-stream"))
                return
            first, last = map(int, wanted.removeprefix("bytes=").split("-"))
            with path.open("rb") as opened:
                opened.seek(first)
                self.answer(opened.read(last - first + 1), 206)

        def do_GET(self):
            folder, _, name = self.path.lstrip("/").partition("/")
            root = {"data": options.data, "variants": options.variants}.get(folder)
            if self.path in PAGE:
                self.file(HERE / PAGE[self.path])
            elif self.path == "/variants":
                found = sorted(path.name for path in root.glob("*.wgsl")) if root else []
                self.answer(json.dumps(found).encode(), content_type="application/json")
            elif root and name == pathlib.PurePath(name).name and (root / name).is_file():
                self.file(root / name)
            else:
                self.answer(b"", 404)

        def do_POST(self):
            reports.put(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.answer(b"")

    return Handler


class Printer:
    """Prints reports as tables, and keeps what decides about success."""

    def __init__(self, allowed, wants_variants):
        self.allowed = allowed
        self.wants_variants = wants_variants
        self.problems = []
        self.sums = collections.Counter()
        self.largest = 0.0
        self.variants = 0
        self.expected = collections.Counter()
        self.has_ended = False

    def adapter(self, report):
        print(f"{report['browser']}\nbrowser's adapter: {report['adapter']}")

    def list(self, report):
        print(f"native adapter: {report['adapter']}\n")
        print("| grid | rays | hits | wrong | largest error of t | rays/s, browser | rays/s, native |")
        print("|---|---|---|---|---|---|---|")

    def row(self, name, report, largest):
        rates = [report["rays"] / max(report[key], 1e-9) for key in ("seconds", "secondsHere")]
        counts = " | ".join(f"{report[key]:,}" for key in ("rays", "hits", "wrong"))
        print(f"| {name} | {counts} | {largest:.1e} | {rates[0]:,.0f} | {rates[1]:,.0f} |", flush=True)

    def case(self, report):
        self.row(report["name"], report, report["largest"])
        for key in ("rays", "hits", "wrong", "seconds", "secondsHere"):
            self.sums[key] += report[key]
        self.largest = max(self.largest, report["largest"])
        if report["wrong"]:
            self.problems.append(f"{report['name']}: {report['wrong']} wrong answers")
            self.problems += report["examples"]

    def variants_of(self, report):
        self.variants = report["done"]
        for failure in report["failures"]:
            if any(name in failure["defs"].split() for name in self.allowed):
                self.expected[failure["message"]] += 1
            else:
                self.problems.append("variant {name} ({defs}): {message}".format(**failure))

    def error(self, report):
        self.problems.append(report["message"])
        self.has_ended = True

    def end(self, _):
        self.has_ended = True

    def take(self, report):
        methods = (self.adapter, self.list, self.case, self.variants_of, self.error, self.end)
        {method.__name__: method for method in methods}[report["kind"]](report)

    def finish(self):
        if self.sums["rays"]:
            self.row("all", self.sums, self.largest)
        else:
            self.problems.append("no ray was traced")
        if self.wants_variants and not self.variants:
            self.problems.append("no variant was compiled")
        if self.variants:
            refused = f"{sum(self.expected.values())} refused that have one of {', '.join(self.allowed)}"
            print(f"\n{self.variants} variants given to the browser's compiler, {refused}")
        for reason, count in self.expected.items():
            print(f"    {count}: {reason}")
        for problem in self.problems:
            print(problem, file=sys.stderr)
        return 1 if self.problems else 0


def main():
    options = arguments()
    reports = queue.Queue()
    server = http.server.ThreadingHTTPServer(("127.0.0.1", options.port), handler(options, reports))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    address = f"http://localhost:{server.server_address[1]}/"
    printer = Printer(options.allow, options.variants is not None)
    profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
    browser = None
    if options.serve:
        print(f"open {address} in a browser", flush=True)
    else:
        command = [*chromium(profile.name), address]
        browser = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    silent = 0.0
    try:
        while not printer.has_ended:
            try:
                printer.take(reports.get(timeout=1.0))
                silent = 0.0
            except queue.Empty:
                silent += 1.0
                if browser and browser.poll() is not None:
                    printer.problems.append(f"the browser ended early, with {browser.returncode}")
                    break
                if silent > options.silence:
                    printer.problems.append(f"no report from the page in {options.silence:.0f} s")
                    break
    finally:
        if browser:
            browser.terminate()
            browser.wait()
        profile.cleanup()
    return printer.finish()


if __name__ == "__main__":
    sys.exit(main())
