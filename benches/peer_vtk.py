"""Draws a grid of values with a transfer function by VTK, on the CPU (`vtkFixedPointVolumeRayCastMapper`).

use: peer_vtk.py SCENE.json OUT.pfm

VTK's ray caster draws pictures larger than they should be, by edge / (edge - 1); the field of view is wider by as
much, so that rays are where they should be.

VTK knows nothing of this repository, so it judges the transfer functions of fog. OUT.pfm is a colour picture of
VTK's eight bits against a black background, from 0 to 1, of rays through the middles of the pixels.

The scene:

    file                  path of the values: 32-bit floats of this machine, x fastest
    size                  samples along x, y and z
    origin, spacing       of the first sample, and between samples, in the world
    stops                 [value, extinction per world unit, red, green, blue] by ascending value; the light that a
                          point sends is the colour times the extinction
    eye, target, up       the camera
    fov_degrees, edge     of a square picture, edge in pixels
    step                  distance between samples along a ray, in the world

Between stops, VTK interpolates opacities, which it is given for a distance of `step`, and colours. Needs the
package vtk.
"""

import json
import math
import struct
import sys

import vtk
from vtk.util import numpy_support

import numpy as np


def volume_of(scene):
    values = np.fromfile(scene["file"], dtype=np.float32)
    image = vtk.vtkImageData()
    image.SetDimensions(*scene["size"])
    image.SetOrigin(*scene["origin"])
    image.SetSpacing(*[scene["spacing"]] * 3)
    image.GetPointData().SetScalars(numpy_support.numpy_to_vtk(values, deep=True))

    opacity = vtk.vtkPiecewiseFunction()
    color = vtk.vtkColorTransferFunction()
    color.SetColorSpaceToRGB()
    for value, extinction, red, green, blue in scene["stops"]:
        opacity.AddPoint(value, 1.0 - math.exp(-extinction * scene["step"]))
        color.AddRGBPoint(value, red, green, blue)

    properties = vtk.vtkVolumeProperty()
    properties.SetScalarOpacity(opacity)
    properties.SetScalarOpacityUnitDistance(scene["step"])
    properties.SetColor(color)
    properties.SetInterpolationTypeToLinear()
    properties.ShadeOff()

    mapper = vtk.vtkFixedPointVolumeRayCastMapper()
    mapper.SetInputData(image)
    mapper.AutoAdjustSampleDistancesOff()
    mapper.SetImageSampleDistance(1.0)
    mapper.SetSampleDistance(scene["step"])
    mapper.SetInteractiveSampleDistance(scene["step"])

    volume = vtk.vtkVolume()
    volume.SetMapper(mapper)
    volume.SetProperty(properties)
    return volume


def draw(scene):
    renderer = vtk.vtkRenderer()
    renderer.SetBackground(0.0, 0.0, 0.0)
    renderer.AddVolume(volume_of(scene))
    camera = renderer.GetActiveCamera()
    camera.SetPosition(*scene["eye"])
    camera.SetFocalPoint(*scene["target"])
    camera.SetViewUp(*scene["up"])
    edge = scene["edge"]
    half = math.tan(math.radians(0.5 * scene["fov_degrees"])) * edge / (edge - 1)
    camera.SetViewAngle(math.degrees(2.0 * math.atan(half)))
    renderer.ResetCameraClippingRange()

    window = vtk.vtkRenderWindow()
    window.SetOffScreenRendering(1)
    window.SetMultiSamples(0)
    window.SetSize(edge, edge)
    window.AddRenderer(renderer)
    window.Render()

    grab = vtk.vtkWindowToImageFilter()
    grab.SetInput(window)
    grab.SetInputBufferTypeToRGB()
    grab.ReadFrontBufferOff()
    grab.Update()
    image = grab.GetOutput()
    width, height, _ = image.GetDimensions()
    pixels = numpy_support.vtk_to_numpy(image.GetPointData().GetScalars())
    # From the bottom, as PFM has it.
    return pixels.reshape(height, width, 3).astype(np.float32) / 255.0


def main():
    with open(sys.argv[1], encoding="utf-8") as file:
        scene = json.load(file)
    pixels = draw(scene)
    height, width, _ = pixels.shape
    with open(sys.argv[2], "wb") as file:
        file.write(f"PF\n{width} {height}\n-1.0\n".encode())
        file.write(struct.pack(f"<{pixels.size}f", *pixels.ravel()))


if __name__ == "__main__":
    main()
