import numpy as np
import pytest

from mmi.foundation.camera import view_towards
from mmi.rays.hits import Hits, no_hits
from viewer.casting.open_pixels import rays_of
from viewer.casting.panorama import SAMPLE, Panorama, store, texel_of
from viewer.casting.surfaces import LEVEL_BIAS, cast_pixels, shown_again, surfaces_of

WINDOW = (-100, -80, 200, 160)
FOCAL = 170.0


def hits_of(mesh, rng, count):
    """Random points of random triangles: (triangles, weights, points)."""
    triangles = rng.integers(0, len(mesh.triangles), count).astype(np.int32)
    corners = mesh.positions[mesh.triangles[triangles]].astype(np.float64)
    weights = rng.dirichlet(np.ones(3), count)
    return triangles, weights[:, 1:].astype(np.float32), (weights[:, :, None] * corners).sum(axis=1)


def uv_at(mesh, triangle, origin, direction):
    """Where a ray meets the plane of a triangle, in texture coordinates."""
    a, b, c = mesh.positions[mesh.triangles[triangle]].astype(np.float64)
    normal = np.cross(b - a, c - a)
    point = origin + direction * (normal @ (a - origin)) / (normal @ direction)
    w, *_ = np.linalg.lstsq(np.stack([b - a, c - a], axis=1), point - a, rcond=None)
    ua, ub, uc = mesh.uv[mesh.triangles[triangle]].astype(np.float64)
    return ua + w[0] * (ub - ua) + w[1] * (uc - ua)


def along(points, eye, triangles, weights):
    """Unit directions to points from where they are seen, and hits that say so."""
    ways = points - eye
    away = np.linalg.norm(ways, axis=1)
    return ways / away[:, None], Hits(triangles, away.astype(np.float32), weights)


def test_a_ray_that_hits_nothing_has_no_object_and_its_direction(scene):
    view = view_towards(np.array([0.0, 0.0, 1.7]), 0.4, 0.1, focal=FOCAL, window=WINDOW)
    pixels = np.array([7, 8], dtype=np.int32)
    directions = np.array([[1.0, 0.0, 0.0], [0.6, 0.8, 0.0]])
    samples, points = cast_pixels(pixels, 200, 0, directions, no_hits(2), rays_of(view), surfaces_of(scene.mesh))
    assert samples["object"].tolist() == [-1, -1]
    assert points == pytest.approx(directions, abs=1e-7)


def test_pixels_have_the_coordinates_tint_and_level_of_their_surface(scene):
    mesh, rng = scene.mesh, np.random.default_rng(5)
    view = view_towards(np.array([0.0, 0.0, 1.7]), 0.4, 0.1, focal=FOCAL, window=WINDOW)
    triangles, weights, points = hits_of(mesh, rng, 400)
    seen = view.project(points)
    kept = seen[:, 2] > 1.0
    triangles, weights, points, seen = triangles[kept], weights[kept], points[kept], seen[kept]
    assert len(points) > 100
    rays = rays_of(view)
    pixels = np.arange(len(points), dtype=np.int32)
    samples, shown = cast_pixels(pixels, 200, 0, *along(points, view.eye, triangles, weights), rays, surfaces_of(mesh))
    assert shown == pytest.approx(points, abs=1e-4)
    assert (samples["tint"][:, 3] == 255).all()
    full = np.column_stack([1.0 - weights.sum(axis=1), weights])
    corners = mesh.triangles[triangles]
    assert samples["uv"] == pytest.approx((full[:, :, None] * mesh.uv[corners]).sum(axis=1), abs=1e-5)
    assert samples["tint"][:, :3] == pytest.approx((full[:, :, None] * mesh.colors[corners]).sum(axis=1), abs=0.51)
    assert samples["depth"] == pytest.approx(seen[:, 2], rel=1e-5)
    owners = np.repeat(np.arange(len(mesh.triangle_counts)), mesh.triangle_counts)
    assert samples["object"].tolist() == owners[triangles].tolist()
    assert samples["pixel"].tolist() == [[k % 200, k // 200] for k in range(len(points))]
    height, width = mesh.texture.shape[:2]
    compared = 0
    for k, (triangle, (u, v, _)) in enumerate(zip(triangles, seen, strict=True)):
        a, b, c = mesh.positions[mesh.triangles[triangle]].astype(np.float64)
        normal, ray = np.cross(b - a, c - a), points[k] - view.eye
        if abs(normal @ ray) < 0.02 * np.linalg.norm(normal) * np.linalg.norm(ray):
            continue  # too grazing for differences
        rays_to = [
            view.unproject(np.float64(u + du), np.float64(v + dv), np.float64(1.0)) - view.eye
            for du, dv in ((-0.01, 0.0), (0.01, 0.0), (0.0, -0.01), (0.0, 0.01))
        ]
        found = [uv_at(mesh, triangle, view.eye, one) * (width, height) for one in rays_to]
        longest = max(np.linalg.norm(found[1] - found[0]), np.linalg.norm(found[3] - found[2])) / 0.02
        assert samples["level"][k] == pytest.approx(np.log2(longest) + LEVEL_BIAS, abs=2e-3)
        compared += 1
    assert compared > 80


def test_what_is_shown_again_is_what_was_cast(scene):
    """From the same place, turned aside: coordinates, tint, object and depth of the point, and about the level of a new ray."""
    mesh, rng = scene.mesh, np.random.default_rng(6)
    eye = np.array([0.0, 0.0, 1.7])
    view, turned = (view_towards(eye, azimuth, 0.1, focal=FOCAL, window=WINDOW) for azimuth in (0.4, 0.7))
    triangles, weights, points = hits_of(mesh, rng, 600)
    kept = (view.project(points)[:, 2] > 1.0) & (turned.project(points)[:, 2] > 1.0)
    inside = [np.abs(one.project(points)[:, :2] / (100.0, 80.0)).max(axis=1) < 1.0 for one in (view, turned)]
    kept &= inside[0] & inside[1]
    triangles, weights, points = triangles[kept], weights[kept], points[kept].astype(np.float32)
    assert len(points) > 30
    surfaces, panorama = surfaces_of(mesh), Panorama(1e-3)
    pixels = np.arange(len(points), dtype=np.int32)
    directions, hits = along(points, eye, triangles, weights)
    cast, points = cast_pixels(pixels, 200, 0, directions, hits, rays_of(view), surfaces)
    ahead = -view.eye_from_world[2, :3]
    store(panorama.record_at(eye), directions, ahead, points, cast.view(SAMPLE), panorama.texels)
    texels = panorama.texels
    at = [texel_of(*one, texels.columns, texels.rows, texels.step) for one in directions]
    places = np.array([row * texels.columns + column for column, row in at], dtype=np.int32)
    nobody = np.zeros(len(mesh.triangle_counts), dtype=np.bool_)
    again = shown_again(pixels, 200, 0, places, nobody, rays_of(turned), texels)
    assert not len(shown_again(pixels, 200, 0, places, ~nobody, rays_of(turned), texels)), (
        "they are drawn where they are"
    )
    new, _ = cast_pixels(pixels, 200, 0, directions, hits, rays_of(turned), surfaces)
    own = np.array([(places == place).sum() == 1 for place in places])  # some share a texel with another
    assert own.sum() > 30
    again, new = again[own], new[own]
    for name in ("pixel", "uv", "tint", "object"):
        assert np.array_equal(again[name], new[name]), name
    assert again["depth"] == pytest.approx(new["depth"], rel=1e-5)
    assert np.abs(again["level"] - new["level"]).max() < 0.4
