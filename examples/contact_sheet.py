"""A contact sheet of generated cities: each preset from above and along two of its streets.

python examples/contact_sheet.py sheet.jpg hamlet montmartre
"""

import math
import sys

import numpy as np
from PIL import Image, ImageDraw
from shapely.geometry import Point

from citygen.generate import generate
from citygen.presets import PRESETS
from mmi import Camera
from mmi.appearance.city_mesh import build_city_mesh
from mmi.appearance.ground_mesh import ground_mesh
from mmi.foundation.camera import view_towards
from viewer import Ground, Objects, Plan, Renderer, Sky

CAMERA = Camera(480, 320, math.radians(65.0))


def row(preset: str) -> Image.Image:
    city = generate(preset, seed=0)
    mesh, ground = build_city_mesh(city), ground_mesh(city, margin=300.0)
    tiles = Ground(tuple(range(len(ground.triangle_counts))))
    plan = Plan((Objects("all", np.arange(len(city.objects))), tiles, Sky()))
    low, high = mesh.positions.min(axis=0).astype(float), mesh.positions.max(axis=0).astype(float)
    middle, extent = 0.5 * (low + high), float(np.linalg.norm((high - low)[:2]))
    poses = [(middle + extent * np.array([-0.42, -0.5, 0.42]), math.atan2(0.5, 0.42), -0.52)]
    lines = [edge["geometry"] for _, _, edge in city.streets.edges(data=True)]
    lines.sort(key=lambda line: line.distance(Point(middle[:2])) - 0.3 * min(line.length, 80.0))
    for line in lines[:2]:
        ends = [np.array(line.interpolate(t, normalized=True).coords[0]) for t in (0.15, 0.9)]
        a, b = sorted(ends, key=lambda end: -np.linalg.norm(end - middle[:2]))  # towards the middle
        poses.append((np.append(a, float(city.ground_at(a)) + 1.7), math.atan2(*(b - a)[::-1]), 0.06))
    with Renderer(mesh, ground, size=(CAMERA.width, CAMERA.height), samples=4) as renderer:
        views = [view_towards(eye, turn, up, focal=CAMERA.focal, window=CAMERA.window) for eye, turn, up in poses]
        picture = Image.fromarray(np.hstack([renderer.draw(plan, view).color for view in views]))
    text = f"{preset}: {len(city.objects):,} objects, {len(mesh.triangles):,} triangles"
    ImageDraw.Draw(picture).text((8, 6), text, fill=(20, 20, 20), font_size=16)
    return picture


def main() -> None:
    out, *presets = sys.argv[1:]
    rows = [row(preset) for preset in presets or [name for name in PRESETS if name != "traffic"]]
    Image.fromarray(np.vstack(rows)).save(out, quality=85)


if __name__ == "__main__":
    main()
