// What is computed for each fragment: the surface's shadings, the slice's
// colours and iso-lines, the floor's grid.

const common = /* glsl */`
precision highp float;
vec3 display(vec3 linear) {
	vec3 c = clamp(linear, 0.0, 1.0);
	return mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055,
	    step(0.0031308, c));
}
vec3 linear(vec3 c) {
	return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)),
	    step(0.04045, c));
}
`;

export const surfaceVertex = /* glsl */`
in vec3 color;
in vec2 curvature;
out vec3 vPosition;
out vec3 vNormal;
out vec3 vColor;
out vec2 vCurvature;
out vec3 vCorner;
void main() {
	vPosition = position;
	vNormal = normal;
	vColor = color;
	vCurvature = curvature;
	// Of triangles whose vertices are not shared.
	int corner = gl_VertexID % 3;
	vCorner = vec3(corner == 0, corner == 1, corner == 2);
	gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}
`;

/* mode: 0 colour, 1 normal, 2 zebra, 3 curvature. The normal is Eq. 29's,
 * interpolated; curvatures are the field's own at the vertices. */
export const surfaceFragment = common + /* glsl */`
in vec3 vPosition;
in vec3 vNormal;
in vec3 vColor;
in vec2 vCurvature;
in vec3 vCorner;
out vec4 fragment;
uniform int mode;
uniform bool wire;
uniform bool gauss;
uniform bool dark;
uniform float scale;      // length: curvature 1/scale is full colour
uniform bool cut;
uniform vec4 plane;       // kept: dot(plane.xyz, p) <= plane.w
uniform vec3 keyLight;    // world, towards the light
uniform vec3 wireColor;

vec3 lit(vec3 base, vec3 n, vec3 v) {
	vec3 sky = dark ? vec3(0.42, 0.46, 0.56) : vec3(0.60, 0.64, 0.72);
	vec3 earth = dark ? vec3(0.15, 0.13, 0.13) : vec3(0.30, 0.27, 0.25);
	vec3 light = mix(earth, sky, 0.5 + 0.5 * n.z);
	float key = max(0.0, dot(n, keyLight));
	light += vec3(1.02, 0.98, 0.92) * key * 0.72;
	light += vec3(0.30, 0.33, 0.40) * max(0.0, dot(n, v)) * 0.28;
	vec3 half_way = normalize(keyLight + v);
	float shine = pow(max(0.0, dot(n, half_way)), 48.0);
	float rim = pow(1.0 - max(0.0, dot(n, v)), 4.0);
	return 0.8 * base * light + 0.13 * shine + rim * sky * 0.13;
}

vec3 diverging(float x) {
	vec3 cold = linear(vec3(0.13, 0.33, 0.72));
	vec3 warm = linear(vec3(0.75, 0.11, 0.13));
	vec3 middle = linear(vec3(0.95, 0.94, 0.92));
	float a = clamp(abs(x), 0.0, 1.0);
	return mix(middle, x < 0.0 ? cold : warm, pow(a, 0.8));
}

void main() {
	if (cut && dot(plane.xyz, vPosition) > plane.w)
		discard;
	vec3 v = normalize(cameraPosition - vPosition);
	vec3 n = length(vNormal) > 0.0 ? normalize(vNormal) : v;
	bool inside = !gl_FrontFacing;
	vec3 c;
	if (inside)
		n = -n;
	if (mode == 1) {
		c = linear(0.5 + 0.5 * (inside ? -n : n));
	} else if (mode == 2) {
		// Stripes of light across a tilted axis, seen as in a mirror.
		vec3 r = reflect(-v, n);
		float s = 4.5 * dot(r, vec3(0.30, 0.24, 0.923));
		float w = max(fwidth(s), 1e-4);
		float line = abs(fract(s) - 0.5) * 2.0;
		float stripe = smoothstep(0.5 - w, 0.5 + w, line);
		stripe = mix(stripe, 0.5, smoothstep(0.6, 1.6, w));
		c = mix(vec3(0.015, 0.017, 0.022), vec3(0.86), stripe);
		c *= 0.82 + 0.18 * max(0.0, dot(n, v));
	} else if (mode == 3) {
		float k = gauss
			? sign(vCurvature.y) * sqrt(abs(vCurvature.y)) : vCurvature.x;
		c = diverging(k * scale);
		c *= 0.62 + 0.30 * max(0.0, dot(n, keyLight)) +
			0.14 * max(0.0, dot(n, v));
	} else {
		c = lit(vColor, n, v);
	}
	if (inside && mode != 1)
		c *= 0.45;
	if (wire) {
		vec3 w = fwidth(vCorner);
		vec3 e = smoothstep(vec3(0.0), w * 1.1, vCorner);
		float line = 1.0 - min(e.x, min(e.y, e.z));
		// Triangles smaller than their lines fade to a tone.
		line *= 1.0 - 0.7 * smoothstep(0.15, 0.7, max(w.x, max(w.y, w.z)));
		c = mix(c, wireColor, 0.78 * line);
	}
	fragment = vec4(display(c), 1.0);
}
`;

export const planeVertex = /* glsl */`
out vec2 vUv;
out vec3 vPosition;
void main() {
	vUv = uv;
	vPosition = (modelMatrix * vec4(position, 1.0)).xyz;
	gl_Position = projectionMatrix * viewMatrix * vec4(vPosition, 1.0);
}
`;

/* The field's values, float32 as the daemon computed them, interpolated
 * bilinearly; lines where they cross multiples of step and iso, as thin as the
 * screen allows. */
export const sliceFragment = common + /* glsl */`
in vec2 vUv;
out vec4 fragment;
uniform sampler2D field;
uniform float iso;
uniform float step_;
uniform bool dark;

float at(ivec2 p) {
	ivec2 size = textureSize(field, 0);
	return texelFetch(field, clamp(p, ivec2(0), size - 1), 0).r;
}

// How much of a line at value there is here.
float line(float f, float value, float width) {
	float w = max(fwidth(f), 1e-7);
	return 1.0 - smoothstep(width - 0.5, width + 0.5, abs(f - value) / w);
}

void main() {
	vec2 p = vec2(vUv.x, 1.0 - vUv.y) * vec2(textureSize(field, 0)) - 0.5;
	ivec2 i = ivec2(floor(p));
	vec2 t = p - vec2(i);
	float f = mix(mix(at(i), at(i + ivec2(1, 0)), t.x),
	    mix(at(i + ivec2(0, 1)), at(i + ivec2(1, 1)), t.x), t.y);

	vec3 pale = linear(dark ? vec3(0.16, 0.20, 0.27) : vec3(0.90, 0.94, 0.97));
	vec3 cold = linear(dark ? vec3(0.28, 0.45, 0.62) : vec3(0.58, 0.76, 0.88));
	vec3 warm = linear(vec3(0.99, 0.80, 0.55));
	vec3 hot = linear(vec3(0.89, 0.36, 0.22));
	float below = clamp(f / iso, 0.0, 1.0);
	float above = clamp((f - iso) / max(1.0 - iso, 0.5 * iso), 0.0, 1.0);
	vec3 c = f < iso ? mix(pale, cold, below) : mix(warm, hot, above);

	float nearest = round(f / step_) * step_;
	float thin = nearest > 0.5 * step_ ? line(f, nearest, 0.55) : 0.0;
	// Where lines would touch each other there are none.
	thin *= 1.0 - smoothstep(0.15, 0.4, fwidth(f) / step_);
	// Where the field is flat, a line would be a blot.
	thin *= smoothstep(0.002, 0.012, fwidth(f) / step_);
	// A soft primitive is 1 along its skeleton and nowhere more: no line there,
	// but crumbs of one.
	thin *= step(0.001, abs(nearest - 1.0));
	float thick = line(f, iso, 1.5);
	vec3 ink = linear(dark && f < iso ? vec3(0.75, 0.84, 0.92)
	    : vec3(0.10, 0.12, 0.16));
	c = mix(c, ink, 0.42 * thin);
	c = mix(c, linear(vec3(0.06, 0.07, 0.10)), thick);
	float a = f <= 0.0 ? 0.35 : mix(0.62, 0.97, smoothstep(0.0, 0.35, below));
	fragment = vec4(display(c), max(a, max(0.6 * thin, thick)));
}
`;

export const floorFragment = common + /* glsl */`
in vec2 vUv;
in vec3 vPosition;
out vec4 fragment;
uniform float cell;
uniform float reach;
uniform vec3 center;
uniform vec3 ink;
float grid(vec2 p) {
	vec2 w = max(fwidth(p), 1e-6);
	vec2 d = abs(fract(p - 0.5) - 0.5) / w;
	float line = 1.0 - min(min(d.x, d.y), 1.0);
	return line * (1.0 - smoothstep(0.25, 0.6, max(w.x, w.y)));
}
void main() {
	vec2 p = vPosition.xy / cell;
	float line = max(0.45 * grid(p), grid(p / 5.0));
	float fade = 1.0 - smoothstep(0.15, 1.0,
	    distance(vPosition.xy, center.xy) / reach);
	fragment = vec4(ink, line * fade * 0.5);
}
`;
