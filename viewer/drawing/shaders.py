"""The shaders that ``viewer.drawing.renderer`` draws with, as GLSL 3.30 text: one pair for each kind of draw.

``MEASURED`` programs also put out, per pixel, the object, its depth along the axis, and by what angle an impostor's surface
is displaced (-1 where geometry, ground or sky shows). ``CAPTURED_DEPTH`` is for triangles of layers that need it
(``mmi.meshing.ordering``): each fragment takes the depth of the surface point that its texel captured, as this view sees it.
``COVERAGE`` is for multisampling: silhouettes of layers become coverage of samples.
"""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["KINDS", "program_source"]

KINDS = ("geometry", "layer", "captured", "sky", "fade")
"""What there are programs for; ``captured`` is ``layer`` with ``CAPTURED_DEPTH``."""

_COMMON = """
uniform mat3 eye_from_world;
uniform vec3 eye;
uniform vec4 projection;  // x and y scale, x and y offset
uniform vec2 clip;        // near, far
vec4 project(vec3 p) {    // p in the eye's frame
    return vec4(projection.x * p.x - projection.z * p.z, projection.y * p.y - projection.w * p.z,
                (clip.y + clip.x) / (clip.x - clip.y) * p.z + 2.0 * clip.x * clip.y / (clip.x - clip.y), -p.z);
}
"""
_OUTPUTS = """
layout(location = 0) out vec4 color_out;
#ifdef MEASURED
layout(location = 1) out int id_out;
layout(location = 2) out vec2 surface_out;  // depth along the axis, displacement as an angle
#endif
"""
_GEOMETRY_VERTEX = """
in vec3 position; in vec2 uv; in vec3 color; in int object;
out vec2 at; out vec3 tint; flat out int which; out float depth;
void main() {
    vec3 p = eye_from_world * (position - eye);
    at = uv; tint = color; which = object; depth = -p.z;
    gl_Position = project(p);
}
"""
_GEOMETRY_FRAGMENT = """
uniform sampler2D picture;
in vec2 at; in vec3 tint; flat in int which; in float depth;
void main() {
    color_out = vec4(texture(picture, at, -0.75).rgb * tint, 1.0);
#ifdef MEASURED
    id_out = which; surface_out = vec2(depth, -1.0);
#endif
}
"""
_LAYER_VERTEX = """
in vec3 position;
in vec3 texture_from_capture;  // texture coordinates times depth in the capture, and that: linear in space, so projective
uniform vec3 captured_from;
out vec3 at;
#if defined(MEASURED) || defined(CAPTURED_DEPTH)
out float depth;
#endif
#ifdef MEASURED
out vec3 world;                // relative to the capture's eye
#endif
void main() {
    vec3 p = eye_from_world * (position - eye);
    at = texture_from_capture;
#if defined(MEASURED) || defined(CAPTURED_DEPTH)
    depth = -p.z;
#endif
#ifdef MEASURED
    world = position - captured_from;
#endif
    gl_Position = project(p);
}
"""
_LAYER_FRAGMENT = """
uniform sampler2D picture;
in vec3 at;
#if defined(MEASURED) || defined(CAPTURED_DEPTH)
in float depth;
uniform sampler2D depths;
uniform float ahead;           // how far the capture's eye is ahead of the viewer, along the axis
#endif
#ifdef MEASURED
in vec3 world;
uniform isampler2D ids;
uniform vec3 viewer;           // relative to the capture's eye
#endif
void main() {
    vec2 uv = at.xy / at.z;
    vec4 color = texture(picture, uv);
#ifdef COVERAGE
    color.a = clamp((color.a - 0.5) / max(fwidth(color.a), 1e-4) + 0.5, 0.0, 1.0);
    if (color.a <= 0.0) discard;
    color_out = color;
#else
    if (color.a < 0.5) discard;
    color_out = vec4(color.rgb, 1.0);
#endif
#if defined(MEASURED) || defined(CAPTURED_DEPTH)
    ivec2 size = textureSize(depths, 0);
    ivec2 nearest = clamp(ivec2(floor(uv * vec2(size))), ivec2(0), size - 1);
    float captured_depth = texelFetch(depths, nearest, 0).r;
    if (isinf(captured_depth)) captured_depth = at.z;
    float stretch = captured_depth / max(at.z, 1e-6);  // the captured point, on one ray from the capture's eye
    float shown_depth = depth;
#endif
#ifdef CAPTURED_DEPTH
    shown_depth = max(ahead + stretch * (depth - ahead), clip.x);
    gl_FragDepth = (clip.y - clip.y * clip.x / shown_depth) / (clip.y - clip.x);
#endif
#ifdef MEASURED
    int id = texelFetch(ids, nearest, 0).r;
    for (int k = 0; k < 9 && id < 0; ++k) {  // the filter reaches half a texel beyond the silhouette
        ivec2 other = clamp(nearest + ivec2(k % 3, k / 3) - 1, ivec2(0), size - 1);
        id = texelFetch(ids, other, 0).r;
    }
    id_out = id;
    vec3 a = normalize(world - viewer), b = normalize(world * stretch - viewer);
    surface_out = vec2(shown_depth, id < 0 ? -1.0 : atan(length(cross(a, b)), dot(a, b)));
#endif
}
"""
_SCREEN_VERTEX = """
out vec2 at;
void main() {
    at = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0;
    gl_Position = vec4(at, 0.9999999, 1.0);
}
"""
_SKY_FRAGMENT = """
uniform vec3 horizon; uniform vec3 zenith;
in vec2 at;
void main() {
    vec3 ray = vec3((at.x + projection.z) / projection.x, (at.y + projection.w) / projection.y, -1.0);
    float up = pow(clamp(normalize(ray * eye_from_world).z, 0.0, 1.0), 0.6);
    color_out = vec4(mix(horizon, zenith, up), 1.0);
#ifdef MEASURED
    id_out = -1; surface_out = vec2(1e30, -1.0);
#endif
}
"""
_FADE_FRAGMENT = """
uniform sampler2D picture;
uniform float share;
in vec2 at;
void main() { color_out = vec4(texture(picture, 0.5 * at + 0.5).rgb, share); }
"""

_PAIRS = (
    ("geometry", _GEOMETRY_VERTEX, _GEOMETRY_FRAGMENT),
    ("layer", _LAYER_VERTEX, _LAYER_FRAGMENT),
    ("captured", _LAYER_VERTEX, _LAYER_FRAGMENT),
    ("sky", _SCREEN_VERTEX, _SKY_FRAGMENT),
    ("fade", _SCREEN_VERTEX, _FADE_FRAGMENT),
)


def program_source(kind: str, *, flags: Sequence[str] = ()) -> tuple[str, str]:
    """Vertex and fragment shader of a kind of draw, with these ``flags`` defined. Raises KeyError for an unknown kind."""
    vertex, fragment = {name: (vertex, fragment) for name, vertex, fragment in _PAIRS}[kind]
    defined = (*flags, "CAPTURED_DEPTH") if kind == "captured" else flags
    head = "\n".join(["#version 330", *(f"#define {flag}" for flag in defined)]) + _COMMON
    return head + vertex, head + _OUTPUTS + fragment
