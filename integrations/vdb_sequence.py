"""Names of frames, and the `.vdbseq` file that lists them, for export_blender.py and export_houdini.py.

docs/guide/sequences.md describes the format. Needs nothing but Python 3.9.
"""

import os
import re

# What docs/guide/sequences.md allows.
MOST_FRAMES = 100_000
MOST_DIGITS = 15


class ExportError(Exception):
    """Says what is wrong, with what, and what helps."""


def parse_frames(text):
    """The frames of `1-240`, of `1-240/2` (every second one) or of `12`."""
    match = re.fullmatch(r"(\d+)(?:-(\d+)(?:/(\d+))?)?", text.strip())
    if not match:
        raise ExportError(f"--frames {text}: write 12, 1-240 or 1-240/2; there are no negative frames")
    first, last, step = (part and int(part) for part in match.groups())
    last, step = first if last is None else last, 1 if step is None else step
    if last < first or step == 0:
        raise ExportError(f"--frames {text}: no frames")
    return range(first, last + 1, step)


class Sequence:
    """The files of a sequence: `smoke_####.vdb` and `smoke.vdbseq` beside them."""

    def __init__(self, out):
        """`out` is a path such as `cache/smoke_####.vdb`; `cache/smoke` means the same."""
        folder, name = os.path.split(out)
        stem = re.sub(r"\.(vdb|vdbseq)$", "", name)
        # Houdini's notation and C's are those that sequences know, too.
        stem = re.sub(r"\$F(\d*)|%0?(\d*)d", lambda at: "#" * int(at[1] or at[2] or 1), stem)
        if "#" not in stem:
            stem += "_####"
        places = re.findall("#+", stem)
        if len(places) > 1 or len(places[0]) > MOST_DIGITS:
            raise ExportError(f"{name}: one placeholder for the number of the frame is needed, such as ####")
        self.before, self.after = stem.split(places[0])
        self.digits = len(places[0])
        self.folder = folder or "."
        base = (self.before.rstrip("_.- ") + self.after) or "sequence"
        self.index = os.path.join(self.folder, base + ".vdbseq")

    def pattern(self):
        return f"{self.before}{'#' * self.digits}{self.after}.vdb"

    def frame(self, number):
        """The path of a frame."""
        return os.path.join(self.folder, f"{self.before}{number:0{self.digits}}{self.after}.vdb")

    def prepare(self, frames):
        """Refuses what sequences refuse, before hours are spent on it, and makes the folder."""
        if len(frames) > MOST_FRAMES:
            raise ExportError(f"{len(frames)} frames: a sequence has at most {MOST_FRAMES}")
        if frames[0] < 0:
            raise ExportError(f"frame {frames[0]}: the number of a frame cannot be negative")
        os.makedirs(self.folder, exist_ok=True)

    def write_index(self, frames, rate):
        """Writes the `.vdbseq` file, and returns its path."""
        quoted = self.pattern().replace("\\", "\\\\").replace('"', '\\"')
        lines = [f'frames: "{quoted}",']
        # With gaps, the folder is listed instead.
        if frames[-1] - frames[0] + 1 == len(frames):
            lines += [f"first: {frames[0]},", f"last: {frames[-1]},"]
        lines += [f"rate: {float(rate):.6g},", "repeat: Loop,"]
        with open(self.index, "w", encoding="utf-8") as file:
            file.write("(\n" + "".join(f"    {line}\n" for line in lines) + ")\n")
        return self.index
