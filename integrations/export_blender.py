"""Exports volumes, smoke and meshes from Blender as a sequence for bevy_vdb: one .vdb file per frame, and a .vdbseq
file.

    blender SCENE.blend --background --python export_blender.py -- OBJECT… --out cache/smoke_####.vdb

In Blender's Python console, with the folder of this file in `sys.path`:

    import export_blender
    export_blender.export([C.object], "/tmp/cache/smoke_####.vdb", range(1, 251))

What an object gives:

    a volume, or anything with modifiers or geometry nodes that make one    its grids
    a gas domain that has been baked with OpenVDB caches                    the grids of its cache
    a mesh, a curve, a text or metaballs                                    a level set named like the object

Grids are written in the coordinates of the scene, with the transforms of their objects, turned so that y points up
as in Bevy; --z-up leaves them as they are in Blender. Tested with Blender 4.5.
"""

import argparse
import os
import sys
import tempfile

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))

import bpy  # noqa: E402
import numpy as np  # noqa: E402
from vdb_sequence import ExportError, Sequence, parse_frames  # noqa: E402

# Blender's x, y, z are Bevy's x, -z, y: docs/guide/assets.md.
Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
# Blender takes the value of a voxel to be in the middle of the cube from its index to the next one, OpenVDB at the
# index itself.
HALF_VOXEL = np.array([[1.0, 0, 0, 0.5], [0, 1, 0, 0.5], [0, 0, 1, 0.5], [0, 0, 0, 1]])
MESHES = {"MESH", "CURVE", "SURFACE", "META", "FONT"}


def openvdb_module():
    """OpenVDB's Python module, which Blender brings along. As a module, bpy does not put it in the path."""
    try:
        import openvdb
    except ImportError:
        version = f"python{sys.version_info.major}.{sys.version_info.minor}"
        sys.path.append(
            os.path.join(bpy.utils.resource_path("LOCAL"), "python", "lib", version, "site-packages")
        )
        import openvdb
    return openvdb


def matrix_of(transform):
    """The matrix of a grid's transform from indices, for column vectors."""

    def place(*index):
        return np.array(transform.indexToWorld(index))

    origin = place(0.0, 0.0, 0.0)
    matrix = np.eye(4)
    matrix[:3, :3] = np.column_stack([place(*axis) - origin for axis in np.eye(3).tolist()])
    matrix[:3, 3] = origin
    return matrix


class Exporter:
    """What one call of `export` knows."""

    def __init__(self, grids, voxel_size, band, half, z_up):
        self.vdb = openvdb_module()
        self.wanted, self.half = grids, half
        self.voxel_size, self.band = voxel_size, band
        self.to_file = np.eye(4) if z_up else Y_UP

    def frame(self, objects):
        """The grids of all objects at the current frame, by name."""
        depsgraph = bpy.context.evaluated_depsgraph_get()
        found = {}
        for own in objects:
            for grid in self.grids(own, depsgraph):
                if self.wanted and grid.name not in self.wanted:
                    continue
                if grid.name in found:
                    raise ExportError(
                        f"{own.name}: {found[grid.name]} has a grid `{grid.name}`, too; export them one by one"
                    )
                grid.saveFloatAsHalf = self.half
                found[grid.name] = grid
        return found

    def grids(self, own, depsgraph):
        cache = domain_of(own)
        if cache is not None:
            return self.of_cache(own, cache, depsgraph)
        volumes = self.of_volumes(own, depsgraph)
        if volumes is not None:
            return volumes
        if own.type in MESHES:
            return [self.of_mesh(own, depsgraph)]
        raise ExportError(f"{own.name}: {own.type.lower()}s give neither a volume nor a mesh")

    def of_volumes(self, own, depsgraph):
        """The grids of evaluated volumes; `None` if the object has none."""
        found = None
        # What modifiers and geometry nodes make of an object of another type is an instance of it.
        for instance in depsgraph.object_instances:
            parent = instance.parent if instance.is_instance else instance.object
            if parent is None or parent.original != own or instance.object.type != "VOLUME":
                continue
            found = found or []
            to_scene = np.array(instance.matrix_world)
            for grid in self.saved(instance.object.data):
                self.place(grid, to_scene @ matrix_of(grid.transform) @ HALF_VOXEL)
                found.append(grid)
        return found

    def saved(self, volume):
        """The grids of a volume, through a file: `bpy` has no access to their values."""
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "volume.vdb")
            if not volume.grids.save(filepath=path):
                raise ExportError(f"{volume.name}: Blender cannot save it: {volume.grids.error_message}")
            return self.vdb.readAll(path)[0]

    def of_mesh(self, own, depsgraph):
        """A level set around a closed mesh."""
        evaluated = own.evaluated_get(depsgraph)
        mesh = evaluated.to_mesh()
        try:
            mesh.calc_loop_triangles()
            points = np.empty((len(mesh.vertices), 3), dtype=np.float32)
            mesh.vertices.foreach_get("co", points.ravel())
            triangles = np.empty((len(mesh.loop_triangles), 3), dtype=np.int32)
            mesh.loop_triangles.foreach_get("vertices", triangles.ravel())
        finally:
            evaluated.to_mesh_clear()
        to_file = self.to_file @ np.array(evaluated.matrix_world)
        points = (points @ to_file[:3, :3].T + to_file[:3, 3]).astype(np.float32)
        grid = self.vdb.FloatGrid.createLevelSetFromPolygons(
            points,
            triangles=triangles.astype(np.uint32),
            transform=self.vdb.createLinearTransform(voxelSize=self.voxel_size),
            halfWidth=self.band,
        )
        grid.name = own.name
        return grid

    def place(self, grid, to_scene):
        """Gives a grid its transform in the file, from one in the scene."""
        # OpenVDB's matrices are for row vectors.
        grid.transform = self.vdb.createLinearTransform((self.to_file @ to_scene).T.tolist())

    def of_cache(self, own, settings, depsgraph):
        """The grids of a gas domain, from the file that Blender has baked for the current frame."""
        frame = bpy.context.scene.frame_current
        path = os.path.join(
            bpy.path.abspath(settings.cache_directory), "data", f"fluid_data_{frame:04}.vdb"
        )
        if settings.use_adaptive_domain:
            raise ExportError(f"{own.name}: adaptive domains do not say where they are; bake it without")
        if not os.path.exists(path):
            raise ExportError(f"{own.name}, frame {frame}: no {path}; bake it with the format OpenVDB")
        evaluated = own.evaluated_get(depsgraph)
        corners = np.array(evaluated.bound_box)
        low, size = corners.min(axis=0), np.ptp(corners, axis=0)
        grids = []
        for grid in self.vdb.readAll(path)[0]:
            # The file has the voxels of the domain in a unit of its own, from a corner at the origin.
            try:
                domain = np.array(grid["file_base_resolution"]) * grid["file_voxel_size"]
            except KeyError:
                raise ExportError(f"{path}: `{grid.name}` does not say what the resolution was") from None
            to_object = np.diag([*(size / domain), 1.0])
            to_object[:3, 3] = low
            to_scene = np.array(evaluated.matrix_world) @ to_object
            # Cells have their values in their middles.
            self.place(grid, to_scene @ matrix_of(grid.transform) @ HALF_VOXEL)
            grids.append(grid)
        return grids


def domain_of(own):
    """The settings of an object that is a gas domain."""
    for modifier in own.modifiers:
        if modifier.type == "FLUID" and modifier.fluid_type == "DOMAIN":
            settings = modifier.domain_settings
            if settings.domain_type == "GAS":
                return settings
    return None


def export(
    objects, out, frames=None, *, grids=(), voxel_size=0.05, band=3.0, half=False, z_up=False, report=print
):
    """Writes a frame per number and the `.vdbseq` file, whose path it returns.

    `frames` are those of the scene by default. `grids`, names, are all by default. `voxel_size`, in the units of the
    scene, and `band`, in voxels on either side of the surface, are for meshes. `half` saves 16-bit floats.
    """
    scene = bpy.context.scene
    if frames is None:
        frames = range(scene.frame_start, scene.frame_end + 1)
    if not objects:
        raise ExportError("no objects to export")
    sequence = Sequence(out)
    sequence.prepare(frames)
    exporter = Exporter(set(grids), voxel_size, band, half, z_up)
    before, found = scene.frame_current, False
    try:
        for frame in frames:
            scene.frame_set(frame)
            own = list(exporter.frame(objects).values())
            found = found or bool(own)
            path = sequence.frame(frame)
            exporter.vdb.write(path, grids=own)
            report(f"{path}: {', '.join(grid.name for grid in own) or 'nothing'}")
    finally:
        scene.frame_set(before)
    if not found:
        names = ", ".join(own.name for own in objects)
        raise ExportError(f"{names}: no grids{' of these names' if grids else ''} in any frame")
    return sequence.write_index(frames, scene.render.fps / scene.render.fps_base)


def main(words):
    parser = argparse.ArgumentParser(
        prog="export_blender.py",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("objects", nargs="+", metavar="OBJECT", help="the names of objects")
    parser.add_argument("--out", required=True, help="such as cache/smoke_####.vdb")
    parser.add_argument("--frames", help="12, 1-240 or 1-240/2 [those of the scene]")
    parser.add_argument("--grids", default="", help="names of grids, between commas [all]")
    parser.add_argument("--voxel-size", type=float, default=0.05, help="for meshes [0.05]")
    parser.add_argument("--band", type=float, default=3.0, help="for meshes: voxels on either side [3]")
    parser.add_argument("--half", action="store_true", help="16-bit floats: half the size")
    parser.add_argument("--z-up", action="store_true", help="the axes of Blender, not of Bevy")
    options = parser.parse_args(words)
    missing = [name for name in options.objects if name not in bpy.context.scene.objects]
    if missing:
        raise ExportError(f"{', '.join(missing)}: no such object in the scene")
    index = export(
        [bpy.context.scene.objects[name] for name in options.objects],
        options.out,
        parse_frames(options.frames) if options.frames else None,
        grids=[name for name in options.grids.split(",") if name],
        voxel_size=options.voxel_size,
        band=options.band,
        half=options.half,
        z_up=options.z_up,
    )
    print(index)


if __name__ == "__main__":
    try:
        # Blender's own arguments come first.
        main(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:])
    except ExportError as error:
        sys.exit(f"export_blender: {error}")
