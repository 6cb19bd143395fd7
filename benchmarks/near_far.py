"""What the bound costs: tight weights, near and far by distance, and the paper's weights, in objects, triangles and layers.

    python benchmarks/near_far.py examples/helsinki/helsinki.osm.pbf --cells 40 --max-error 5

For each cell, at the same bound on what a picture may miss of its own objects: *tight* keeps as geometry the objects that miss
more (and what is near or steep anyhow); *distance* everything that is no farther than the farthest of those; *paper* has the
paper's pair weights on top of that. The last row is the paper's weights with everything nearer than 60 m as geometry, which
keeps no such bound: its column says what its objects miss of themselves at most.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import shapely

from mmi.build import prepare_scene
from mmi.cells import spread, viewing_cells
from mmi.critical_zone import cell_region
from mmi.io import read_city
from mmi.layering import assign_layers, event_graph, panorama_boxes
from mmi.parallax import critical_zone_weights
from mmi.parameters import BuildParameters
from mmi.ray_parallax import same_ray_weights, self_parallax
from mmi.selection import everything


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cities", type=Path, nargs="+", metavar="CITY")
    parser.add_argument("--cells", type=int, default=40)
    parser.add_argument("--max-error", type=float, default=5.0)
    options = parser.parse_args()
    for path in options.cities:
        city, _ = read_city(path)
        parameters = BuildParameters(max_error_px=options.max_error)
        scene, graph, camera = prepare_scene(city, parameters), viewing_cells(city), parameters.camera
        rows: dict[str, list[tuple[float, ...]]] = {name: [] for name in ("tight", "distance", "paper", "paper, 60 m")}
        for name in spread(graph, options.cells):
            cell = graph.nodes[name]["cell"]
            assert scene.visible is not None
            seen = scene.visible(everything(city, cell))
            missed = self_parallax(city, cell, scene.walls, seen.objects, seen.sight, texel=1.0 / camera.focal)
            away = shapely.distance([city.objects[i].footprint for i in seen.objects], cell_region(cell))
            near = np.isin(seen.objects, scene.near(seen).near)
            reach = max(parameters.near_distance, float(away[missed > parameters.max_angle].max(initial=0.0)))
            for what, chosen in (
                ("tight", near),
                ("distance", near | (away <= reach)),
                ("paper", near | (away <= reach)),
                ("paper, 60 m", away <= 60.0),
            ):
                far = seen.objects[~chosen]
                objects = [city.objects[i] for i in far]
                if what in ("tight", "distance"):
                    pairs, weights = same_ray_weights(cell, scene.walls, far, seen.sight, quad=8.0 / camera.focal)
                else:
                    pairs, weights = critical_zone_weights(cell, objects)
                boxes = panorama_boxes(
                    cell.reference,
                    [one.footprint for one in objects],
                    [one.base for one in objects],
                    [one.top for one in objects],
                )
                layers = assign_layers(
                    event_graph(far, pairs, weights, threshold=parameters.max_angle), boxes, strategy="smallest-last"
                )
                triangles = scene.mesh.triangle_counts[seen.objects[chosen]].sum()
                worst = camera.pixels_from_angle(min(float(missed[~chosen].max(initial=0.0)), 1.5))
                rows[what].append((chosen.sum(), triangles, len(layers), worst))
        print(f"{path.name}, {options.max_error:g} px, {options.cells} cells")
        print("| near and far, weights | near objects | near triangles | to tight | layers | misses at most, px |")
        print("|---|---|---|---|---|---|")
        for what, values in rows.items():
            objects_near, triangles, layers, worst = np.array(values).T
            tight = np.array(rows["tight"])[:, 1].mean()
            print(
                f"| {what} | {objects_near.mean():.1f} | {triangles.mean():.0f} | {triangles.mean() / tight:.2f} | "
                f"{layers.mean():.1f} | {worst.max():.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
