"""A city of your own, made from shapely polygons without any file, and the plan of its first viewing cell."""

import networkx as nx
from shapely import LineString, box

from mmi import BuildParameters, CellPlan, City, CityObject, Prism, plan_cell, prepare_city, viewing_cells


def main() -> CellPlan:
    houses = [
        CityObject(f"house {column}{row}", (Prism(box(x, y, x + 24.0, y + 16.0), 0.0, 9.0 + 3.0 * row),))
        for column, x in zip("ABC", (-40.0, -12.0, 16.0), strict=True)
        for row, y in enumerate((12.0, 70.0, 100.0, 160.0), start=1)
    ]
    streets = nx.MultiGraph()
    streets.add_nodes_from([(0, {"x": -40.0, "y": 0.0}), (1, {"x": 40.0, "y": 0.0})])
    line = LineString([(-40.0, 0.0), (40.0, 0.0)])
    streets.add_edge(0, 1, index=0, name="High Street", kind="street", half_width=4.0, geometry=line)
    city = City(tuple(houses), streets, crs="EPSG:32632", origin=(0.0, 0.0, 0.0), source="own buildings")

    cells = viewing_cells(city)
    cell = cells.nodes[min(cells)]["cell"]
    plan = plan_cell(prepare_city(city, BuildParameters(max_error_px=5.0)), cell)
    names = [house.id for house in city.objects]
    print(f"cell {cell.id} of {len(cells)}, {cell.length:.0f} m of {cell.street}")
    print("near: ", ", ".join(names[i] for i in plan.selection.near))
    for index, layer in enumerate(plan.layers):
        print(f"layer {index}:", ", ".join(names[i] for i in layer))
    print("hidden:", ", ".join(sorted(set(names) - {names[i] for i in plan.selection.objects})))
    return plan


if __name__ == "__main__":
    main()
