import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rasters import bilinear, draw
from scipy.ndimage import binary_dilation, binary_fill_holes, maximum_filter, minimum_filter

from mmi.capture.covered_pieces import covered_windows
from mmi.capture.layer_values import DepthTexture, GridMesh
from mmi.cells.viewing_cells import ViewingCell
from mmi.foundation.camera import View, level_view
from mmi.meshing.displacement import displacement
from mmi.meshing.grid_mesh import grid_mesh
from mmi.parallax.from_anywhere import viewers_of

PIXEL = math.radians(60.0) / 512.0
LARGEST = 64


def texture_of(inverse, *, covered=None, focal=400.0, left=-64, top=-32, color=None):
    """A depth texture with these 1/z (h, w), seen from (3, -4, 1.7)."""
    height, width = inverse.shape
    covered = np.ones(inverse.shape, dtype=bool) if covered is None else covered
    view = level_view(np.array([3.0, -4.0, 1.7]), 0.4, focal=focal, window=(left, top, width, height))
    color = np.zeros((height, width, 3), dtype=np.uint8) if color is None else color
    depth = np.where(covered, 1.0 / inverse, np.inf).astype(np.float32)
    return DepthTexture(view, color, depth, np.where(covered, 5, -1).astype(np.int32))


def plane(height, width, a, b, c):
    """1/z = a + b x + c y at texel centres."""
    y, x = np.mgrid[:height, :width] + 0.5
    return a + b * x + c * y


def around(texture, *, length=40.0, half_width=3.0):
    """Corners of a cell with the capture in its middle, lying across the line of wall_visibility."""
    return texture.view.eye + np.array(
        [[x, y, 0.0] for x in (-0.5 * length, 0.5 * length) for y in (-half_width, half_width)]
    )


def viewers(texture, *, length=40.0, half_width=3.0, height=0.0):
    """All of the cell whose corners :func:`around` gives, or another one; eyes up to ``height`` metres above or below."""
    x, y, z = texture.view.eye
    cell = ViewingCell("", (x - 0.5 * length, y), (x + 0.5 * length, y), half_width, (z - height, z + height))
    return viewers_of(cell, texture.view)


def meshed(texture, *, pixels=5.0, widest=math.pi):
    """Off by ``pixels`` where it can; torn where a jump is wider than ``widest`` radians."""
    return grid_mesh(
        texture, viewpoints=around(texture), tolerance=pixels * PIXEL, viewers=viewers(texture), widest=widest
    )


def lattice(texture, mesh):
    """(n, 2): vertices in texels from the window's corner: whole ones and, in the middle of rectangles, halves."""
    return np.rint(mesh.uv * np.array(texture.view.window[2:]) * 2.0) / 2.0


def inverse_at(texture, mesh):
    """(n,) 1/z of vertices."""
    return 1.0 / texture.view.project(mesh.vertices.astype(float))[:, 2]


def drawn(texture, mesh):
    """Depth (h, w) and texture coordinates in texels (h, w, 2) that the mesh shows at texels, by another rasteriser."""
    left, top, width, height = texture.view.window
    projected = texture.view.project(mesh.vertices.astype(float))
    depth, uv = draw(projected, mesh.uv.astype(float), mesh.triangles, left, top, width, height)
    return depth, uv * [width, height]


def displaced(texture, mesh, viewpoints):
    """(h, w) radians: the oracle of ``displacement``, texel by texel; NaN where nothing was captured or drawn."""
    left, top, width, height = texture.view.window
    y, x = np.mgrid[:height, :width] + 0.5
    directions = np.stack([left + x, -(top + y), np.full(x.shape, -texture.view.focal)], axis=-1) / texture.view.focal
    directions = directions @ texture.view.world_from_eye[:3, :3].T
    depth = np.where(np.isfinite(texture.depth), texture.depth.astype(float), np.nan)
    shown, _ = drawn(texture, mesh)
    shown[np.isinf(shown)] = np.nan
    angles = []
    for viewpoint in viewpoints:
        one, other = (texture.view.eye + directions * z[..., None] - viewpoint for z in (depth, shown))
        sine = np.linalg.norm(np.cross(one, other), axis=-1)
        angles.append(np.arctan2(sine, np.sum(one * other, axis=-1)))
    return np.max(angles, axis=0)


def beside_jumps(inverse, *, reach=1):
    """(h, w): texels whose 1/z is not that of a neighbour's surface, and those up to ``reach`` - 1 beyond."""
    found = np.zeros(inverse.shape, dtype=bool)
    for axis in (0, 1):
        jumps = np.abs(np.diff(inverse, axis=axis)) > 0.02 * inverse.min()
        pad = [(0, 0), (0, 0)]
        for pad[axis] in ((0, 1), (1, 0)):
            found |= np.pad(jumps, pad)
    return binary_dilation(found, np.ones((3, 3)), iterations=reach - 1) if reach > 1 else found


def surfaces(kind, height=96, width=192):
    """1/z (h, w) of what streets look like, and of what is worse."""
    y, x = np.mgrid[:height, :width] + 0.5
    if kind == "corner":
        return np.where(x < 77.0, 0.008 + 4e-5 * x, 0.008 + 4e-5 * 77.0 - 9e-5 * (x - 77.0))
    if kind == "roof":
        return np.where(y < 30.3 + 0.1 * x, 0.006 + 3e-5 * x, 0.006 + 3e-5 * x + 1e-4 * (y - 30.3 - 0.1 * x))
    if kind == "jump":
        return np.where(x < 100.0, 0.004 + 1e-5 * x, 0.012 - 2e-5 * (x - 100.0))
    if kind == "house":
        return np.where((x > 80.0) & (x < 110.0) & (y > 40.0) & (y < 60.0), 0.02, 0.01)
    if kind == "steps":
        return np.select([y > 60.0 + 0.2 * (x % 50.0), y > 31.0], [0.03 + 2e-5 * x, 0.02 - 1e-5 * x], 0.012)
    return 0.01 + 0.003 * np.sin(x / 17.0) * np.cos(y / 23.0)  # waves


KINDS = ["corner", "roof", "jump", "house", "steps", "waves"]


# Planes


@settings(max_examples=40, deadline=None)
@given(st.floats(0.005, 0.02), st.floats(-1.2e-5, 1.2e-5), st.floats(-1.2e-5, 1.2e-5))
def test_a_plane_is_reproduced_exactly(a, b, c):
    """Unless it is so slanted that it changes by a hundredth a texel, which counts as jumps."""
    texture = texture_of(plane(64, 128, a, b, c))
    mesh = meshed(texture)
    x, y = lattice(texture, mesh).T
    np.testing.assert_allclose(inverse_at(texture, mesh), a + b * x + c * y, rtol=2e-5)
    assert np.nanmax(displaced(texture, mesh, around(texture))) < 0.01 * PIXEL


@settings(max_examples=40, deadline=None)
@given(
    st.floats(0.01, 0.02), st.floats(-1e-6, 1e-6), st.floats(-1e-6, 1e-6), st.integers(1, 150), st.integers(1, 150)
)  # fmt: skip
def test_a_plane_takes_two_triangles_a_block(a, b, c, width, height):
    mesh = meshed(texture_of(plane(height, width, a, b, c)))
    blocks = math.ceil(width / LARGEST) * math.ceil(height / LARGEST)
    assert len(mesh.triangles) == 2 * blocks
    assert mesh.uv.min() == 0.0 and mesh.uv.max() == 1.0


def test_silhouettes_do_not_pull_the_fit():
    """Texels of a wall that ends within a rectangle give the plane of the wall, not one bent towards nothing."""
    covered = np.zeros((64, 128), dtype=bool)
    covered[:, :76] = True
    texture = texture_of(plane(64, 128, 0.01, 4e-5, 0.0), covered=covered)
    mesh = meshed(texture)
    x, _ = lattice(texture, mesh).T
    np.testing.assert_allclose(inverse_at(texture, mesh), 0.01 + 4e-5 * x, rtol=1e-4)


# Corners and jumps


@pytest.mark.parametrize("kind", ["corner", "roof", "waves"])
@pytest.mark.parametrize("pixels", [0.5, 2.0, 8.0])
def test_the_tolerance_is_kept_where_depth_does_not_jump(kind, pixels):
    texture = texture_of(surfaces(kind), left=-96, top=-48)
    mesh = meshed(texture, pixels=pixels)
    assert np.nanmax(displaced(texture, mesh, around(texture))) <= 2.0 * pixels * PIXEL * 1.001


@pytest.mark.parametrize("kind", ["jump", "house", "steps"])
@pytest.mark.parametrize("pixels", [0.5, 2.0, 8.0])
def test_jumps_displace_the_texels_beside_them_and_no_others(kind, pixels):
    inverse = surfaces(kind)
    texture = texture_of(inverse, left=-96, top=-48)
    found = displaced(texture, meshed(texture, pixels=pixels), around(texture))
    beside = binary_dilation(beside_jumps(inverse), np.ones((3, 3)))  # at the jump's corners
    assert found[~beside].max() <= 2.0 * pixels * PIXEL * 1.001


def test_a_house_before_a_wall_displaces_no_texel_by_more_than_lies_between_them():
    inverse = surfaces("house")
    texture = texture_of(inverse, left=-96, top=-48)
    far = texture_of(np.full(inverse.shape, 0.01), left=-96, top=-48)
    between = displacement(far, _flat(texture, 50.0), viewers(texture))
    assert displacement(texture, meshed(texture), viewers(texture)) <= between * 1.001


def _flat(texture, depth):
    """Two triangles over the window, ``depth`` metres away."""
    left, top, width, height = texture.view.window
    corners = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0]])
    u, v = (corners * [width, height] + [left, top]).T
    vertices = texture.view.unproject(u, v, np.full(4, depth))
    triangles = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    return GridMesh(vertices.astype(np.float32), corners.astype(np.float32), triangles)


def test_a_corner_is_cut_at_the_corner():
    """Walls to either side of it stay large: a handful of rectangles, where a grid as fine as its finest has thousands."""
    bent = texture_of(surfaces("corner"), left=-96, top=-48)
    x, y = lattice(bent, meshed(bent, pixels=0.5)).T
    for row in (0.0, 96.0):
        assert np.abs(x[y == row] - 77.0).min() <= 1.0


def test_vertices_at_a_jump_lie_on_one_of_its_surfaces():
    """Not between them, where nothing is."""
    texture = texture_of(surfaces("jump"), left=-96, top=-48)
    mesh = meshed(texture)
    x, _ = lattice(texture, mesh).T
    off = [np.abs(inverse_at(texture, mesh) / one - 1.0) for one in (0.004 + 1e-5 * x, 0.012 - 2e-5 * (x - 100.0))]
    assert np.minimum(*off).max() < 1e-3
    np.testing.assert_array_equal(off[0] < off[1], x < 100.0)  # on the edge itself, the one in front


def test_a_larger_tolerance_gives_fewer_triangles():
    texture = texture_of(surfaces("waves"), left=-96, top=-48)
    counts = [len(meshed(texture, pixels=pixels).triangles) for pixels in (0.25, 1.0, 4.0, 16.0)]
    assert counts == sorted(counts, reverse=True) and counts[0] > 4 * counts[-1]


def test_what_matters_is_what_viewpoints_see():
    """From the capture itself nothing is displaced; the further off a viewpoint, the finer the mesh."""
    texture = texture_of(surfaces("waves"), left=-96, top=-48)
    eye = texture.view.eye
    offsets = ([0.0, 0.0, 0.0], [2.0, 1.0, 0.0], [20.0, 10.0, 0.0])
    one_piece = {"viewers": viewers(texture), "widest": math.pi}
    counts = [
        len(grid_mesh(texture, viewpoints=eye + np.array([one]), tolerance=PIXEL, **one_piece).triangles)
        for one in offsets
    ]
    assert counts == sorted(counts) and counts[0] < counts[2]


# The mesh as a whole


def random_texture(seed, *, farther=1.0):
    """Waves with jumps, covered in blobs."""
    rng = np.random.default_rng(seed)
    height, width = (int(one) for one in rng.integers(3, 150, 2))
    y, x = np.mgrid[:height, :width]
    inverse = 0.01 + 0.002 * np.sin(x / rng.uniform(8, 60)) * np.cos(y / rng.uniform(8, 60))
    covered = np.zeros((height, width), dtype=bool)
    covered[height // 2, width // 2] = True
    for _ in range(6):
        i, j = rng.integers(0, height), rng.integers(0, width)
        blob = np.s_[i : i + rng.integers(1, 60), j : j + rng.integers(1, 60)]
        covered[blob] = True
        if rng.random() < 0.5:
            inverse[blob] *= rng.uniform(1.1, 3.0)
    return texture_of(inverse / farther, covered=covered, left=-width // 2, top=-height // 2)


@pytest.mark.parametrize("seed", range(12))
def test_every_covered_texel_and_what_filtering_reaches_lies_in_one_triangle(seed):
    texture = random_texture(seed)
    mesh = meshed(texture)
    y, x = np.nonzero(binary_dilation(texture.coverage, np.ones((3, 3))))
    times = np.zeros(len(x), dtype=int)
    for a, b, c in lattice(texture, mesh)[mesh.triangles]:
        # Off the middle, where no edge of two rectangles' triangles passes.
        sides = [_side(p, q, x + 0.4871, y + 0.5123) for p, q in ((a, b), (b, c), (c, a))]
        times += (np.max(sides, axis=0) < 0.0) | (np.min(sides, axis=0) > 0.0)
    assert (times == 1).all()


def _side(p, q, x, y):
    return (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])


@pytest.mark.parametrize("seed", range(12))
def test_vertices_sit_on_the_rays_of_their_texture_coordinates(seed):
    texture = random_texture(seed)
    mesh = meshed(texture)
    left, top = texture.view.window[:2]
    u, v, depth = texture.view.project(mesh.vertices.astype(float)).T
    np.testing.assert_allclose(np.column_stack([u - left, v - top]), lattice(texture, mesh), atol=2e-3)
    assert (depth > 0.0).all() and np.isfinite(depth).all()
    assert mesh.uv.min() >= 0.0 and mesh.uv.max() <= 1.0
    assert np.array_equal(np.unique(mesh.triangles), np.arange(len(mesh.vertices)))  # none is left over


@pytest.mark.parametrize("seed", range(12))
def test_triangles_face_the_capture(seed):
    texture = random_texture(seed)
    mesh = meshed(texture)
    a, b, c = np.moveaxis(mesh.uv[mesh.triangles] * [1.0, -1.0], 1, 0)
    (x1, y1), (x2, y2) = (b - a).T, (c - a).T
    assert np.all(x1 * y2 - y1 * x2 > 0.0)


def _edges(mesh):
    """{(from, to): how many triangles have it}."""
    counts = {}
    for triangle in mesh.triangles.tolist():
        for edge in zip(triangle, triangle[1:] + triangle[:1], strict=True):
            counts[edge] = counts.get(edge, 0) + 1
    return counts


@pytest.mark.parametrize("seed", range(12))
def test_rectangles_that_touch_share_their_vertices(seed):
    """No vertex lies within a side of another's triangle: a crack opens where one does, seen from elsewhere."""
    texture = random_texture(seed)
    mesh = meshed(texture)
    points = (lattice(texture, mesh) * 2.0).astype(int)  # centres lie at halves
    edges = _edges(mesh)
    assert set(edges.values()) == {1}
    for a, b in (edge for edge in edges if edge[::-1] not in edges):
        step = points[b] - points[a]
        off = points - points[a]
        along = off @ step
        on = (off[:, 0] * step[1] == off[:, 1] * step[0]) & (0 < along) & (along < step @ step)
        assert not on.any()


@pytest.mark.parametrize("kind", KINDS)
def test_no_cracks_seen_from_aside(kind):
    """Every pixel inside the mesh's outline is covered, however differently large its rectangles are."""
    texture = texture_of(surfaces(kind), left=-96, top=-48)
    mesh = meshed(texture, pixels=1.0)
    _, top_of, sizes = np.unique(lattice(texture, mesh)[:, 1], return_index=True, return_counts=True)
    assert len(top_of) >= 3 and sizes.min() < sizes.max()
    aside = level_view(texture.view.eye + np.array([1.5, 1.0, 0.5]), 0.35, focal=400.0, window=(-300, -200, 600, 400))
    projected = aside.project(mesh.vertices.astype(float))
    depth, _ = draw(projected, mesh.uv.astype(float), mesh.triangles, -300, -200, 600, 400)
    hit = np.isfinite(depth)
    assert hit.sum() > 10_000
    assert (binary_fill_holes(hit) == hit).all()


def test_rectangles_shrink_to_what_they_hold():
    covered = np.zeros((64, 128), dtype=bool)
    covered[20:30, 40:60] = True
    texture = texture_of(plane(64, 128, 0.01, 0.0, 0.0), covered=covered)
    mesh = meshed(texture)
    assert len(mesh.triangles) == 2
    corners = {tuple(one) for one in lattice(texture, mesh).tolist()}  # filtering reaches a texel beyond
    assert corners == {(39.0, 19.0), (61.0, 19.0), (39.0, 31.0), (61.0, 31.0)}
    covered[60:, 100:] = True  # another block, at the window's corner
    both = meshed(texture_of(plane(64, 128, 0.01, 0.0, 0.0), covered=covered))
    assert len(both.triangles) == 2 * 2


def test_an_empty_texture_is_refused():
    with pytest.raises(ValueError, match="found an empty one"):
        meshed(texture_of(plane(64, 128, 0.01, 0.0, 0.0), covered=np.zeros((64, 128), dtype=bool)))


# Texture coordinates as a graphics card interpolates them


@pytest.mark.parametrize(
    ("b", "c"), [(0.0, 0.0), (2e-5, 0.0), (9e-5, 0.0), (0.0, -4e-5), (5e-5, 4e-5), (-1.43e-5, 1.09e-4)]
)
def test_interpolated_texture_coordinates_are_within_a_texel_on_planes(b, c):
    texture = texture_of(plane(64, 256, 0.004, b, c), left=-128)
    _, found = drawn(texture, meshed(texture))
    y, x = np.mgrid[:64, :256] + 0.5
    assert not np.isnan(found).any()
    assert np.hypot(found[..., 0] - x, found[..., 1] - y).max() <= 1.0


@pytest.mark.parametrize("kind", KINDS)
def test_interpolated_texture_coordinates_are_about_a_texel_off_at_most(kind):
    texture = texture_of(surfaces(kind), left=-96, top=-48)
    _, found = drawn(texture, meshed(texture))
    y, x = np.mgrid[:96, :192] + 0.5
    assert np.hypot(found[..., 0] - x, found[..., 1] - y).max() <= 2.0  # one, and what neighbours on its sides add


@pytest.mark.parametrize("kind", [one for one in KINDS if one != "corner"])
def test_seen_from_the_capture_the_mesh_shows_the_captured_picture(kind):
    """Every pixel lies between the colours of the texels around it, as what is shifted by less than a texel does."""
    y, x = np.mgrid[:96, :192]
    color = (np.stack([x // 6 % 2, y // 5 % 2, (x + y) // 9 % 2], axis=-1) * 160 + 40).astype(np.uint8)
    texture = texture_of(surfaces(kind), left=-96, top=-48, color=color)
    _, found = drawn(texture, meshed(texture))
    shown = bilinear(color, found / [192, 96])
    assert (minimum_filter(color, size=(3, 3, 1)) - 1e-6 <= shown).all()
    assert (shown <= maximum_filter(color, size=(3, 3, 1)) + 1e-6).all()


# Displacement


def seen_displaced(texture, mesh, standing, *, fine=4):
    """Radians: the largest displacement from these viewpoints, at places within texels, all of which show what centres do."""
    left, top, width, height = texture.view.window
    window = (fine * left, fine * top, fine * width, fine * height)
    view = View(texture.view.eye_from_world, fine * texture.view.focal, window)
    depth, ids, color = (
        np.repeat(np.repeat(one, fine, axis=0), fine, axis=1)
        for one in (texture.depth, texture.object_ids, texture.color)
    )
    return np.nanmax(displaced(DepthTexture(view, color, depth, ids), mesh, standing))


@pytest.mark.parametrize("seed", range(12))
def test_displacement_is_exceeded_by_nobody_and_not_far_above_what_is_seen(seed):
    texture = random_texture(seed, farther=20.0)
    mesh = meshed(texture, pixels=8.0)
    rng = np.random.default_rng(100 + seed)
    eye = texture.view.eye
    shares = np.vstack([list(itertools.product([-1.0, 1.0], repeat=3)), rng.uniform(-1.0, 1.0, (24, 3))])
    standing = eye + shares * [15.0, 6.0, 0.3]
    # Vertices moved along their rays, so that each triangle is off.
    factors = rng.uniform(0.8, 1.25, (len(mesh.vertices), 1))
    for vertices in (mesh.vertices, eye + factors * (mesh.vertices - eye)):
        moved = GridMesh(vertices.astype(np.float32), mesh.uv, mesh.triangles)
        seen = seen_displaced(texture, moved, standing)
        found = displacement(texture, moved, viewers(texture, length=30.0, half_width=6.0, height=0.3))
        assert seen * (1.0 - 1e-4) <= found <= 1.3 * seen + 1e-5


def test_what_is_drawn_where_it_was_captured_is_not_displaced():
    texture = texture_of(plane(64, 128, 0.01, 0.0, 0.0))
    assert displacement(texture, _flat(texture, 100.0), viewers(texture)) == pytest.approx(0.0, abs=1e-5)
    assert displacement(texture, _flat(texture, 100.0), viewers(texture), least=0.01) == pytest.approx(0.01)


def test_a_texel_is_displaced_by_the_whole_jump_beside_it():
    """Half of it is what its centre is, which is on no side: on the screen all of the texel is seen."""
    inverse = np.where(np.arange(32) < 16, 0.02, 0.01) * np.ones((24, 1))
    texture = texture_of(inverse, left=-16, top=-12)
    mesh = meshed(texture)
    jump = displacement(texture_of(np.full((24, 32), 0.01), left=-16, top=-12), _flat(texture, 50.0), viewers(texture))
    assert np.nanmax(displaced(texture, mesh, around(texture))) < 0.7 * jump
    assert displacement(texture, mesh, viewers(texture)) == pytest.approx(jump, rel=0.1)


# Tears


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("pixels", [2.0, 5.0, 30.0])
def test_no_viewer_sees_more_than_the_widest_jump_that_is_joined(kind, pixels):
    """Nothing is torn that does not jump: corners, roofs and waves are the same meshes as before."""
    texture = texture_of(surfaces(kind), left=-96, top=-48)
    whole, torn = (meshed(texture, pixels=0.5 * pixels, widest=one) for one in (math.pi, pixels * PIXEL))
    found = displacement(texture, torn, viewers(texture))
    if kind in ("corner", "roof", "waves"):
        np.testing.assert_array_equal(torn.vertices, whole.vertices)
        np.testing.assert_array_equal(torn.triangles, whole.triangles)
        assert found <= 2.0 * pixels * PIXEL
    else:
        assert found <= pixels * PIXEL
        assert displacement(texture, whole, viewers(texture)) > found


@pytest.mark.parametrize("seed", range(12))
def test_a_torn_mesh_fills_the_picture_once_and_keeps_the_limit(seed):
    texture = random_texture(seed, farther=10.0)
    mesh = meshed(texture, pixels=1.0, widest=2.0 * PIXEL)
    assert displacement(texture, mesh, viewers(texture)) <= 2.0 * PIXEL
    depth, _ = drawn(texture, mesh)
    reached = binary_dilation(texture.coverage, np.ones((3, 3)))
    assert np.isfinite(depth[reached]).all()
    assert set(_edges(mesh).values()) == {1}
    assert np.array_equal(np.unique(mesh.triangles), np.arange(len(mesh.vertices)))


def test_a_tear_parts_two_surfaces_and_neither_within_itself():
    """Seen from aside, the house and what shows of the wall are whole: nothing else lies between them."""
    texture = texture_of(surfaces("house"), left=-96, top=-48)
    mesh = meshed(texture, pixels=1.0, widest=2.0 * PIXEL)
    depth = 1.0 / inverse_at(texture, mesh)
    near = depth < 75.0
    assert np.allclose(depth[near], 50.0, rtol=1e-4) and np.allclose(depth[~near], 100.0, rtol=1e-4)
    sides = near[mesh.triangles]
    assert (sides.all(axis=1) | ~sides.any(axis=1)).all()
    x, y = lattice(texture, mesh).T
    for one in (near, ~near):  # both have vertices at the corners of the house
        assert {(80.0, 40.0), (110.0, 60.0)} <= set(zip(x[one].tolist(), y[one].tolist(), strict=True))


def test_a_surface_that_the_capture_looks_along_is_not_torn():
    """A roof at a grazing angle changes by more than the limit from row to row, and is right between them."""
    y = np.mgrid[:40, :60][0] + 0.5
    inverse = np.where(y > 30.0, 0.03, 0.03 - 5e-4 * (30.0 - y))
    texture = texture_of(inverse, left=-30, top=-40)
    mesh = meshed(texture, pixels=1.0, widest=0.5 * PIXEL)
    assert len(np.unique(lattice(texture, mesh), axis=0)) == len(mesh.vertices)
    torn = grid_mesh(
        texture,
        viewpoints=around(texture),
        tolerance=PIXEL,
        viewers=viewers(texture),
        widest=0.5 * PIXEL,
        all_jumps=True,
    )
    assert len(np.unique(lattice(texture, torn), axis=0)) < len(torn.vertices)
    steps = texture_of(np.floor(30.0 * inverse / 0.03) * 1e-3, left=-30, top=-40)  # a stair is
    torn = meshed(steps, pixels=1.0, widest=0.5 * PIXEL)
    assert len(np.unique(lattice(steps, torn), axis=0)) < len(torn.vertices)


# Windows


def test_covered_windows_are_whole_quads_around_what_is_covered():
    covered = np.zeros((64, 512), dtype=bool)

    def windows():
        return covered_windows(texture_of(plane(64, 512, 0.01, 0, 0), covered=covered), quad=16)

    assert windows() == []
    covered[20:30, 40:60] = True
    assert windows() == [(-32, -16, 32, 16)]
    covered[2:60, 100:110] = True  # near enough to be in one picture with it
    assert windows() == [(-32, -32, 80, 64)]
    covered[40:50, 450:460] = True  # too far
    assert windows() == [(-32, -32, 80, 64), (384, 0, 16, 32)]
