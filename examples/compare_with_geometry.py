"""How wrong a dataset's impostors are, from Python: random views inside cells, next to the geometry that they replace.

python examples/compare_with_geometry.py out/helsinki out/comparison
"""

import sys
from pathlib import Path

from viewer import CompareOptions, compare_views


def main(dataset: Path, out: Path, *, views: int = 12) -> dict:
    options = CompareOptions(techniques=("visible", "local", "multi-mesh"), keep=3, flip=False)
    report = compare_views(dataset, out, views=views, seed=1, options=options)
    for name, one in report["techniques"].items():
        thickness = one["wrong_thickness_px"]
        print(
            f"{name:10}  wrong {100 * one['wrong_share']:.3f} %, at most {thickness['max']:.0f} px thick, "
            f"{one['triangles']:.0f} triangles, {report['ratios'][name]['visible']:.2f} times the frame rate of visible"
        )
    promise = report["source"]["max_error_px"] + 2.0
    for view in report["worst"]:
        if view["technique"] == "multi-mesh" and view["wrong_thickness_px"] > promise:
            print(f"thicker than promised: {out / view['picture']}")
    print(f"all of it: {out / 'report.html'}")
    return report


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
