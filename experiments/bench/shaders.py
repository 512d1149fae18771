"""The peer's GLSL.

``PCSS`` is ``pcss_visibility`` of ``wkernels.filters.penumbra`` and ``locate_receiver`` with the slope bias of
``light_maps.light_map``, written for a directional light as one would by hand: w is 1, and the map's scale is the same
everywhere and comes as a uniform. Its inputs are our own G-buffer and light map.
"""

VERTEX = """
#version 330
in vec3 position_ws;
uniform mat4 ws_to_clip;
void main() { gl_Position = ws_to_clip * vec4(position_ws, 1.0); }
"""

DEPTH_ONLY = """
#version 330
void main() {}
"""

TRIANGLE = """
#version 330
out int triangle_out;  // 0 is the background, which a clear can only set to zeros
void main() { triangle_out = gl_PrimitiveID + 1; }
"""

FULL_SCREEN = """
#version 330
void main() { gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0); }
"""

PCSS = """
#version 330
uniform sampler2D position_ws;   // w: 1 receives, 0 does not
uniform sampler2D normal_ws;     // w: 1 casts, 0 does not
uniform sampler2D map_depth;
uniform mat4 ws_to_ls;           // x, y in [-1, 1], linear depth, 1
uniform vec3 to_light;
uniform mat2 texels_per_ratio;   // half-axes of the penumbra [texels] for a ratio of 1
uniform float nearest_depth;
uniform float bias_slope;
uniform float rounding;
uniform float border;
uniform float resolution;
uniform vec2 blocker_taps[BLOCKER_TAPS];
uniform vec2 filter_taps[FILTER_TAPS];
out float visibility_out;

vec2 inside(vec2 at) { return clamp(at, vec2(border), vec2(resolution - border)); }

mat2 penumbra(float receiver_depth, float blocker_depth)
{
    mat2 spread = texels_per_ratio * max(receiver_depth - blocker_depth, 0.0);
    vec2 most = max(abs(spread[0]), abs(spread[1]));
    return spread * min(1.0, resolution / max(max(most.x, most.y), 1.0));
}

void main()
{
    visibility_out = 1.0;
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 position = texelFetch(position_ws, pixel, 0);
    if (position.w == 0.0)
        return;
    vec4 normal = texelFetch(normal_ws, pixel, 0);
    if (normal.w != 0.0 && dot(normal.xyz, to_light) <= 0.0) {
        visibility_out = 0.0;
        return;
    }
    vec3 here = (ws_to_ls * vec4(position.xyz, 1.0)).xyz;
    if (max(abs(here.x), abs(here.y)) > 1.0)
        return;
    vec2 texel = vec2(0.5 + 0.5 * here.x, 0.5 - 0.5 * here.y) * resolution;

    // the receiver's plane: depth per texel is minus the normal's slopes on the map's axes
    mat3 rows = transpose(mat3(ws_to_ls));
    vec2 scale = vec2(length(rows[0]), length(rows[1]));
    float facing = dot(normal.xyz, rows[2]);
    vec2 slope = vec2(0.0);
    if (abs(facing) > 1.0e-5)
        slope = vec2(-1.0, 1.0) * vec2(dot(normal.xyz, rows[0]), dot(normal.xyz, rows[1]))
            / (scale * scale * facing) * (2.0 / resolution);
    float bias = rounding * here.z + bias_slope * 0.5 * (abs(slope.x) + abs(slope.y));
    float biased = here.z - bias;

    mat2 spread = penumbra(here.z, nearest_depth);
    float total = 0.0;
    float count = 0.0;
    for (int i = 0; i < BLOCKER_TAPS; ++i) {
        vec2 at = inside(texel + spread * blocker_taps[i]);
        float stored = texelFetch(map_depth, ivec2(at), 0).r;
        if (biased + dot(slope, at - texel) > stored) {
            total += stored;
            count += 1.0;
        }
    }
    if (count == 0.0)
        return;
    spread = penumbra(here.z, total / count);
    float lit = 0.0;
    for (int i = 0; i < FILTER_TAPS; ++i) {
        vec2 at = inside(texel + spread * filter_taps[i]);
        lit += biased + dot(slope, at - texel) <= texelFetch(map_depth, ivec2(at), 0).r ? 1.0 : 0.0;
    }
    visibility_out = lit / float(FILTER_TAPS);
}
"""
