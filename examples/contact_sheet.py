"""A contact sheet of generated cities: each preset from above and from its streets.

python examples/contact_sheet.py sheet.jpg hamlet montmartre
"""

import math
import sys

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from shapely.geometry import Point

from citygen.generate import generate
from citygen.presets import PRESETS
from mmi.camera import Camera, view_towards
from mmi.ground import ground_mesh
from mmi.surfaces import build_city_mesh
from viewer.gl import Renderer
from viewer.technique import Ground, Objects, Plan, Sky

CAMERA = Camera(480, 320, math.radians(65.0))


def pictures(preset: str) -> NDArray[np.uint8]:
    """From above, and along two streets near the middle."""
    city = generate(preset, seed=0)
    mesh, ground = build_city_mesh(city), ground_mesh(city, margin=300.0)
    plan = Plan(
        (
            Objects("all", np.arange(len(city.objects))),
            Ground(tuple(range(len(ground.triangle_counts)))),
            Sky(),
        )
    )
    low, high = mesh.positions.min(axis=0).astype(float), mesh.positions.max(axis=0).astype(float)
    middle, extent = 0.5 * (low + high), float(np.linalg.norm((high - low)[:2]))
    above = middle + extent * np.array([-0.42, -0.5, 0.42])
    poses = [(above, math.atan2(0.5, 0.42), -0.52)]
    edges = [edge["geometry"] for _, _, edge in city.streets.edges(data=True)]
    near = sorted(edges, key=lambda line: line.distance(_point(middle)) - 0.3 * min(line.length, 80.0))
    for line in near[:2]:
        a, b = (np.array(line.interpolate(t, normalized=True).coords[0]) for t in (0.15, 0.9))
        if np.linalg.norm(b - middle[:2]) > np.linalg.norm(a - middle[:2]):
            a, b = b, a
        eye = np.append(a, float(city.ground_at(a)) + 1.7)
        poses.append((eye, math.atan2(*(b - a)[::-1]), 0.06))
    with Renderer(mesh, ground, size=(CAMERA.width, CAMERA.height), samples=4) as renderer:
        views = [view_towards(eye, turn, up, focal=CAMERA.focal, window=CAMERA.window) for eye, turn, up in poses]
        row = Image.fromarray(np.hstack([renderer.draw(plan, view).color for view in views]))
    text = f"{preset}: {len(city.objects):,} objects, {len(mesh.triangles):,} triangles"
    ImageDraw.Draw(row).text((8, 6), text, fill=(20, 20, 20), font_size=16)
    return np.asarray(row)


def _point(middle: NDArray[np.float64]) -> Point:
    return Point(middle[:2])


def main() -> None:
    out, *presets = sys.argv[1:]
    rows = []
    for preset in presets or [name for name in PRESETS if name != "traffic"]:
        print(preset, flush=True)
        rows.append(pictures(preset))
    Image.fromarray(np.vstack(rows)).save(out, quality=85)


if __name__ == "__main__":
    main()
