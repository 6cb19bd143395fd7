"""What a dataset holds for one of its cells: layers, their textures and meshes.

Run ``python examples/look_at_layers.py out/helsinki layer.png``.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from mmi import open_dataset, read_impostor, typical_cell


def main(folder: Path, picture: Path) -> None:
    dataset = open_dataset(folder)
    city = dataset.city()
    impostor = read_impostor(dataset, typical_cell(dataset), city)
    print(f"cell {impostor.cell.id}: {len(impostor.near)} objects stay geometry, {len(impostor.far)} are in layers")

    for layer in impostor.layers:
        depth = layer.texture.depth[layer.texture.coverage]  # metres along the view axis
        names = ", ".join(city.objects[i].id for i in layer.objects[:3]) + (", ..." if len(layer.objects) > 3 else "")
        print(
            f"{layer.name} (sector {layer.sector}): {depth.min():4.0f} to {depth.max():4.0f} m, "
            f"{len(layer.mesh.triangles)} triangles, objects in sight {len(layer.objects)}: {names}"
        )

    richest = max(impostor.layers, key=lambda layer: len(layer.objects))
    alpha = np.uint8(255) * richest.texture.coverage  # where the layer shows something
    Image.fromarray(np.dstack([richest.texture.color, alpha])).save(picture)
    print(f"{picture}: sector {richest.sector}, layer {richest.index}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
