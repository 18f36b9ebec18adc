"""Tests of export_blender.py and vdb_sequence.py: test_exporters.py VDB, run by scripts/test-exporters.

Each makes an animation in Blender whose values and places are known in closed form, exports it, and looks at the
files as `vdb info --json` and OpenVDB's Python module read them. VDB is the path of `vdb`. With VIEWER in the
environment, the path of the viewer, it also draws a frame of an exported sequence.
"""

import json
import math
import os
import subprocess
import sys
import tempfile
import unittest
from types import SimpleNamespace

import bpy
import export_blender
import numpy as np
from mathutils import Euler, Matrix
from vdb_sequence import ExportError, Sequence, parse_frames

VDB = sys.argv.pop(1)
openvdb = export_blender.openvdb_module()


def info(path):
    """The grids of a file by name, as our reader has them."""
    text = subprocess.run([VDB, "info", "--json", path], check=True, capture_output=True, text=True).stdout
    return {grid["name"]: grid for grid in json.loads(text)["grids"]}


def places(grid):
    """Indices and where they are in the world, as our reader has them."""
    pairs = grid["index_to_world"]
    return [np.array(index) for index, _ in pairs], [np.array(world) for _, world in pairs]


def voxels(path, name):
    """Indices, places and values of all active voxels."""
    grid = openvdb.read(path, name)
    items = [item for item in grid.citerOnValues() if item.count == 1]
    indices = np.array([item.min for item in items])
    worlds = np.array([grid.transform.indexToWorld(tuple(map(float, index))) for index in indices.tolist()])
    return indices, worlds, np.array([item.value for item in items])


def y_up(points):
    """As the guide says: Blender's x, y, z are Bevy's x, -z, y."""
    x, y, z = np.moveaxis(np.asarray(points), -1, 0)
    return np.stack([x, z, -y], axis=-1)


class Exports(unittest.TestCase):
    def setUp(self):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.scene = bpy.context.scene
        self.scene.render.fps, self.scene.render.fps_base = 60, 2.0
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = folder.name

    def out(self, name):
        return os.path.join(self.folder, name)

    def link(self, name, data):
        own = bpy.data.objects.new(name, data)
        self.scene.collection.objects.link(own)
        return own

    def export(self, objects, name, frames, **options):
        return export_blender.export(objects, self.out(name), frames, report=lambda line: None, **options)

    def volume(self):
        """A volume from a file whose object moves, turns and is stretched: its matrix at a frame is known."""
        grid = openvdb.FloatGrid()
        grid.copyFromArray(np.arange(1.0, 61.0, dtype=np.float32).reshape(3, 4, 5), ijk=(-1, 2, 7))
        grid.name, grid.gridClass = "density", openvdb.GridClass.FOG_VOLUME
        grid.transform = openvdb.createLinearTransform(voxelSize=0.25)
        heat = openvdb.FloatGrid()
        heat.fill((0, 0, 0), (2, 2, 2), 5.0)
        heat.name = "temperature"
        openvdb.write(self.out("source.vdb"), grids=[grid, heat])
        data = bpy.data.volumes.new("smoke")
        data.filepath = self.out("source.vdb")
        own = self.link("smoke", data)

        def matrix(frame):
            turn = Euler((0.1 * frame, 0.2, -0.3 * frame)).to_matrix().to_4x4()
            return Matrix.Translation((frame, 2.0, 3.0)) @ turn @ Matrix.Diagonal((1.0, 2.0, 0.5, 1.0))

        for frame in (3, 4, 5):
            location, turn, scale = matrix(frame).decompose()
            own.location, own.rotation_euler, own.scale = location, turn.to_euler(), scale
            for path in ("location", "rotation_euler", "scale"):
                own.keyframe_insert(path, frame=frame)
        return own, lambda frame: np.array(matrix(frame))

    def test_a_volume_keeps_its_values_and_gets_the_transform_of_its_object(self):
        own, matrix = self.volume()
        index = self.export([own], "z/smoke_####.vdb", range(3, 6), z_up=True)
        self.scene.frame_set(17)
        self.export([own], "y/smoke_####.vdb", range(3, 6))
        self.assertEqual(self.scene.frame_current, 17)
        self.assertEqual(sorted(os.listdir(self.out("z"))), ["smoke.vdbseq"] + [f"smoke_000{i}.vdb" for i in (3, 4, 5)])
        with open(index, encoding="utf-8") as file:
            words = file.read().split()
        self.assertEqual(
            " ".join(words), '( frames: "smoke_####.vdb", first: 3, last: 5, rate: 30, repeat: Loop, )'
        )
        for frame in (3, 4, 5):
            grids = info(self.out(f"z/smoke_000{frame}.vdb"))
            self.assertEqual(sorted(grids), ["density", "temperature"])
            density = grids["density"]
            self.assertEqual((density["value_type"], density["class"]), ("float", "fog volume"))
            self.assertEqual(density["active_voxels"], "60")
            self.assertEqual(density["active_bbox"], [[-1, 2, 7], [1, 5, 11]])
            found = voxels(self.out(f"z/smoke_000{frame}.vdb"), "density")
            i, j, k = (found[0] - [-1, 2, 7]).T
            np.testing.assert_array_equal(found[2], 1 + 20 * i + 5 * j + k)
            samples = [sample for sample in density["samples"] if sample["on"]]
            self.assertTrue(samples)
            for sample in samples:
                i, j, k = np.array(sample["ijk"]) - [-1, 2, 7]
                self.assertEqual(sample["value"], 1 + 20 * i + 5 * j + k)
            indices, worlds = places(density)
            turned = places(info(self.out(f"y/smoke_000{frame}.vdb"))["density"])[1]
            for index, world, other in zip(indices, worlds, turned):
                # Where Blender draws it: in the middle of the cube from this index to the next.
                local = np.append(0.25 * (index + 0.5), 1.0)
                expected = (matrix(frame) @ local)[:3]
                # Blender's transforms are 32-bit floats.
                np.testing.assert_allclose(world, expected, rtol=3e-6, atol=1e-5)
                np.testing.assert_allclose(other, y_up(expected), rtol=3e-6, atol=1e-5)

    def test_geometry_nodes_are_where_their_positions_say(self):
        tree = bpy.data.node_groups.new("nodes", "GeometryNodeTree")
        tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
        nodes, links = tree.nodes, tree.links
        cube = nodes.new("GeometryNodeVolumeCube")
        for axis in "XYZ":
            cube.inputs[f"Resolution {axis}"].default_value = 8
        cube.inputs["Min"].default_value, cube.inputs["Max"].default_value = (0, 0, 0), (2, 4, 6)
        weights = nodes.new("ShaderNodeVectorMath")
        weights.operation = "DOT_PRODUCT"
        weights.inputs[1].default_value = (1.0, 10.0, 100.0)
        links.new(nodes.new("GeometryNodeInputPosition").outputs[0], weights.inputs[0])
        links.new(weights.outputs["Value"], cube.inputs["Density"])
        output = nodes.new("NodeGroupOutput")
        links.new(cube.outputs["Volume"], output.inputs[0])
        own = self.link("cube", bpy.data.meshes.new("empty"))
        own.modifiers.new("nodes", "NODES").node_group = tree
        own.location = (7.0, 0.0, 0.0)
        self.export([own], "cube_##.vdb", range(1, 2), z_up=True)
        _, worlds, values = voxels(self.out("cube_01.vdb"), "density")
        self.assertGreater(len(values), 400)
        expected = (worlds - [7.0, 0.0, 0.0]) @ [1.0, 10.0, 100.0]
        np.testing.assert_allclose(values, expected, rtol=1e-5, atol=1e-4)

    def test_a_mesh_to_volume_is_around_its_mesh(self):
        mesh = self.ball()
        data = bpy.data.volumes.new("fog")
        own = self.link("fog", data)
        modifier = own.modifiers.new("fog", "MESH_TO_VOLUME")
        modifier.object, modifier.resolution_mode = mesh, "VOXEL_SIZE"
        modifier.voxel_size = 0.1
        self.export([own], "fog_####.vdb", range(1, 4))
        for frame in (1, 2, 3):
            _, worlds, values = voxels(self.out(f"fog_000{frame}.vdb"), "density")
            middle = (worlds * values[:, None]).sum(axis=0) / values.sum()
            # Half a voxel is 0.05.
            np.testing.assert_allclose(middle, y_up([frame, 2.0, 3.0]), atol=0.01)

    def ball(self):
        bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=4, radius=0.8)
        mesh = bpy.context.object
        mesh.name = "ball"
        for frame in (1, 2, 3):
            mesh.location = (frame, 2.0, 3.0)
            mesh.keyframe_insert("location", frame=frame)
        return mesh

    def test_a_mesh_becomes_a_level_set(self):
        ball = self.ball()
        planes = [face.normal.dot(ball.data.vertices[face.vertices[0]].co) for face in ball.data.polygons]
        inside = 0.8 - min(planes)
        self.assertLess(inside, 0.006)
        for z_up in (False, True):
            index = self.export([ball], f"{z_up}/ball.vdb", range(1, 4, 2), voxel_size=0.05, half=True, z_up=z_up)
            with open(index, encoding="utf-8") as file:
                self.assertNotIn("first", file.read(), "of every second frame, the folder is listed")
            self.assertFalse(os.path.exists(self.out(f"{z_up}/ball_0002.vdb")))
            for frame in (1, 3):
                path = self.out(f"{z_up}/ball_000{frame}.vdb")
                grid = info(path)["ball"]
                self.assertEqual((grid["class"], grid["half"]), ("level set", True))
                _, worlds, values = voxels(path, "ball")
                middle = np.array([frame, 2.0, 3.0])
                distances = np.linalg.norm(worlds - (middle if z_up else y_up(middle)), axis=1) - 0.8
                # The mesh has corners on the ball and faces inside it; halves have 11 bits. OpenVDB's distances
                # are those to the mesh for two voxels, and beyond them those to a part of it that is near.
                near = np.abs(values) < 0.1
                self.assertGreater(near.sum(), 9000)
                np.testing.assert_allclose(values[near], distances[near], atol=inside + 2e-4)
                self.assertLess(values.min(), -0.12)
                self.assertGreater(values.max(), 0.12)

    def test_a_cache_fills_its_domain(self):
        """Without Blender's simulation, which fails in bpy from PyPI: the settings of the domain are a stand-in, and
        the file has the metadata of those that Blender bakes."""
        bpy.ops.mesh.primitive_cube_add(size=2.0, location=(10.0, 20.0, 30.0), rotation=(0.0, 0.0, math.pi / 2))
        domain = bpy.context.object
        domain.scale = (1.0, 1.0, 2.0)
        settings = SimpleNamespace(cache_directory=self.out("cache"), use_adaptive_domain=False)
        density = openvdb.FloatGrid()
        # The whole domain is 8 x 8 x 16 cells, of which these are two in a corner.
        density.copyFromArray(np.array([[[1.0, 2.0]]], dtype=np.float32), ijk=(0, 7, 14))
        density.name, density.transform = "density", openvdb.createLinearTransform(voxelSize=6.25)
        density["file_base_resolution"], density["file_voxel_size"] = (8, 8, 16), 6.25
        os.makedirs(self.out("cache/data"))
        path = self.out("cache/data/fluid_data_0001.vdb")
        openvdb.write(path, grids=[density])

        def cache(frame):
            self.scene.frame_set(frame)
            depsgraph = bpy.context.evaluated_depsgraph_get()
            exporter = export_blender.Exporter(grids=set(), voxel_size=1.0, band=3.0, half=False, z_up=True)
            return exporter.of_cache(domain, settings, depsgraph)

        [grid] = cache(1)
        openvdb.write(self.out("placed.vdb"), grids=[grid])
        _, worlds, values = voxels(self.out("placed.vdb"), "density")
        np.testing.assert_array_equal(values, [1.0, 2.0])
        # In the domain, cells are 2/8 wide, and 4/16 high with the scale. A quarter turn about z takes x to y.
        local = np.array([[-1 + 0.125, 1 - 0.125, -2 + 14.5 / 4], [-1 + 0.125, 1 - 0.125, -2 + 15.5 / 4]])
        expected = np.column_stack([-local[:, 1], local[:, 0], local[:, 2]]) + [10.0, 20.0, 30.0]
        np.testing.assert_allclose(worlds, expected, atol=1e-5)
        with self.assertRaisesRegex(ExportError, "frame 2: no .*fluid_data_0002.vdb; bake it"):
            cache(2)
        settings.use_adaptive_domain = True
        with self.assertRaisesRegex(ExportError, "adaptive"):
            cache(1)
        settings.use_adaptive_domain = False
        del density["file_base_resolution"]
        openvdb.write(path, grids=[density])
        with self.assertRaisesRegex(ExportError, "resolution"):
            cache(1)

    def test_several_objects_share_a_file_and_grids_can_be_chosen(self):
        own, _ = self.volume()
        self.export([own, self.ball()], "both_#.vdb", range(3, 4), grids=["density", "ball"])
        self.assertEqual(sorted(info(self.out("both_3.vdb"))), ["ball", "density"])
        self.assertFalse(info(self.out("both_3.vdb"))["density"]["half"])

    def test_what_cannot_be_exported_is_refused_with_a_reason(self):
        own, _ = self.volume()
        other = self.link("other", own.data)
        camera = self.link("camera", bpy.data.cameras.new("camera"))
        for objects, frames, options, reason in [
            ([own, other], range(3, 4), {}, "has a grid `density`, too"),
            ([camera], range(3, 4), {}, "neither a volume nor a mesh"),
            ([], range(3, 4), {}, "no objects"),
            ([own], range(3, 4), {"grids": ["fuel"]}, "no grids of these names"),
        ]:
            with self.assertRaisesRegex(ExportError, reason):
                self.export(objects, "no_####.vdb", frames, **options)
            self.assertFalse(os.path.exists(self.out("no.vdbseq")), reason)
        with self.assertRaisesRegex(ExportError, "nobody: no such object"):
            export_blender.main(["nobody", "--out", self.out("no_####.vdb")])

    def test_the_command_line_says_the_same(self):
        self.volume()
        self.scene.frame_start, self.scene.frame_end = 3, 4
        export_blender.main(["smoke", "--out", self.out("a/smoke"), "--grids", "density", "--half"])
        self.assertEqual(sorted(os.listdir(self.out("a"))), ["smoke.vdbseq", "smoke_0003.vdb", "smoke_0004.vdb"])
        grids = info(self.out("a/smoke_0004.vdb"))
        self.assertEqual((list(grids), grids["density"]["half"]), (["density"], True))

    def test_the_script_runs_as_a_program(self):
        def run(*words):
            command = [sys.executable, "-B", export_blender.__file__, *words, "--out", self.out("p/cube.vdb")]
            return subprocess.run(command, capture_output=True, text=True)

        # Blender begins with a cube of two units.
        done = run("Cube", "--frames", "7", "--voxel-size", "0.25")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(info(self.out("p/cube_0007.vdb"))["Cube"]["class"], "level set")
        self.assertTrue(os.path.exists(self.out("p/cube.vdbseq")))
        done = run("Ball")
        self.assertEqual(done.returncode, 1)
        self.assertIn("export_blender: Ball: no such object", done.stderr)

    def test_the_viewer_plays_it(self):
        if "VIEWER" not in os.environ:
            self.skipTest("VIEWER is not set, the path of the viewer")
        index = self.export([self.ball()], "ball_####.vdb", range(1, 4))
        picture = self.out("ball.png")
        command = [os.environ["VIEWER"], index, "--frame", "2", "--size", "64x64", "--out", picture]
        done = subprocess.run(command, capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("ball: surface", done.stderr)


class Names(unittest.TestCase):
    def test_names_are_those_of_sequences(self):
        for out, number, frame, index in [
            ("a/fire_####.vdb", 7, "a/fire_0007.vdb", "a/fire.vdbseq"),
            ("fire", 12345, "./fire_12345.vdb", "./fire.vdbseq"),
            ("a/fire.$F4.vdb", 7, "a/fire.0007.vdb", "a/fire.vdbseq"),
            ("a/fire_%03d.vdb", 7, "a/fire_007.vdb", "a/fire.vdbseq"),
            ("a/fire_##_v2.vdb", 7, "a/fire_07_v2.vdb", "a/fire_v2.vdbseq"),
            ("a/####.vdb", 7, "a/0007.vdb", "a/sequence.vdbseq"),
        ]:
            sequence = Sequence(out)
            self.assertEqual((sequence.frame(number), sequence.index), (frame, index))
        for out in ("a_##_##.vdb", "a_" + 16 * "#"):
            with self.assertRaisesRegex(ExportError, "placeholder"):
                Sequence(out)

    def test_frames_that_no_sequence_can_have_are_refused(self):
        with tempfile.TemporaryDirectory() as folder:
            sequence = Sequence(os.path.join(folder, "a", "fire"))
            for frames, reason in [(range(-3, 4), "cannot be negative"), (range(100_001), "at most 100000")]:
                with self.assertRaisesRegex(ExportError, reason):
                    sequence.prepare(frames)
                self.assertFalse(os.path.exists(sequence.folder))
            sequence.prepare(range(100_000))
            self.assertTrue(os.path.exists(sequence.folder))

    def test_frames_are_numbers_and_ranges(self):
        self.assertEqual(list(parse_frames("12")), [12])
        self.assertEqual(list(parse_frames("1-5/2")), [1, 3, 5])
        for text in ("", "-3", "5-1", "1-5/0", "a", "1-"):
            with self.assertRaisesRegex(ExportError, "--frames"):
                parse_frames(text)


if __name__ == "__main__":
    unittest.main()
