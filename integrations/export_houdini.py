"""Exports VDBs from Houdini as a sequence for bevy_vdb: one .vdb file per frame, and a .vdbseq file.

    hython export_houdini.py SCENE.hip /obj/pyro/OUT --out cache/fire_####.vdb --frames 1-240

In Houdini's Python shell or a shelf tool, with the folder of this file in `sys.path`:

    import export_houdini
    export_houdini.export(hou.selectedNodes()[0], "$HIP/cache/fire_####.vdb", range(1, 241))

Ordinary volumes become VDBs. Everything that is neither is left out. Transforms of the object around the SOP are
not applied: grids are where the SOP has them.

Not run by any test of this repository, because it needs Houdini: written from the documentation of `hou`
(https://www.sidefx.com/docs/houdini/hom/hou/).
"""

import argparse
import os
import sys

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))

from vdb_sequence import ExportError, Sequence, parse_frames  # noqa: E402

# The entry VDB of the menu Convert To of the node Convert VDB.
TO_VDB = 1


def vdbs(node, frame, wanted):
    """The VDBs of a SOP at a frame, as geometry of its own."""
    import hou

    cooked = node.geometryAtFrame(frame)
    if cooked is None:
        raise ExportError(f"{node.path()}, frame {frame}: {' '.join(node.errors()) or 'no geometry'}")
    # The geometry of a node is read-only.
    geometry = hou.Geometry()
    geometry.merge(cooked)
    if any(isinstance(prim, hou.Volume) for prim in geometry.prims()):
        verb = hou.sopNodeTypeCategory().nodeVerb("convertvdb")
        verb.setParms({"conversion": TO_VDB})
        converted = hou.Geometry()
        verb.execute(converted, [geometry])
        geometry = converted

    def is_wanted(prim):
        if not isinstance(prim, hou.VDB):
            return False
        has_name = geometry.findPrimAttrib("name") is not None
        return not wanted or (has_name and prim.attribValue("name") in wanted)

    geometry.deletePrims([prim for prim in geometry.prims() if not is_wanted(prim)])
    return geometry


def export(node, out, frames=None, grids=(), report=print):
    """Writes a frame per number and the `.vdbseq` file, whose path it returns.

    `frames` are those of the playbar by default; `grids`, names, are all by default.
    """
    import hou

    if frames is None:
        first, last = hou.playbar.frameRange()
        frames = range(int(first), int(last) + 1)
    # `$F4` is the number of a frame, which only Sequence knows.
    sequence = Sequence(os.path.join(hou.text.expandString(os.path.dirname(out)), os.path.basename(out)))
    sequence.prepare(frames)
    found = False
    for frame in frames:
        geometry = vdbs(node, frame, set(grids))
        # A fire that has not begun is a frame without grids, which Houdini writes as a file without grids.
        found = found or len(geometry.prims()) > 0
        path = sequence.frame(frame)
        geometry.saveToFile(path)
        report(f"{path}: {len(geometry.prims())} grids")
    if not found:
        raise ExportError(f"{node.path()}: neither VDBs nor volumes{' of these names' if grids else ''}")
    return sequence.write_index(frames, hou.fps())


def main(words):
    parser = argparse.ArgumentParser(
        prog="export_houdini.py",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("scene", help="the .hip file")
    parser.add_argument("node", help="the path of a SOP, such as /obj/pyro/OUT")
    parser.add_argument("--out", required=True, help="such as cache/fire_####.vdb")
    parser.add_argument("--frames", help="12, 1-240 or 1-240/2 [those of the playbar]")
    parser.add_argument("--grids", default="", help="names of VDBs, between commas [all]")
    options = parser.parse_args(words)
    import hou

    hou.hipFile.load(options.scene, suppress_save_prompt=True, ignore_load_warnings=True)
    node = hou.node(options.node)
    if node is None or not isinstance(node, hou.SopNode):
        raise ExportError(f"{options.node}: no such SOP")
    frames = parse_frames(options.frames) if options.frames else None
    print(export(node, options.out, frames, [name for name in options.grids.split(",") if name]))


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except ExportError as error:
        sys.exit(f"export_houdini: {error}")
