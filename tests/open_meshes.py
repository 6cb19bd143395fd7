"""Closed meshes opened in the ways that models of cities are: what is left of them is drawn, and nothing more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import shapely

from mmi.city.model import TriangleMesh

KINDS = ("floors", "party", "corners", "facing", "wall")
"""Without floors; without walls on a neighbour's footprint; without shared corners; faces turned; a hole in every tenth."""


def opened_up(city, kinds, *, seed=0):
    """``city`` with all of its meshes opened in the ways of ``kinds``."""
    rng = np.random.default_rng(seed)
    footprints = [one.footprint for one in city.objects]
    tree = shapely.STRtree(footprints)
    objects = []
    for i, one in enumerate(city.objects):
        mesh = one.mesh
        if "floors" in kinds:
            mesh = kept(mesh, ~_is_floor(mesh))
        if "party" in kinds:
            mesh = kept(mesh, ~_is_party(mesh, i, footprints, tree))
        if "wall" in kinds and i % 10 == 0:
            upright = np.flatnonzero(np.abs(normals(mesh)[:, 2]) < 1e-3)
            mesh = kept(mesh, np.arange(len(mesh.triangles)) != rng.choice(upright))
        if "corners" in kinds:
            mesh = divided(mesh, rng.random(len(mesh.triangles)) < 0.5)
        if "facing" in kinds:
            mesh = turned(mesh, rng.random(len(mesh.triangles)) < 0.5)
        objects.append(replace(one, mesh=mesh, core=()))
    return replace(city, objects=tuple(objects))


def normals(mesh):
    """(m, 3) of length 1."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    across = np.cross(b - a, c - a)
    return across / np.maximum(np.linalg.norm(across, axis=1), 1e-12)[:, None]


def kept(mesh, rows):
    """The triangles of ``rows`` (m,), a mask; all where none would be left."""
    return mesh.picked(np.flatnonzero(rows)) if rows.any() else mesh


def turned(mesh, rows):
    """With the triangles of ``rows`` (m,), a mask, the other way round."""
    triangles, uv = mesh.triangles.copy(), mesh.uv.copy()
    triangles[rows], uv[rows] = triangles[rows, ::-1], uv[rows, ::-1]
    return TriangleMesh(mesh.vertices, triangles, mesh.textures, mesh.colors, uv)


def divided(mesh, rows):
    """With the triangles of ``rows`` (m,), a mask, in two: a corner of each half is in the middle of its longest side."""
    rows = np.flatnonzero(rows)
    corners = mesh.vertices[mesh.triangles[rows]]
    longest = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).argmax(axis=1)
    turn = (longest[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(mesh.triangles[rows], turn, axis=1).T
    u, v, w = np.moveaxis(np.take_along_axis(mesh.uv[rows], turn[..., None], axis=1), 1, 0)
    middle = len(mesh.vertices) + np.arange(len(rows), dtype=np.int32)
    between = np.round(0.5 * (mesh.vertices[a] + mesh.vertices[b]), 3)
    triangles, uv = mesh.triangles.copy(), mesh.uv.copy()
    triangles[rows], uv[rows] = np.stack([a, middle, c], axis=1), np.stack([u, 0.5 * (u + v), w], axis=1)
    return TriangleMesh(
        np.concatenate([mesh.vertices, between]),
        np.concatenate([triangles, np.stack([middle, b, c], axis=1)]),
        np.append(mesh.textures, mesh.textures[rows]),
        np.concatenate([mesh.colors, mesh.colors[rows]]),
        np.concatenate([uv, np.stack([0.5 * (u + v), v, w], axis=1)]),
    )


def _is_floor(mesh):
    heights = mesh.vertices[mesh.triangles][:, :, 2]
    return (normals(mesh)[:, 2] < -0.9) & (heights.max(axis=1) < mesh.vertices[:, 2].min() + 0.5)


def _is_party(mesh, i, footprints, tree):
    """Which triangles (m,) are upright and touch a footprint of another object all along."""
    corners = mesh.vertices[mesh.triangles]
    lines = shapely.linestrings(corners[:, [0, 1, 2, 0], :2])
    upright = np.flatnonzero(np.abs(normals(mesh)[:, 2]) < 1e-3)
    found = np.zeros(len(corners), dtype=bool)
    for j in tree.query(footprints[i], predicate="dwithin", distance=0.01).tolist():
        if j != i:
            found[upright[shapely.covers(footprints[j].buffer(0.02), lines[upright])]] = True
    return found
