"""Checks, draws and measures the demo in a browser, for scripts/demo."""

import argparse
import base64
import contextlib
import gzip
import json
import pathlib
import statistics
import subprocess
import sys
import threading
import time

from browser import Browser, BrowserError, serve

# The bundled models, and how they are shown.
CASES = [("teapot", "voxels"), ("teapot", "smooth"), ("cloud", "fog")]
SIZE = (640, 480)
SIZES = [(640, 480), (1280, 720)]
# Frames of a measurement.
RUNS = 7


def arguments():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("command", choices=["serve", "check", "pictures", "measure"])
    parser.add_argument("folder", type=pathlib.Path, help="the folder of the page")
    parser.add_argument("--out", type=pathlib.Path, help="the folder for pictures")
    parser.add_argument("--judge", nargs="+", help="the command that judges cases")
    return parser.parse_args()


@contextlib.contextmanager
def browser():
    opened = Browser()
    try:
        yield opened
    finally:
        opened.close()


def save(out, name, picture):
    out.mkdir(parents=True, exist_ok=True)
    path = out / f"{name}.png"
    path.write_bytes(base64.b64decode(picture))
    return path


def shoot(page, address, out, case, options, size):
    """Opens a model and takes a picture of it when it is finished."""
    model, kind = case
    page.open(f"{address}?model={model}&kind={kind}{options}", *size)
    page.evaluate("demo.settled()")
    return save(out, f"{model}-{kind}{'-data' if 'data' in options else ''}", page.evaluate("demo.picture()"))


def check(address, out, judge):
    """Pictures of what was found, judged by the reference tracer; and no error on the console."""
    out.mkdir(parents=True, exist_ok=True)
    written = []
    with browser() as page:
        for model, kind in CASES:
            picture = shoot(page, address, out, (model, kind), "&data", SIZE)
            state = page.evaluate("demo.state()")
            path = out / f"{model}-{kind}.json"
            case = {**state, "model": f"assets/models/{model}.vdb", "picture": str(picture)}
            path.write_text(json.dumps(case))
            written.append(path)
        errors = page.errors
    for error in errors:
        print(f"the console has: {error}", file=sys.stderr)
    judged = subprocess.run([*judge, *written], check=False)
    return 1 if errors or judged.returncode else 0


def pictures(address, out):
    with browser() as page:
        for case in CASES:
            print(shoot(page, address, out, case, "", (1280, 720)))
    return 0


def transferred(folder):
    """Bytes of the page's parts, as they are and compressed as hosts do."""
    parts = {"page": ["*.html", "*.css", "*.js", "models/*.json"], "module": ["*.wasm"], "shaders": ["shaders/*.wgsl"]}
    parts |= {path.stem: [f"models/{path.name}"] for path in sorted(folder.glob("models/*.vdbc"))}
    print("| part | files | bytes | gzip |\n|---|---|---|---|")
    for name, patterns in parts.items():
        files = [path.read_bytes() for pattern in patterns for path in folder.glob(pattern)]
        compressed = sum(len(gzip.compress(data, 9)) for data in files)
        print(f"| {name} | {len(files)} | {sum(map(len, files)):,} | {compressed:,} |")


def frame_times(page, wanted):
    """Milliseconds of frames: first ones, each after a change of the light, or later ones with the sky's shadows."""
    change = "document.getElementById('azimuth').dispatchEvent(new Event('input'))"
    times = []
    while len(times) < RUNS:
        count = page.evaluate("demo.frames().length")
        if wanted == "first":
            page.evaluate(change)
        while page.evaluate("demo.frames().length") == count:
            time.sleep(0.02)
        frame = page.evaluate("demo.frames().at(-1)")
        if (frame["frame"] == 0) == (wanted == "first"):
            times.append(frame["time"])
    return statistics.median(times)


def measure(address, folder):
    transferred(folder)
    print("\n| volume | size | first picture after | first frame | further frames |\n|---|---|---|---|---|")
    with browser() as page:
        for case in CASES:
            for width, height in SIZES:
                page.open(f"{address}?model={case[0]}&kind={case[1]}&bare", width, height)
                while not page.evaluate("demo.frames().length"):
                    time.sleep(0.02)
                start = page.evaluate("demo.frames()[0].at")
                first, further = (frame_times(page, wanted) for wanted in ("first", "further"))
                print(
                    f"| {' '.join(case)} | {width}×{height} | {start:,.0f} ms | {first:,.0f} ms | {further:,.0f} ms |",
                    flush=True,
                )
        print(f"\n{page.call('Browser.getVersion')['product']}, {page.evaluate('''adapter.textContent''')}")
    return 0


def show(folder):
    """Serves the page until Ctrl-C, at the same address each time if another program does not have it."""
    try:
        address = serve(folder, 8000)
    except OSError:
        address = serve(folder)
    print(f"open {address} (Ctrl-C ends)", flush=True)
    with contextlib.suppress(KeyboardInterrupt):
        threading.Event().wait()
    return 0


def main():
    options = arguments()
    if options.command == "serve":
        return show(options.folder)
    address = serve(options.folder)
    try:
        if options.command == "check":
            return check(address, options.out, options.judge)
        if options.command == "pictures":
            return pictures(address, options.out)
        return measure(address, options.folder)
    except BrowserError as error:
        print(f"demo: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
