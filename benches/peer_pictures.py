"""Pictures of the bundled models by the viewer and by Cycles (Blender), and how much they differ.

use: peer_pictures.py --viewer PROGRAM --flip PROGRAM --out FOLDER [--samples N] [SCENE…]

Both have the same file, camera, sun, uniform sky and material. What the viewer writes is turned back into light by
the inverse of its tone curve, and Cycles' light is shown by the same curve, Khronos' PBR Neutral. FOLDER gets
SCENE.png, with the viewer's picture on the left and that of Cycles on the right. Prints a row of the table of
docs/reference/quality.md for each comparison.

Cycles renders each picture twice, with half of the samples, which gives its noise. Needs what peer_cycles.py needs.
"""

import argparse
import os
import struct
import subprocess
import sys
import tempfile
import zlib

import numpy as np
import peer_cycles

WIDTH, HEIGHT = 480, 270
# The light of the viewer (examples/viewer/app.rs) at Bevy's default exposure.
EXPOSURE = 1.0 / (1.2 * 2.0**9.7)
SUN, SUN_COLOR = 3600.0 * EXPOSURE, (1.0, 0.94, 0.86)
SKY, SKY_COLOR = 340.0 * EXPOSURE, (0.8, 0.9, 1.0)
TO_SUN = [-0.6, 0.75, 0.5]
BACKGROUND = np.array([0.042, 0.062, 0.092])
FOV = 45.0
MODELS = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "assets", "models")

SCENES = {
    "teapot": {
        "file": "teapot.vdb",
        "surface": "surface",
        "eye": [3.4, 4.0, 6.2],
        "target": [0.1, 1.5, 0.0],
    },
    "cloud": {
        "file": "cloud.vdb",
        "grid": "density",
        "density_scale": 3.0,
        "eye": [6.4, 8.0, 5.0],
        "target": [1.0, 4.5, -4.9],
    },
    "fire": {
        "file": "fire/fire_0008.vdb",
        "grid": "density",
        "density_scale": 4.0,
        "eye": [0.85, 1.05, 1.95],
        "target": [0.0, 0.75, 0.05],
        # Kelvin for a flame of 1, and the strength of emission per world unit.
        "fire": {"grid": "flame", "kelvin": 1700.0, "strength": 0.01},
    },
}


# ---- the viewer


def viewer_options(scene):
    def point(values):
        return ",".join(str(value) for value in values)

    options = ["--size", f"{WIDTH}x{HEIGHT}", "--fov", str(FOV), "--sun", point(TO_SUN)]
    options += ["--eye", point(scene["eye"]), "--target", point(scene["target"])]
    if "surface" in scene:
        return options + ["--grid", scene["surface"]]
    options += ["--grid", scene["grid"], "--density", str(scene["density_scale"])]
    if "fire" in scene:
        fire = scene["fire"]
        options += ["--fire", fire["grid"], "--heat", f"{fire['kelvin']},0", "--glow", str(fire["strength"])]
    return options


def viewed(program, scene, folder, *more):
    """The viewer's picture, as sRGB from 0 to 1."""
    path = os.path.join(folder, "viewer.png")
    words = [program, os.path.join(MODELS, scene["file"]), *viewer_options(scene), *more, "--out", path]
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    import bpy

    image = bpy.data.images.load(path)
    image.colorspace_settings.name = "Non-Color"
    pixels = np.empty(WIDTH * HEIGHT * image.channels, dtype=np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(HEIGHT, WIDTH, -1)[::-1, :, :3].astype(np.float64)


# ---- the tone curve: Khronos' PBR Neutral, as Bevy has it

START, DESATURATION = 0.8 - 0.04, 0.15
ROOM = 1.0 - START


def tone(light):
    least = light.min(axis=-1, keepdims=True)
    color = light - np.where(least < 0.08, least - 6.25 * least**2, 0.04)
    peak = np.maximum(color.max(axis=-1, keepdims=True), START)
    new_peak = 1.0 - ROOM**2 / (peak + ROOM - START)
    mix = 1.0 - 1.0 / (DESATURATION * (peak - new_peak) + 1.0)
    scale = np.where(peak > START, new_peak / peak, 1.0)
    return np.where(peak > START, color * scale * (1.0 - mix) + new_peak * mix, color)


def light_of(shown):
    """The inverse of `tone`."""
    new_peak = np.clip(shown.max(axis=-1, keepdims=True), START, 1.0 - 0.25 / 255.0)
    peak = ROOM**2 / (1.0 - new_peak) - ROOM + START
    mix = 1.0 - 1.0 / (DESATURATION * (peak - new_peak) + 1.0)
    color = (shown - new_peak * mix) / (1.0 - mix) * peak / new_peak
    color = np.where(shown.max(axis=-1, keepdims=True) > START, color, shown)
    least = np.maximum(color.min(axis=-1, keepdims=True), 0.0)
    return color + np.where(least < 0.04, np.sqrt(least / 6.25) - least, 0.04)


def encoded(linear):
    linear = np.clip(linear, 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def decoded(srgb):
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


# ---- Cycles


def log_luminance(hottest):
    """Coefficients of the logarithm of a black body's luminance in cd/m², a polynomial of 1000 K / kelvin.

    Planck's law, with the observer of CIE 1931 as Mitsuba has it.
    """
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    nm = np.arange(360.0, 831.0, 1.0)
    sensitivity = np.array([mi.cie1931_xyz(wavelength)[1] for wavelength in nm]).ravel()

    def luminance(kelvin):
        meters = nm * 1e-9
        radiance = 1.191042972e-16 / meters**5 / np.expm1(1.438776877e-2 / (meters * kelvin))
        return 683.002 * (radiance * sensitivity).sum() * 1e-9

    kelvin = np.linspace(peer_cycles.COLDEST, hottest, 400)
    exact = np.log([luminance(one) for one in kelvin])
    coefficients = np.polyfit(1000.0 / kelvin, exact, 5)
    worst = np.abs(np.expm1(np.polyval(coefficients, 1000.0 / kelvin) - exact)).max()
    if worst > 0.003:
        sys.exit(f"the luminance of black bodies is off by {worst:.1%}")
    return coefficients.tolist()


def cycles_scene(scene, samples):
    described = {
        **scene,
        "file": os.path.join(MODELS, scene["file"]),
        "up": [0, 1, 0],
        "vertical_fov_degrees": FOV,
        "width": WIDTH,
        "height": HEIGHT,
        "to_sun": TO_SUN,
        "irradiance": SUN,
        "sun_color": SUN_COLOR,
        "samples": samples,
        # Fog is white and scatters evenly, as VdbMaterial does by default.
        "albedo": 1.0,
        "anisotropy": 0.0,
        # In voxels: steps of the cloud have an optical depth of up to a half, which peer_cycles.py found enough.
        "step_rate": 2.0 if "fire" not in scene else 1.0,
    }
    if "fire" in scene:
        fire = scene["fire"]
        curve = log_luminance(fire["kelvin"] * 1.05)
        described["fire"] = {**fire, "strength": fire["strength"] * EXPOSURE, "log_luminance": curve}
    return described


def add_surface(bpy, world, scene, casts_shadows):
    """The level set as a mesh: OpenVDB's, with smooth normals, and the material of VdbMaterial."""
    grid = peer_cycles.openvdb_module().read(scene["file"], scene["surface"])
    points, quads = grid.convertToQuads(0.0)
    mesh = bpy.data.meshes.new("surface")
    mesh.from_pydata(points.tolist(), [], quads[:, ::-1].tolist())
    mesh.shade_smooth()
    material = bpy.data.materials.new("surface")
    material.use_nodes = True
    surface = material.node_tree.nodes["Principled BSDF"]
    surface.inputs["Base Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    surface.inputs["Roughness"].default_value = 0.5
    # A reflectance of 0.5 is 4 % at normal incidence.
    surface.inputs["IOR"].default_value = 1.5
    mesh.materials.append(material)
    place = bpy.data.objects.new("surface", mesh)
    place.visible_shadow = casts_shadows
    world.collection.objects.link(place)


def add_sky(bpy, world, strength):
    sky = bpy.data.worlds.new("sky")
    sky.use_nodes = True
    background = sky.node_tree.nodes["Background"]
    background.inputs["Color"].default_value = (*SKY_COLOR, 1.0)
    background.inputs["Strength"].default_value = strength
    world.world = sky


def path_traced(scene, seed, sun=True, sky=SKY, bounces=None, casts_shadows=True):
    """Light and coverage by Cycles."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    world = bpy.context.scene
    if "surface" in scene:
        add_surface(bpy, world, scene, casts_shadows)
    else:
        peer_cycles.add_fog(bpy, world, scene)
    peer_cycles.add_sun(bpy, world, {**scene, "irradiance": scene["irradiance"] if sun else 0.0})
    add_sky(bpy, world, sky)
    peer_cycles.add_camera(bpy, world, scene)
    peer_cycles.settle(world, {**scene, "seed": seed})
    world.render.film_transparent = True
    if bounces is not None:
        world.cycles.max_bounces = world.cycles.volume_bounces = bounces
    return peer_cycles.render(bpy, world).astype(np.float64)


def judged(render):
    """Two pictures with different noise, both in front of the viewer's background."""
    pictures = [render(seed) for seed in (1, 2)]
    return [picture[..., :3] + (1.0 - picture[..., 3:]) * BACKGROUND for picture in pictures]


# ---- the comparison


def flip(program, a, b, folder):
    paths = [os.path.join(folder, name) for name in ("a.pfm", "b.pfm")]
    for path, picture in zip(paths, (a, b)):
        peer_cycles.write_pfm(path, picture)
    words = subprocess.run([program, *paths], check=True, capture_output=True, text=True).stdout.split()
    return float(words[0])


def write_png(path, picture):
    rows = np.round(np.clip(picture, 0.0, 1.0) * 255.0).astype(np.uint8)
    height, width, _ = rows.shape
    # Differences to the row above are smaller, and so is the file.
    up = rows.copy()
    up[1:] -= rows[:-1]
    lines = b"".join(b"\x02" + row.tobytes() for row in up)

    def chunk(kind, data):
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    with open(path, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n")
        file.write(chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)))
        file.write(chunk(b"IDAT", zlib.compress(lines, 9)) + chunk(b"IEND", b""))


def compare(label, shown, light, options, folder):
    """Prints a row of the table, and returns what the judge's picture looks like."""
    theirs, ours = np.mean(light, axis=0), light_of(decoded(shown))
    # Where the model is, by the picture without noise: where Cycles has caught light, it has caught too much. The
    # viewer's background is dithered by half a step.
    inside = np.abs(shown - encoded(tone(BACKGROUND))).max(axis=-1) > 1.5 / 255.0
    total = theirs[inside].sum()
    error = np.abs(ours - theirs)[inside].sum() / total
    # The mean of both has half of their difference.
    noise = 0.5 * np.abs(light[0] - light[1])[inside].sum() / total
    pictures = [decoded(shown), *(np.clip(tone(picture), 0.0, 1.0) for picture in [theirs, *light])]
    differs = flip(options.flip, pictures[0], pictures[1], folder)
    floor = flip(options.flip, pictures[2], pictures[3], folder)
    brightness = ours[inside].sum() / total
    print(f"| {label} | {brightness:.3f} | {error:.3f} | {noise:.3f} | {differs:.4f} | {floor:.4f} |", flush=True)
    return encoded(pictures[1])


def surface_rows(name, scene, shown, options, folder):
    """Rows for the light that the viewer has, and for all of it."""
    # No light from one part of the surface to another, and a sky that nothing hides.
    seeds = (1, 2)
    sun = [path_traced(scene, seed, sky=0.0, bounces=0) for seed in seeds]
    sky = [path_traced(scene, seed, False, bounces=0, casts_shadows=False)[..., :3] for seed in seeds]
    # Bevy's AmbientLight is an approximation: how bright it is shows where the sun does not arrive.
    ours = light_of(decoded(shown))
    in_shadow = (sun[0][..., 3] > 0.99) & (sun[0][..., :3].max(axis=-1) < 0.005)
    ratio = np.median(ours[in_shadow].mean(axis=-1) / sky[0][in_shadow].mean(axis=-1))
    for label, scale in [(f"direct light, sky × {ratio:.2f}", ratio), ("direct light", 1.0)]:
        added = [np.dstack([s[..., :3] + scale * k, s[..., 3]]) for s, k in zip(sun, sky)]
        compare(f"{name}, {label}", shown, judged(lambda seed: added[seed - 1]), options, folder)
    return compare(f"{name}, all light", shown, judged(lambda seed: path_traced(scene, seed)), options, folder)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--viewer", required=True)
    parser.add_argument("--flip", required=True)
    parser.add_argument("--out", required=True)
    parser.add_argument("--samples", type=int, default=256, help="paths per pixel")
    parser.add_argument("scenes", nargs="*", choices=[[], *SCENES], default=[])
    options = parser.parse_args()
    os.makedirs(options.out, exist_ok=True)
    print("| picture | brightness | error | noise of Cycles | FLIP | FLIP of noise |")
    print("|---|---|---|---|---|---|", flush=True)
    for name in options.scenes or SCENES:
        scene = SCENES[name]
        described = cycles_scene(scene, options.samples // 2)
        with tempfile.TemporaryDirectory() as folder:
            shown = viewed(options.viewer, scene, folder)
            if "surface" in scene:
                theirs = surface_rows(name, described, shown, options, folder)
            else:
                judge = judged(lambda seed: path_traced(described, seed))
                theirs = compare(name, shown, judge, options, folder)
        write_png(os.path.join(options.out, f"{name}.png"), np.hstack([shown, theirs]))


if __name__ == "__main__":
    main()
