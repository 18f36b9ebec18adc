"""Path-traces the fog of a .vdb file by Cycles (Blender) or by Mitsuba 3.

use: peer_cycles.py cycles|mitsuba SCENE.json OUT.pfm

Both know nothing of this repository, so they judge the light that fog scatters many times. OUT.pfm is a gray
picture of linear radiance in 32-bit floats, of rays through the middles of the pixels, against a black background.

The scene:

    file                  path of the .vdb file
    grid                  name of the density, which is not negative; its transform is linear
    density_scale         extinction per world unit for a density of 1
    albedo, anisotropy    of the fog, the latter Henyey and Greenstein's g: positive scatters forwards
    eye, target, up       the camera, in the world of the grid's own transform
    vertical_fov_degrees, width, height
    to_sun, irradiance    a sun without extent: its direction, and its light on a surface that faces it
    samples, seed         paths per pixel; another seed gives independent noise
    step_rate             (Cycles alone) its steps, in voxels; 0.25 if left out
    fire                  (Cycles alone) black bodies: a grid, kelvin for a value of 1, a strength, and
                          coefficients of the logarithm of their luminance, a polynomial of 1000 K / kelvin

Needs Python 3.11, which bpy 4.5 is built for, and the packages bpy, mitsuba and numpy.
"""

import argparse
import json
import os
import sys
import tempfile

import numpy as np

# As many as Cycles accepts.
MAX_BOUNCES = 1024
MAX_STEPS = 65536
# In kelvin; anything colder is black, and the same to the eye.
COLDEST = 500.0


def unit(vector):
    vector = np.asarray(vector, dtype=np.float64)
    return vector / np.linalg.norm(vector)


def camera_axes(scene):
    """The unit vectors to the right, up and backwards of the camera."""
    back = unit(np.subtract(scene["eye"], scene["target"]))
    right = unit(np.cross(scene["up"], back))
    return right, np.cross(back, right), back


def write_pfm(path, picture):
    """Writes rows, gray or coloured, that are given from the top; the format has them from the bottom."""
    height, width = picture.shape[:2]
    kind = "Pf" if picture.ndim == 2 else "PF"
    with open(path, "wb") as file:
        file.write(f"{kind}\n{width} {height}\n-1.0\n".encode())
        file.write(np.ascontiguousarray(picture[::-1], dtype="<f4").tobytes())


def cycles(scene):
    """The picture that Cycles makes.

    Its defaults are for pictures without noise; whatever trades accuracy for that is turned off here. What is
    left is the size of its steps: it marches through fog, with one random offset per ray, instead of
    sampling collisions. Where a voxel has an optical depth of a half, steps of 4 voxels made a picture 10%
    too bright; at 1 voxel and below, no difference was left beyond noise of 0.2%.
    """
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    world = bpy.context.scene
    add_fog(bpy, world, scene)
    add_sun(bpy, world, scene)
    add_camera(bpy, world, scene)
    settle(world, scene)
    return render(bpy, world)[:, :, 0]


def add_fog(bpy, world, scene):
    """A volume where the file has it.

    An object without a transform keeps the coordinates of the grid, but Cycles takes the value of a voxel to
    be in the middle of the cube from its index to the next one. OpenVDB has it at the index itself, so the
    object is moved back by half a voxel.
    """
    volume = bpy.data.volumes.new("fog")
    volume.filepath = os.path.abspath(scene["file"])
    # Half floats, the default, round the density; clipping drops the thinnest fog.
    volume.render.precision = "FULL"
    volume.render.clipping = 0.0
    if not volume.grids.load() or scene["grid"] not in volume.grids:
        sys.exit(f"{scene['file']}: no grid {scene['grid']}: {volume.grids.error_message}")

    material = bpy.data.materials.new("fog")
    material.use_nodes = True
    material.cycles.volume_sampling = "DISTANCE"
    material.cycles.volume_interpolation = "LINEAR"
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    density = nodes.new("ShaderNodeAttribute")
    density.attribute_name = scene["grid"]
    # This node has coefficients per unit of length, and no colors that are clamped or squared.
    fog = nodes.new("ShaderNodeVolumeCoefficients")
    fog.phase = "HENYEY_GREENSTEIN"
    fog.inputs["Anisotropy"].default_value = scene["anisotropy"]
    parts = {"Scatter Coefficients": scene["albedo"], "Absorption Coefficients": 1.0 - scene["albedo"]}
    for name, part in parts.items():
        scale = nodes.new("ShaderNodeVectorMath")
        scale.operation = "SCALE"
        scale.inputs["Scale"].default_value = part * scene["density_scale"]
        links.new(density.outputs["Fac"], scale.inputs["Vector"])
        links.new(scale.outputs["Vector"], fog.inputs[name])
    if "fire" in scene:
        add_fire(nodes, links, scene["fire"], fog.inputs["Emission Coefficients"])
    output = nodes.new("ShaderNodeOutputMaterial")
    links.new(fog.outputs["Volume"], output.inputs["Volume"])
    volume.materials.append(material)
    place = bpy.data.objects.new("fog", volume)
    to_world = np.array(volume.grids[scene["grid"]].matrix_object)
    place.location = to_world[:3, :3] @ np.full(3, -0.5)
    world.collection.objects.link(place)


def add_fire(nodes, links, fire, emission):
    """Black bodies: their colour is that of Cycles' own node, their luminance Planck's law, a polynomial here."""

    def math(operation, *inputs):
        node = nodes.new("ShaderNodeMath")
        node.operation = operation
        for socket, value in zip(node.inputs, inputs):
            if isinstance(value, float):
                socket.default_value = value
            else:
                links.new(value, socket)
        return node.outputs["Value"]

    value = nodes.new("ShaderNodeAttribute")
    value.attribute_name = fire["grid"]
    kelvin = math("MAXIMUM", math("MULTIPLY", value.outputs["Fac"], fire["kelvin"]), COLDEST)
    inverse = math("DIVIDE", 1000.0, kelvin)
    logarithm = 0.0
    for coefficient in fire["log_luminance"]:
        logarithm = math("MULTIPLY_ADD", logarithm, inverse, coefficient)
    luminance = math("MULTIPLY", math("EXPONENT", logarithm), fire["strength"])
    is_hot = math("GREATER_THAN", kelvin, COLDEST)
    body = nodes.new("ShaderNodeBlackbody")
    links.new(kelvin, body.inputs["Temperature"])
    scale = nodes.new("ShaderNodeVectorMath")
    scale.operation = "SCALE"
    links.new(body.outputs["Color"], scale.inputs["Vector"])
    links.new(math("MULTIPLY", luminance, is_hot), scale.inputs["Scale"])
    links.new(scale.outputs["Vector"], emission)


def matrix(right, up, back, place):
    from mathutils import Matrix

    columns = np.column_stack([right, up, back, place])
    return Matrix([*columns.tolist(), [0.0, 0.0, 0.0, 1.0]])


def add_sun(bpy, world, scene):
    sun = bpy.data.lights.new("sun", "SUN")
    sun.energy = scene["irradiance"]
    sun.color = scene.get("sun_color", (1.0, 1.0, 1.0))
    sun.angle = 0.0
    lamp = bpy.data.objects.new("sun", sun)
    # Lamps shine along their own -z.
    back = unit(scene["to_sun"])
    right = unit(np.cross(np.eye(3)[np.argmin(np.abs(back))], back))
    lamp.matrix_world = matrix(right, np.cross(back, right), back, np.zeros(3))
    world.collection.objects.link(lamp)


def add_camera(bpy, world, scene):
    camera = bpy.data.cameras.new("camera")
    camera.sensor_fit = "VERTICAL"
    camera.angle_y = np.radians(scene["vertical_fov_degrees"])
    distance = np.linalg.norm(np.subtract(scene["eye"], scene["target"]))
    camera.clip_start = 1e-4 * distance
    camera.clip_end = 1e4 * distance
    seer = bpy.data.objects.new("camera", camera)
    seer.matrix_world = matrix(*camera_axes(scene), scene["eye"])
    world.collection.objects.link(seer)
    world.camera = seer


def settle(world, scene):
    world.render.engine = "CYCLES"
    world.render.resolution_x = scene["width"]
    world.render.resolution_y = scene["height"]
    world.render.resolution_percentage = 100
    world.render.film_transparent = False
    world.render.use_compositing = False
    world.render.use_sequencer = False
    world.view_settings.view_transform = "Raw"
    cycles = world.cycles
    cycles.device = "CPU"
    cycles.samples = scene["samples"]
    cycles.seed = scene["seed"]
    cycles.use_adaptive_sampling = False
    cycles.use_denoising = False
    cycles.use_light_tree = False
    cycles.light_sampling_threshold = 0.0
    cycles.sample_clamp_direct = 0.0
    cycles.sample_clamp_indirect = 0.0
    cycles.blur_glossy = 0.0
    cycles.max_bounces = MAX_BOUNCES
    cycles.volume_bounces = MAX_BOUNCES
    # Each crossing of the mesh around the fog counts as one.
    cycles.transparent_max_bounces = MAX_BOUNCES
    cycles.volume_step_rate = scene.get("step_rate", 0.25)
    cycles.volume_max_steps = MAX_STEPS
    # Of the box, Cycles ignores the width: it is the whole pixel. A narrow bell is the middle alone.
    cycles.pixel_filter_type = "GAUSSIAN"
    cycles.filter_width = 0.01


def render(bpy, world):
    """The picture, through a file: a result of a render has no pixels to read."""
    image = world.render.image_settings
    image.file_format = "OPEN_EXR"
    image.color_mode = "RGBA" if world.render.film_transparent else "RGB"
    image.color_depth = "32"
    image.exr_codec = "NONE"
    with tempfile.TemporaryDirectory() as folder:
        world.render.filepath = os.path.join(folder, "picture.exr")
        bpy.ops.render.render(write_still=True)
        picture = bpy.data.images.load(world.render.filepath)
        picture.colorspace_settings.name = "Non-Color"
        width, height = picture.size
        pixels = np.empty(width * height * picture.channels, dtype=np.float32)
        picture.pixels.foreach_get(pixels)
    return pixels.reshape(height, width, -1)[::-1]


def openvdb_module():
    """OpenVDB's module, which Blender brings along and does not put in the path."""
    import bpy

    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    folder = bpy.utils.resource_path("LOCAL")
    sys.path.append(os.path.join(folder, "python", "lib", version, "site-packages"))
    import openvdb

    return openvdb


def read_grid(path, name):
    """A dense array of a grid's values, and the matrix to the world from indices of the array, with a margin
    of one voxel of background so that linear interpolation falls to it."""
    openvdb = openvdb_module()
    grid = openvdb.read(path, name)
    low, high = (np.array(corner) for corner in grid.evalActiveVoxelBoundingBox())
    low, high = low - 1, high + 1
    values = np.zeros(high - low + 1, dtype=np.float32)
    grid.copyToArray(values, ijk=tuple(low.tolist()))

    def place(index):
        return np.array(grid.transform.indexToWorld(tuple(index.tolist())))

    origin = place(low.astype(np.float64))
    steps = [place(low + axis) - origin for axis in np.eye(3)]
    to_world = np.eye(4)
    to_world[:3, :3] = np.column_stack(steps)
    to_world[:3, 3] = origin
    return np.maximum(values, 0.0), to_world


def mitsuba(scene):
    """The picture that Mitsuba makes. Its collisions are sampled, so it has no steps."""
    import mitsuba as mi

    # The variants that compile with LLVM are faster, and fail with some versions of it.
    mi.set_variant("scalar_rgb")
    values, to_world = read_grid(scene["file"], scene["grid"])
    scene, to_world = about_the_fog(scene, values, to_world)
    world = mi.load_dict(mitsuba_scene(mi, scene, values, to_world))
    # Roulette never begins: it would only add noise.
    integrator = mi.load_dict({"type": "volpath", "max_depth": -1, "rr_depth": 1 << 30})
    light = mi.render(
        world,
        sensor=mi.load_dict(mitsuba_rays(mi, scene)),
        integrator=integrator,
        spp=scene["samples"],
        seed=scene["seed"],
    )
    return np.array(light)[0, :, 0].reshape(scene["height"], scene["width"])


def about_the_fog(scene, values, to_world):
    """The same scene with the fog in the middle of its world, 10 units about it.

    Mitsuba's tolerances are in units of the world and grow with the distance from the origin: a fog of
    extinction 1.8 was 0.4% too bright 100 units away from it, and as bright as by other means about it.
    """
    corner = to_world[:3, :3] @ (np.array(values.shape) - 1.0) / 2.0
    middle = to_world[:3, 3] + corner
    unit_of_length = np.linalg.norm(corner) / 10.0
    moved = {
        **scene,
        "eye": ((np.array(scene["eye"]) - middle) / unit_of_length).tolist(),
        "target": ((np.array(scene["target"]) - middle) / unit_of_length).tolist(),
        "density_scale": scene["density_scale"] * unit_of_length,
    }
    to_world = to_world.copy()
    to_world[:3, 3] -= middle
    to_world[:3] /= unit_of_length
    return moved, to_world


def mitsuba_rays(mi, scene):
    """A sensor for each pixel, which sees one ray. Mitsuba's cameras spread their rays over the pixels."""
    width, height = scene["width"], scene["height"]
    right, up, back = camera_axes(scene)
    half = np.tan(np.radians(scene["vertical_fov_degrees"]) / 2.0)
    film = {
        "type": "hdrfilm",
        "width": 1,
        "height": 1,
        "pixel_format": "luminance",
        "component_format": "float32",
        "rfilter": {"type": "box"},
    }
    sensors = {}
    for y in range(height):
        for x in range(width):
            across = (2.0 * x + 1.0 - width) / height * half
            upwards = (height - 2.0 * y - 1.0) / height * half
            way = unit(across * right + upwards * up - back)
            sensors[f"pixel_{y:05}_{x:05}"] = {
                "type": "radiancemeter",
                "origin": scene["eye"],
                "direction": way.tolist(),
                "film": film,
            }
    return {"type": "batch", **sensors, "film": {**film, "width": width * height}}


def mitsuba_scene(mi, scene, values, to_world):
    most = float(values.max())
    size = np.array(values.shape, dtype=np.float64)
    # Its voxels have their values in their middles, and fill the unit cube.
    cube = np.eye(4)
    cube[:3, :3] = np.diag(size)
    cube[:3, 3] = -0.5
    # The fog ends at the first and the last samples, half a voxel inside. The cube of a shape is from -1 to 1.
    box = np.eye(4)
    box[:3, :3] = np.diag((size - 1.0) / 2.0)
    box[:3, 3] = (size - 1.0) / 2.0
    phase = {"type": "hg", "g": scene["anisotropy"]}
    if scene["anisotropy"] == 0.0:
        phase = {"type": "isotropic"}
    fog = {
        "type": "heterogeneous",
        "albedo": scene["albedo"],
        "scale": scene["density_scale"] * most,
        "sigma_t": {
            "type": "gridvolume",
            # Mitsuba's arrays have x last.
            "grid": mi.VolumeGrid(np.ascontiguousarray(values.transpose(2, 1, 0))[..., None] / most),
            "to_world": mi.ScalarTransform4f(to_world @ cube),
            "raw": True,
            "filter_type": "trilinear",
            "wrap_mode": "clamp",
        },
        "phase": phase,
    }
    return {
        "type": "scene",
        "fog": {
            "type": "cube",
            "to_world": mi.ScalarTransform4f(to_world @ box),
            "bsdf": {"type": "null"},
            "interior": fog,
        },
        "sun": {
            "type": "directional",
            "direction": (-unit(scene["to_sun"])).tolist(),
            "irradiance": {"type": "rgb", "value": scene["irradiance"]},
        },
    }


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("renderer", choices=["cycles", "mitsuba"])
    parser.add_argument("scene", help="SCENE.json")
    parser.add_argument("out", help="OUT.pfm")
    arguments = parser.parse_args()
    with open(arguments.scene, encoding="utf-8") as file:
        scene = json.load(file)
    picture = {"cycles": cycles, "mitsuba": mitsuba}[arguments.renderer](scene)
    write_pfm(arguments.out, picture)


if __name__ == "__main__":
    main()
