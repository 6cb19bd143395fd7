"""Figures 10 and 17 of Aliaga & Lastra 1999 for another model: what placed images look like from as far as they are shown.

    python benchmarks/placed_pictures.py pipes -o out/placing --percent 15
    python benchmarks/placed_pictures.py plant.glb -o out/placing --percent 25 --candidates 20

Of some points of the grid, each with the image of one of its directions, the one is shown whose single picture leaves most
holes, from the viewer farthest from the point whom the image serves. figure10-MODEL.png: near geometry and an image of one
picture, of 512 x 384 pixels, beside one of nine. figure17-MODEL.png: the same viewer with an image of 1280 x 960 pixels, beside
geometry alone, both drawn with 2 x 2 samples a pixel. Holes are pixels in which geometry shows an object and the picture none.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from placing import city_of, heights
from placing_figures import AIM, short

from mmi.dataset.city_files import city_meshes
from mmi.foundation.camera import Camera, View, view_towards
from viewer.computed import WarpedPicture
from viewer.drawing.drawn_picture import DrawnPicture
from viewer.drawing.renderer import Renderer
from viewer.layered.layered_image import LayeredImage
from viewer.layered.warping import warped
from viewer.making.image_capture import ImageCapture
from viewer.making.models import Model
from viewer.measuring.view_errors import flip_map, wrong_regions
from viewer.placed.solutions import PlacedImage, Solutions
from viewer.placing.directions import TURN, seen_from
from viewer.placing.model_cells import ModelCells, cells_for
from viewer.placing.placements import placements_at
from viewer.placing.refining import solution_grid
from viewer.placing.rules import PlacingRules, fov_of
from viewer.placing.solution_grid import SolutionGrid, domain_of
from viewer.plan import Draw, Faces, Plan, Sky

CAMERA = Camera(512, 384, math.radians(60.0))
LARGE = Camera(1280, 960, math.radians(60.0))
EYES = 4000
"""Random viewers around a point, of whom the farthest that it serves is taken."""
TEXT = 15


class Shown(NamedTuple):
    """A viewer, the image that serves him, and how far from its point he is, metres."""

    eye: NDArray[np.float64]
    yaw: float
    image: PlacedImage
    away: float

    def view(self, camera: Camera) -> View:
        """What he sees."""
        return view_towards(self.eye, self.yaw, 0.0, focal=camera.focal, window=camera.window)


class Stage:
    """A model, drawn as geometry or with an image."""

    def __init__(
        self, model: Model, cells: ModelCells, grid: SolutionGrid, rules: PlacingRules, candidates: list[Shown]
    ) -> None:
        self._cells, self._rules, self.candidates = cells, rules, candidates
        images = tuple(one.image for one in candidates)
        self._solutions = Solutions(
            model.city.source, "", CAMERA, 9, rules, grid, (), images, np.zeros(1, dtype=np.int64)
        )
        self._capture = ImageCapture(model.mesh, model.ground, cells)
        self._renderer = Renderer(model.mesh, model.ground, size=(CAMERA.width, CAMERA.height), measured=True)

    def image(self, number: int, pictures: int, camera: Camera = CAMERA) -> LayeredImage:
        """The image that serves a candidate, of some pictures, for a display."""
        return self._capture.image(replace(self._solutions, pictures=pictures, camera=camera), number)

    def drawn(self, number: int, image: LayeredImage | None, camera: Camera = CAMERA) -> DrawnPicture:
        """What a candidate sees of the model, with an image or without."""
        shown = self.candidates[number]
        view = shown.view(camera)
        seen = seen_from(self._cells.boxes, shown.eye, shown.yaw, self._rules.pyramid)
        draws: list[Draw] = [Sky()]
        if image is not None:
            seen[shown.image.placement.cells] = False
            found = warped(image, view)
            draws.insert(0, WarpedPicture(found.color, found.depth, found.ids))
        key = "geometry" if image is None else "what is left"
        draws.insert(0, Faces(f"{key} {number}", self._cells.triangles_of(np.flatnonzero(seen))))
        self._renderer.resize(view.window[2:])
        return self._renderer.draw(Plan(tuple(draws)), view, measured=True)


def viewers(
    cells: ModelCells, grid: SolutionGrid, rules: PlacingRules, count: int, rng: np.random.Generator
) -> list[Shown]:
    """Viewers who are as far from their points as may be, each with his image."""
    found: list[Shown] = []
    needs = grid.needs()
    for number in rng.permutation(len(grid.points)):
        point = grid.points[number]
        one = placements_at(point, needs[number], cells, rules)
        if not one.images or len(found) == count:
            continue
        serving = rng.choice(np.flatnonzero(one.serving >= 0))
        end = one.borders[serving + 1] if serving + 1 < len(one.borders) else TURN
        image, yaw = one.images[one.serving[serving]], float(0.5 * (one.borders[serving] + end))
        away = grid.radii[number] * rng.random(EYES) ** 0.2
        across, up = rng.uniform(-1.0, 1.0, (2, EYES)) * np.array([[rules.fov.across], [rules.fov.up]])
        ways = np.stack([np.cos(yaw) + across * np.sin(yaw), np.sin(yaw) - across * np.cos(yaw), up], axis=1)
        eyes = point + (away / np.linalg.norm(ways, axis=1))[:, None] * ways
        served = [n for n in np.argsort(-away) if grid.closest(eyes[n], yaw) == number]
        if served:
            placed = PlacedImage(point, float(grid.radii[number]), image)
            found.append(Shown(eyes[served[0]], yaw, placed, float(away[served[0]])))
    return found


def holes(truth: DrawnPicture, shown: DrawnPicture) -> float:
    """The share of pixels."""
    return float(wrong_regions(truth, shown).holes.mean())


def side_by_side(pictures: list[tuple[str, NDArray[np.uint8]]], path: Path) -> None:
    """Two pictures, each over what it is."""
    height, width = pictures[0][1].shape[:2]
    image = Image.new("RGB", (2 * width + 6, height + TEXT + 9), (255, 255, 255))
    pen, font = ImageDraw.Draw(image), ImageFont.load_default(TEXT)
    for number, (told, picture) in enumerate(pictures):
        image.paste(Image.fromarray(picture), (number * (width + 6), 0))
        pen.text((number * (width + 6), height + (TEXT + 9) // 2), told, fill=(34, 34, 34), font=font, anchor="lm")
    image.save(path, optimize=True)


def halved(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A pixel for four."""
    height, width = picture.shape[:2]
    return picture.reshape(height // 2, 2, width // 2, 2, 3).mean(axis=(1, 3)).round().astype(np.uint8)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", metavar="MODEL", help="a preset of citygen (a detail after a colon), or a file")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--percent", type=float, default=15.0, help="budget, of the model (default: %(default)s)")
    parser.add_argument(
        "--heights", type=heights, metavar="LOW,HIGH", help="of viewers, metres (default: those of the model, and more)"
    )
    parser.add_argument("--candidates", type=int, default=12, help="images to choose from (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    city = city_of(options.model)
    model, name = Model(city, *city_meshes(city)), short(options.model)
    triangles = len(model.mesh.triangles)
    budget = round(0.01 * options.percent * triangles)
    rules = PlacingRules(budget, max(budget - round(AIM * triangles), budget // 2), fov_of(CAMERA))
    cells = cells_for(model.mesh.positions, model.mesh.triangles, rules)
    domain = domain_of(cells)
    if options.heights:
        domain[:, 2] = options.heights
    grid = solution_grid(cells, rules, domain)
    found = viewers(cells, grid, rules, options.candidates, np.random.default_rng(options.seed))
    stage = Stage(model, cells, grid, rules, found)
    lost = [holes(stage.drawn(n, None), stage.drawn(n, stage.image(n, 1))) for n in range(len(found))]
    print(f"holes with one picture: {', '.join(f'{one:.1%}' for one in sorted(lost))}")
    most = int(np.argmax(lost))
    truth = stage.drawn(most, None)
    pictures = []
    for count in (1, 9):
        drawn = stage.drawn(most, stage.image(most, count))
        flip = flip_map(truth.color, drawn.color).mean()
        told = f"{count} picture{'s' if count > 1 else ''}: {holes(truth, drawn):.2%} holes, FLIP {flip:.3f}"
        print(f"{told}; {drawn.triangles:,} of {truth.triangles:,} triangles, {found[most].away:.3g} m from the point")
        pictures.append((told, drawn.color))
    side_by_side(pictures, options.out / f"figure10-{name.split()[0]}.png")
    truth, drawn = stage.drawn(most, None, LARGE), stage.drawn(most, stage.image(most, 9, LARGE), LARGE)
    pictures = [
        (f"image and {drawn.triangles:,} triangles", halved(drawn.color)),
        (f"{truth.triangles:,} triangles", halved(truth.color)),
    ]
    flip = flip_map(pictures[1][1], pictures[0][1]).mean()
    print(f"of {LARGE.width} x {LARGE.height} samples: {holes(truth, drawn):.2%} holes, FLIP {flip:.3f}")
    side_by_side(pictures, options.out / f"figure17-{name.split()[0]}.png")


if __name__ == "__main__":
    main()
