// The transport of irodori/rendering/interactive, one ray a pixel. What a scene does not need is not compiled: the
// constants in capitals are set when its program is made.
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp sampler2DArray;

layout(location = 0) out vec4 outXYZ;   // X, Y, Z and the row of the side that is seen, -1 for none
layout(location = 1) out vec4 outPlace; // place in the texture, status, uncertainty
layout(location = 2) out vec4 outPoint; // x, y, z of what is seen, mm

uniform vec3 uEye;
uniform mat3 uWorldFromCamera;
uniform vec3 uFrame;          // half the width and the height, and a pixel: at distance 1, of parallel rays in mm
uniform bool uParallel;
uniform vec2 uFirstPixel;
uniform mat3 uLightFromWorld;
uniform float uLeast;
uniform int uHidden;          // bits of objects that are left out
uniform sampler2D uShapes;    // rows of ROW texels, see renderer.js
uniform sampler2D uForms;     // bilinear forms, see spectra.js
uniform sampler2DArray uMaterials;
uniform float uPowerScale;
#if HAS_LIGHT
uniform sampler2DArray uSky, uIrradiance;
uniform vec3 uSkyLevel[SKY_LEVELS]; // where its faces begin, and their side
uniform vec3 uIrradianceLevel[1 + COATS]; // likewise, without a coat and under each
uniform float uTexelsPerRad;
#endif
#if GLOSS_LEVELS > 0
uniform sampler2DArray uGloss;
uniform vec3 uGlossLevel[GLOSS_LEVELS];
uniform float uGlossFirst;
#endif
#if COATS > 0
uniform vec2 uCoat[COATS];    // n and k of each coupled coat
#endif
#if PARTS > 0
uniform sampler2D uRows;      // tables of round lobes, 4 texels an entry
uniform vec2 uLadder[LOBES];
#endif
#if HAS_MESH
uniform sampler2D uMesh;
#endif
#if BAKED
uniform sampler2D uLight, uCorners; // light maps, and the nodes at places on meshes; see light_maps.js and maps.js
uniform bool uBaked;          // whether they are known
#endif
uniform int uLamps;
uniform vec4 uLamp[MOST_LAMPS];     // direction and -1 of a far lamp, or position and radius, mm
uniform float uLampLevel[MOST_LAMPS];
uniform vec4 uLightScale[G];  // numbers of light are stored divided by these

const float PI = 3.14159265358979;
const float RISE = 1.0 / 262144.0;

struct Light { vec4 g[G]; };

#if COLOURED
#define Colour mat4
#define PRODUCT(a, b) matrixCompMult(a, b)
uniform mat4 uDecode[4 * G];
uniform mat4 uLampColour[MOST_LAMPS];
uniform vec4 uXYZFromColour[12];
#else
#define Colour vec3
#define PRODUCT(a, b) ((a) * (b))
uniform vec3 uXYZFromLight[4 * G];
uniform vec3 uLampColour[MOST_LAMPS];
#endif

struct Ray { vec3 o, d; };
struct Hit { float t; int object; int triangle; vec2 b; };
struct Place { vec3 point, normal, facet; vec2 uv; float cosine; int side; }; // the row of the side that is seen

vec4 shapeRow(int object, int number) { return texelFetch(uShapes, ivec2(number, object), 0); }
mat3 turnOf(int object) { // world from object, by columns
  return mat3(shapeRow(object, 1).xyz, shapeRow(object, 2).xyz, shapeRow(object, 3).xyz);
}

float fresnel(float cosine, float n, float k) {
  float c = clamp(cosine, 0.0, 1.0), c2 = c * c, nk = c > -1.0 ? n * k : 0.0;
  float s2 = (1.0 - c) * (1.0 + c), contrast = (n - 1.0) * (n + 1.0) - k * k;
  float real = c2 < 0.5 ? contrast + c2 : n * n - s2 - k * k;
  float modulus = sqrt(real * real + 4.0 * nk * nk), large = sqrt(0.5 * (modulus + abs(real)));
  float small = nk / max(large, 1e-18);
  float a = real >= 0.0 ? large : small, b = real >= 0.0 ? small : large, b2 = b * b, total = a + c;
  float difference = b2 < c2 ? contrast + b2 : (a - c) * total;
  float square = total * total, even = modulus * c2 + s2 * s2;
  float over = (difference * difference + b2 * square) * even;
  float under = square * (square + b2) * (even + 2.0 * (a * c * s2));
  return min(1.0, under > 0.0 ? over / under : (b2 > 0.0 ? 1.0 : 0.0));
}

// The number of a side's coat, 0 for none; and the share of light that passes it, relative to that from straight above.
int coatOf(int side) {
#if COATS > 0
  return int(shapeRow(side, 6).w);
#else
  return 0;
#endif
}
float throughCoat(int side, float cosine) {
#if COATS > 0
  int coat = coatOf(side);
  if (coat == 0) return 1.0;
  vec2 index = uCoat[coat - 1];
  return (1.0 - fresnel(cosine, index.x, index.y)) / (1.0 - fresnel(1.0, index.x, index.y));
#else
  return 1.0;
#endif
}

#if COLOURED
mat4 formsMatrix(int column, int row) {
  return mat4(texelFetch(uForms, ivec2(column, row), 0), texelFetch(uForms, ivec2(column + 1, row), 0),
              texelFetch(uForms, ivec2(column + 2, row), 0), texelFetch(uForms, ivec2(column + 3, row), 0));
}
Colour decoded(Light light) {
  Colour out_ = mat4(0.0);
  for (int i = 0; i < 4 * G; i++) out_ += light.g[i / 4][i % 4] * uDecode[i];
  return out_;
}
Colour reflectance(int object, float cosine) {
  mat4 n = formsMatrix(4 * KS, object), k = formsMatrix(4 * KS + 4, object), out_;
  for (int i = 0; i < 4; i++) for (int j = 0; j < 4; j++) out_[i][j] = fresnel(cosine, n[i][j], k[i][j]);
  return out_;
}
float greatest(Colour c) {
  vec4 m = max(max(c[0], c[1]), max(c[2], c[3]));
  return max(max(m.x, m.y), max(m.z, m.w));
}
#else
Colour decoded(Light light) {
  Colour out_ = vec3(0.0);
  for (int i = 0; i < 4 * G; i++) out_ += light.g[i / 4][i % 4] * uXYZFromLight[i];
  return out_;
}
#endif

// ---- light ----------------------------------------------------------------------------------------------------------

void faceOf(vec3 d, out float face, out vec2 uv) {
  vec3 a = abs(d);
  float main_;
  if (a.x >= a.y && a.x >= a.z) { face = 0.0; main_ = d.x; uv = d.yz; }
  else if (a.y >= a.z) { face = 2.0; main_ = d.y; uv = d.zx; }
  else { face = 4.0; main_ = d.z; uv = d.xy; }
  if (main_ < 0.0) face += 1.0;
  uv /= max(abs(main_), 1e-30);
}

#if HAS_LIGHT
Light lookUp(sampler2DArray map, vec3 level, vec3 d) {
  float face;
  vec2 uv;
  faceOf(d, face, uv);
  vec2 place = clamp((uv + 1.0) * (level.z * 0.5) + 0.5, 0.0, level.z + 0.5) + 0.5;
  place += level.xy + (level.z + 2.0) * vec2(mod(face, 3.0), floor(face / 3.0));
  place /= vec2(textureSize(map, 0).xy);
  Light found;
  for (int g = 0; g < G; g++) found.g[g] = textureLod(map, vec3(place, float(g)), 0.0) * uLightScale[g];
  return found;
}
Light mixed(Light a, Light b, float part) {
  for (int g = 0; g < G; g++) a.g[g] = mix(a.g[g], b.g[g], part);
  return a;
}
Light skyAt(vec3 d, float spread) {
  float level = clamp(log2(max(spread * uTexelsPerRad, 1.0)), 0.0, float(SKY_LEVELS - 1));
  int lower = int(level);
  float part = level - float(lower);
  vec3 turned = uLightFromWorld * d;
  Light found = lookUp(uSky, uSkyLevel[lower], turned);
  if (part > 0.01) found = mixed(found, lookUp(uSky, uSkyLevel[min(lower + 1, SKY_LEVELS - 1)], turned), part);
  return found;
}
Light irradianceAt(int coat, vec3 normal) {
  return lookUp(uIrradiance, uIrradianceLevel[coat], uLightFromWorld * normal);
}
#endif

// ---- shapes ---------------------------------------------------------------------------------------------------------

#if HAS_MESH
vec4 meshTexel(int number) { return texelFetch(uMesh, ivec2(number % 2048, number / 2048), 0); }

// The nearest triangle of one mesh; its tree is passed through in one order, each node says where to go on beside it.
void meetMesh(int object, Ray ray, float scale, int skip, bool any_, inout Hit hit) {
  vec4 where = shapeRow(object, 8);
  int node = int(where.x), last = int(where.y), triangles = int(where.z);
  mat3 turn = turnOf(object);
  vec3 o = (ray.o - shapeRow(object, 0).xyz) * turn / scale, d = ray.d * turn / scale;
  vec3 inverse = 1.0 / mix(d, vec3(1e-20), lessThan(abs(d), vec3(1e-20)));
  while (node < last) {
    vec4 low = meshTexel(2 * node), high = meshTexel(2 * node + 1);
    vec3 a = (low.xyz - o) * inverse, b = (high.xyz - o) * inverse;
    vec3 near = min(a, b), far = max(a, b);
    float enter = max(max(near.x, near.y), max(near.z, 0.0)), leave = min(min(far.x, far.y), min(far.z, hit.t));
    if (enter > leave * 1.0000004) { node = int(low.w); continue; }
    if (high.w >= 0.0) {
      int code = int(high.w), first = code / 8, count = code - 8 * first;
      for (int i = first; i < first + count; i++) {
        if (i == skip) continue;
        int at = triangles + TRIANGLE * i;
        vec3 p = meshTexel(at).xyz, e = meshTexel(at + 1).xyz - p, f = meshTexel(at + 2).xyz - p;
        vec3 pv = cross(d, f), tv = o - p, qv = cross(tv, e);
        float det = dot(e, pv);
        if (det == 0.0) continue;
        float u = dot(tv, pv) / det, v = dot(d, qv) / det, t = dot(f, qv) / det;
        if (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0 && t < hit.t) {
          hit.t = t;
          hit.object = object;
          hit.triangle = i;
          hit.b = vec2(u, v);
          if (any_) return;
        }
      }
    }
    node++;
  }
}
#endif

// Let a ray meet the scene up to hit.t; `own` is what it starts on, whose triangle `skip` it does not meet.
void meet(Ray ray, int own, int skip, bool any_, inout Hit hit) {
  for (int object = 0; object < OBJECTS; object++) {
    if (((uHidden >> object) & 1) == 1) continue;
    vec4 centre = shapeRow(object, 0), size = shapeRow(object, 4);
    int kind = int(size.w);
#if HAS_MESH
    if (kind == 4) {
      meetMesh(object, ray, shapeRow(object, 8).w, object == own ? skip : -1, any_, hit);
      if (any_ && hit.object >= 0) return;
      continue;
    }
#endif
    if (object == own) continue; // nothing that is not a mesh meets itself
    vec3 away = centre.xyz - ray.o;
    float t = -1.0;
    if (kind == 0) {
      float along = dot(away, ray.d);
      vec3 beside = away - along * ray.d;
      float square = centre.w * centre.w - dot(beside, beside);
      if (square >= 0.0) {
        float half_ = sqrt(square);
        t = along - half_ > 0.0 ? along - half_ : along + half_;
      }
    } else {
      mat3 turn = turnOf(object);
      float steep = dot(ray.d, turn[2]);
      t = steep != 0.0 ? dot(away, turn[2]) / steep : -1.0;
      vec3 place = t * ray.d - away;
      vec2 across = vec2(dot(place, turn[0]), dot(place, turn[1]));
      if (kind == 1 && (abs(across.x) > 0.5 * size.x || abs(across.y) > 0.5 * size.y)) t = -1.0;
      if (kind == 2 && dot(across, across) > centre.w * centre.w) t = -1.0;
    }
    if (t > 0.0 && t < hit.t) {
      hit.t = t;
      hit.object = object;
      hit.triangle = -1;
      if (any_) return;
    }
  }
}

// Point, normals and place in the texture of a hit; false where it is seen from behind.
bool placed(Ray ray, Hit hit, out Place place) {
  int object = hit.object;
  vec4 centre = shapeRow(object, 0), size = shapeRow(object, 4);
  mat3 turn = turnOf(object);
  int kind = int(size.w);
  vec3 offset = ray.o + hit.t * ray.d - centre.xyz;
  if (kind == 0) {
    place.normal = place.facet = normalize(offset);
    place.point = centre.xyz + centre.w * place.normal;
    vec3 local = place.normal * turn;
    float around = atan(local.y, local.x) / (2.0 * PI);
    place.uv = vec2(around < 0.0 ? around + 1.0 : around, atan(length(local.xy), local.z) / PI);
#if HAS_MESH
  } else if (kind == 4) {
    vec4 where = shapeRow(object, 8);
    int at = int(where.z) + TRIANGLE * hit.triangle;
    vec4 m[6];
    for (int i = 0; i < 6; i++) m[i] = meshTexel(at + i);
    vec3 w = vec3(1.0 - hit.b.x - hit.b.y, hit.b);
    vec3 local = w.x * m[0].xyz + w.y * m[1].xyz + w.z * m[2].xyz;
    place.point = centre.xyz + where.w * (turn * local);
    place.facet = normalize(turn * cross(m[1].xyz - m[0].xyz, m[2].xyz - m[0].xyz));
    vec3 shading = turn * (w.x * m[3].xyz + w.y * m[4].xyz + w.z * m[5].xyz);
    place.normal = length(shading) < 1e-6 ? place.facet : normalize(shading);
    place.uv = vec2(w.x * m[0].w + w.y * m[2].w + w.z * m[4].w, w.x * m[1].w + w.y * m[3].w + w.z * m[5].w);
#endif
  } else {
    place.normal = place.facet = turn[2];
    place.point = centre.xyz + offset - dot(offset, turn[2]) * turn[2];
    vec3 local = offset * turn;
    place.uv = kind == 3 ? vec2(0.5) : vec2(local.x / size.x + 0.5, 0.5 - local.y / size.y);
  }
  float front = -dot(place.facet, ray.d);
  place.side = object;
#if SHEETS
  int behind = int(shapeRow(object, 11).x);
  if (front < 0.0 && behind >= 0) {
    place.side = behind;
    place.normal = -place.normal;
    place.facet = -place.facet;
    front = -front;
  }
#endif
  place.cosine = -dot(place.normal, ray.d);
  if (place.cosine <= 0.0) {
    place.normal = place.facet;
    place.cosine = front;
  }
  place.cosine = clamp(place.cosine, 0.0, 1.0);
  return front > (kind == 0 ? -1e-3 : 0.0);
}

vec3 raised(Place place, float reach) {
  vec3 a = abs(place.point);
  return place.point + max(max(a.x, a.y), max(a.z, reach)) * RISE * place.facet;
}

// ---- surfaces -------------------------------------------------------------------------------------------------------

struct Surface { float s[KS]; vec4 gloss; vec2 about; };

Surface surfaceAt(int object, vec2 uv) {
  vec4 where = shapeRow(object, 5);
  vec2 place = where.xy + clamp(uv * where.zw + 0.5, vec2(0.0), where.zw + 0.5) + 0.5;
  vec2 size = vec2(textureSize(uMaterials, 0).xy);
  Surface found;
  for (int g = 0; g < (KS + 3) / 4; g++) {
    vec4 four = textureLod(uMaterials, vec3(place / size, float(g)), 0.0);
    for (int i = 0; i < 4; i++) if (4 * g + i < KS) found.s[4 * g + i] = four[i];
  }
  found.gloss = textureLod(uMaterials, vec3(place / size, float((KS + 3) / 4)), 0.0);
  found.gloss.xz /= uPowerScale;
  ivec2 nearest = ivec2(where.xy + clamp(floor(uv * where.zw), vec2(0.0), where.zw - 1.0) + 1.0);
  found.about = texelFetch(uMaterials, ivec3(nearest, (KS + 3) / 4 + 1), 0).xy;
  return found;
}

#if COLOURED
Colour surfaceColour(int object, Surface surface) {
  Colour out_ = mat4(0.0);
  for (int j = 0; j < KS; j++) out_ += surface.s[j] * formsMatrix(4 * j, object);
  return out_;
}
Colour diffuse(int object, Surface surface, Light light) {
  return PRODUCT(surfaceColour(object, surface), decoded(light)) / PI;
}
Colour lampDiffuse(int object, int lamp, Surface surface) {
  return PRODUCT(surfaceColour(object, surface), uLampColour[lamp]);
}
#else
Colour diffuse(int object, Surface surface, Light light) {
  Colour out_ = vec3(0.0);
  for (int i = 0; i < K; i++) {
    Colour one = vec3(0.0);
    for (int j = 0; j < KS; j++) one += surface.s[j] * texelFetch(uForms, ivec2(i * KS + j, object), 0).xyz;
    out_ += light.g[i / 4][i % 4] * one;
  }
  return out_ / PI;
}
Colour lampDiffuse(int object, int lamp, Surface surface) {
  Colour out_ = vec3(0.0);
  int row = SURFACES + lamp * SURFACES + object;
  for (int j = 0; j < KS; j++) out_ += surface.s[j] * texelFetch(uForms, ivec2(j, row), 0).xyz;
  return out_;
}
#endif

#if PARTS > 0
// D G / cosθ_r of a lobe, and β over the power that a texel holds.
float lobeValue(int lobe, float place, vec3 view, vec3 to, vec3 normal, float cosR, float cosI, out float cosH) {
  float mu = exp(place * uLadder[lobe].y + uLadder[lobe].x);
  vec3 h = view + to;
  float length_ = length(h);
  cosH = 0.0;
  if (length_ < 1e-6) return 0.0;
  float cosPhi = dot(h, normal) / length_;
  cosH = sqrt(max(0.5 * (1.0 + dot(view, to)), 0.0));
  if (cosPhi <= 0.0 || cosH <= 0.0) return 0.0;
  // Of the angle between half vector and normal: their cross product keeps the digits that the cosine loses.
  float sinPhi = length(cross(h, normal)) / length_;
  if (GGX(lobe)) {
    float m2 = mu * mu, f0 = sinPhi * sinPhi, ratio = m2 / (m2 * (1.0 - f0) + f0);
    float qi = cosI * cosI + m2 * (1.0 - cosI * cosI), qr = cosR * cosR + m2 * (1.0 - cosR * cosR);
    return 2.0 * cosI * ratio * ratio / (cosR * sqrt(qi) + cosI * sqrt(qr)) / m2;
  }
  float phi = atan(sinPhi, cosPhi), facet = 2.0 * cosPhi / cosH;
  return min(min(facet * cosI, 1.0) / cosR, facet) * exp(-phi * phi / (mu * mu)) / (mu * mu);
}

// What a glossy surface reflects: light from all around, or what another surface sends where the mirrored ray meets it.
struct Gloss { int object; vec4 gloss; vec3 normal, mirror; float cosine, through; };

Colour lobeLight(Gloss of, int c, bool isMet, Colour sent) {
  Colour sum_ = Colour(0.0);
#if GLOSS_LEVELS > 0 || BAKED
  int object = of.object, lobe = int(shapeRow(object, 7)[c]);
  float power = of.gloss[2 * c], place = of.gloss[2 * c + 1], cosine = of.cosine;
  if (lobe < 0 || power * of.through <= uLeast / 4.0) return sum_;
  vec4 index = shapeRow(object, 6);
  float x = sqrt(cosine) * 16.0, y = clamp(place, 0.0, 16.0);
  int column = min(int(x), 15), row = min(int(y), 15);
  float fx = x - float(column), fy = y - float(row), sine2 = 1.0 - cosine * cosine;
  vec3 n = uLightFromWorld * of.normal, r = uLightFromWorld * of.mirror;
  for (int part = 0; part < PARTS; part++) {
    vec4 v[4];
    int top = (lobe * PARTS + part) * 17 + row;
    for (int i = 0; i < 4; i++) {
      int at = 4 * column + i;
      v[i] = mix(mix(texelFetch(uRows, ivec2(at, top), 0), texelFetch(uRows, ivec2(at + 4, top), 0), fx),
                 mix(texelFetch(uRows, ivec2(at, top + 1), 0), texelFetch(uRows, ivec2(at + 4, top + 1), 0), fx), fy);
    }
    vec3 tap[4];
    tap[0] = v[0].yzw;
    tap[1] = v[1].xyz;
    tap[2] = vec3(v[1].w, v[2].xy);
    tap[3] = vec3(v[2].zw, v[3].x);
#if GLOSS_LEVELS > 0
    float level = clamp(v[0].x - uGlossFirst, 0.0, float(GLOSS_LEVELS - 1));
    int lower = int(level);
#endif
    for (int i = 0; i < 4; i++) {
      float weight = tap[i].x * power;
#if COLOURED
      Colour passed = weight * reflectance(object, tap[i].z);
      if (greatest(passed) * of.through <= uLeast / 4.0) continue;
#else
      float passed = weight * fresnel(tap[i].z, index.x, index.y);
      if (passed * of.through <= uLeast / 4.0) continue;
#endif
      if (isMet) {
        sum_ += PRODUCT(passed, sent);
        continue;
      }
#if GLOSS_LEVELS > 0
      float p = tap[i].y, q = sqrt(max(1.0 - p * p * sine2, 0.0)) - p * cosine;
      vec3 d = p * r + q * n;
      Light found = lookUp(uGloss, uGlossLevel[lower], d);
      if (level > float(lower)) {
        int upper = min(lower + 1, GLOSS_LEVELS - 1);
        found = mixed(found, lookUp(uGloss, uGlossLevel[upper], d), level - float(lower));
      }
      sum_ += PRODUCT(passed, decoded(found));
#endif
    }
  }
#endif
  return sum_;
}
#endif

#if BAKED
struct About { ivec4 texel; vec4 weight; };

int cornerAt(int number) { return int(texelFetch(uCorners, ivec2(number / 4 % 2048, number / 8192), 0)[number % 4]); }

About gridPlace(vec2 at, ivec2 size, bool wraps) {
  at.y = clamp(at.y, 0.0, float(size.y - 1));
  if (!wraps) at.x = clamp(at.x, 0.0, float(size.x - 1));
  int i = wraps ? int(floor(at.x)) : min(int(at.x), size.x - 2), j = min(int(at.y), size.y - 2);
  vec2 f = at - vec2(float(i), float(j));
  int left = (i + size.x) % size.x, right = (i + 1) % size.x, row = j * size.x;
  return About(ivec4(row + left, row + right, row + size.x + left, row + size.x + right),
               vec4((1.0 - f.x) * (1.0 - f.y), f.x * (1.0 - f.y), (1.0 - f.x) * f.y, f.x * f.y));
}
float warped(float offset) {
  return abs(offset) <= 1.0 ? 0.5 * offset : sign(offset) * (1.0 - 0.5 / abs(offset));
}
// The texels of its light map about a hit, and their weights; see irodori/rendering/map_layouts.py.
About texelsAbout(int object, Place place, Hit hit) {
  int kind = int(shapeRow(object, 4).w);
  vec2 size = shapeRow(object, 9).zy;
#if HAS_MESH
  if (kind == 4) {
    vec4 where = meshTexel(int(shapeRow(object, 8).z) + TRIANGLE * hit.triangle + 6);
    int first = int(where.x), parts = int(where.y);
    vec2 at = clamp(hit.b, 0.0, 1.0) * where.y;
    int j = min(int(at.y), parts - 1), i = min(int(at.x), parts - 1 - j);
    vec2 f = min(at - vec2(float(i), float(j)), 1.0);
    int here = first + j * (parts + 1) - j * (j - 1) / 2 + i, above = here + parts + 1 - j;
    bool last = i + j == parts - 1;
    if (last && f.x + f.y > 1.0) f = vec2(f.x / (f.x + f.y), f.y / (f.x + f.y));
    if (last || f.x + f.y <= 1.0)
      return About(ivec4(cornerAt(here), cornerAt(here + 1), cornerAt(above), 0), vec4(1.0 - f.x - f.y, f, 0.0));
    ivec3 others = ivec3(cornerAt(above + 1), cornerAt(above), cornerAt(here + 1));
    return About(ivec4(others, 0), vec4(f.x + f.y - 1.0, 1.0 - f, 0.0));
  }
#endif
  if (kind == 3) {
    vec4 grid = shapeRow(object, 10);
    vec2 far = (((place.point - shapeRow(object, 0).xyz) * turnOf(object)).xy - grid.xy) / grid.zw;
    return gridPlace((0.5 + 0.5 * vec2(warped(far.x), warped(far.y))) * size - 0.5, ivec2(size), false);
  }
  return gridPlace(place.uv * size - 0.5, ivec2(size), kind == 0);
}
vec4 lightOf(int first, About about, int number) {
  vec4 found = vec4(0.0);
  for (int i = 0; i < 4; i++) {
    int at = first + number + about.texel[i] * WIDE;
    found += about.weight[i] * texelFetch(uLight, ivec2(at % 2048, at / 2048), 0);
  }
  return found;
}
// What a surface sends of the light whose map begins at `first`.
Colour baked(int object, int first, About about, Surface surface) {
#if COLOURED
  mat4 light;
  for (int i = 0; i < 4; i++) light[i] = lightOf(first, about, i);
  return PRODUCT(surfaceColour(object, surface), light);
#else
  Colour out_ = vec3(0.0);
  for (int j = 0; j < KS; j++) out_ += surface.s[j] * lightOf(first, about, j).xyz;
  return out_;
#endif
}
#endif

// ---- lamps ----------------------------------------------------------------------------------------------------------

bool seesLamp(int object, Place place, Ray ray, float far, int triangle) {
  if (dot(place.normal, ray.d) <= 0.0 || dot(place.facet, ray.d) <= 0.0) return false;
  Hit hit = Hit(far, -1, -1, vec2(0.0));
  meet(ray, object, triangle, true, hit);
  return hit.object < 0;
}

// What light from one direction sends to the eye, a unit of irradiance that falls on the surface from above.
Colour sent(int lamp, Place place, vec3 view, vec3 to, Surface surface) {
  int object = place.side;
  float ground = dot(place.normal, to) * throughCoat(object, dot(place.normal, to)) * throughCoat(object, place.cosine);
  Colour sum_ = ground * lampDiffuse(object, lamp, surface);
#if PARTS > 0
  vec4 lobes = shapeRow(object, 7);
  for (int c = 0; c < 2; c++) {
    float power = surface.gloss[2 * c], cosH;
    if (lobes[c] < 0.0 || power <= 0.0) continue;
    float towards = dot(place.normal, to), shape = surface.gloss[2 * c + 1];
    float value = lobeValue(int(lobes[c]), shape, view, to, place.normal, place.cosine, towards, cosH);
#if COLOURED
    sum_ += value * power * PRODUCT(uLampColour[lamp], reflectance(object, cosH));
#else
    sum_ += value * power * uLampColour[lamp] * fresnel(cosH, shapeRow(object, 6).x, shapeRow(object, 6).y);
#endif
  }
#endif
  return sum_;
}

// What passes through a thin sheet: the row of its transmittance, -1 where nothing does, and its texel.
struct Passing { int row; Surface surface; };

// The cone in which a ball is seen: its axis and what stands across it, the cosine at its rim, the way to its middle.
struct Cone { vec3 axis, across, beside; float least, far; };

// A direction of the cone, and the way to the ball in it; `part` of the cone's solid angle lies within it.
vec3 inCone(Cone cone, float part, float turn, out float far) {
  float along = 1.0 - part * (1.0 - cone.least), sine = sqrt(max(1.0 - along * along, 0.0));
  far = cone.far * (along - sqrt(max(along * along - cone.least * cone.least, 0.0)));
  return along * cone.axis + sine * (cos(turn) * cone.across + sin(turn) * cone.beside);
}
// An even number of directions spread evenly over the cone: pairs on both sides of its axis, along Vogel's spiral. What
// one of a pair lies nearer to a normal the other lies farther from it, so without shadows the cosines' sum is exact.
vec3 spread_(Cone cone, int number, int count, out float far) {
  float pair = float(number / 2), turn = 0.61803398875 * pair + 0.5 * float(number % 2);
  return inCone(cone, (2.0 * pair + 1.0) / float(count), 2.0 * PI * fract(turn), far);
}

Colour lampLight(int object, int lamp, Place place, vec3 view, Surface surface, Passing passing, Hit met) {
  vec3 start = raised(place, shapeRow(object, 0).w), to = uLamp[lamp].xyz;
  float radius = uLamp[lamp].w, far = 1e30, level = uLampLevel[lamp];
  Cone cone;
  if (radius >= 0.0) {
    to -= start;
    far = length(to);
    to /= far;
    level /= far * far;
  }
  if (radius > 0.0) {
    float ratio = min(radius / far, 1.0);
    vec3 across = normalize(cross(to, abs(to.z) < 0.9 ? vec3(0.0, 0.0, 1.0) : vec3(1.0, 0.0, 0.0)));
    cone = Cone(to, across, cross(to, across), sqrt(1.0 - ratio * ratio), far);
    level *= 2.0 / (1.0 + cone.least);
  }
  // Few directions within a ball and as many to its rim, which an edge crosses, tell whether a part of it is hidden:
  // then many are asked. All in one loop, since drivers write out what stands in it as often as it stands there.
  int few = radius > 0.0 ? FEW : 1, asked = radius > 0.0 ? 2 * FEW : 1, free = 0;
  Colour whole = Colour(0.0), part = Colour(0.0);
  for (int i = 0; i < asked + MANY; i++) {
    if (i == asked && (free == 0 || free == asked)) break;
    if (radius > 0.0) {
      if (i < FEW) to = spread_(cone, i, FEW, far);
      else if (i < asked) to = inCone(cone, 0.9999, 2.0 * PI * float(i) / float(FEW), far);
      else to = spread_(cone, i - asked, MANY, far);
    }
    Place lit = place;
    vec3 from = start;
#if SHEETS
    bool behind = passing.row >= 0 && dot(place.normal, to) < 0.0 && dot(place.facet, to) < 0.0;
    if (behind) {
      lit.normal = -place.normal;
      lit.facet = -place.facet;
      from = raised(lit, shapeRow(object, 0).w);
    }
#endif
    if (!seesLamp(object, lit, Ray(from, to), far, met.triangle)) continue;
    if (i < asked) free++;
    if (i >= few && i < asked) continue;
    Colour one;
#if SHEETS
    if (behind) one = dot(lit.normal, to) * lampDiffuse(passing.row, lamp, passing.surface);
    else
#endif
      one = sent(lamp, place, view, to, surface);
    if (i < asked) whole += one;
    else part += one;
  }
  return free == asked ? level / float(few) * whole : level / float(MANY) * part;
}

// Light that a surface sends to the eye, without what its gloss shows of the light from all around.
Colour shade(Place place, Ray ray, Surface surface, Hit met) {
  Colour sum_ = Colour(0.0);
  float out_ = throughCoat(place.side, place.cosine);
  Passing passing = Passing(-1, surface);
#if SHEETS
  vec4 sheet = shapeRow(place.side, 11);
  if (sheet.y >= 0.0) passing = Passing(int(sheet.y), surfaceAt(int(sheet.y), place.uv));
#endif
#if BAKED
  if (uBaked) {
    About about = texelsAbout(place.side, place, met);
    sum_ += out_ * baked(place.side, int(shapeRow(place.side, 9).x), about, surface);
#if SHEETS
    if (passing.row >= 0) sum_ += baked(passing.row, int(sheet.z), about, passing.surface);
#endif
  } else
#endif
  {
#if HAS_LIGHT
    sum_ += out_ * diffuse(place.side, surface, irradianceAt(coatOf(place.side), place.normal));
#if SHEETS
    if (passing.row >= 0) sum_ += diffuse(passing.row, passing.surface, irradianceAt(0, -place.normal));
#endif
#endif
  }
  for (int lamp = 0; lamp < uLamps; lamp++)
    sum_ += lampLight(met.object, lamp, place, -ray.d, surface, passing, met);
  return sum_;
}

void main() {
  vec2 pixel = (gl_FragCoord.xy - 0.5 + uFirstPixel + vec2(0.5) - uFrame.xy) * uFrame.z;
  Ray ray = Ray(uEye, normalize(uWorldFromCamera * vec3(pixel, 1.0)));
  if (uParallel) ray = Ray(uEye + uWorldFromCamera * vec3(pixel, 0.0), uWorldFromCamera[2]);
  float width = uParallel ? uFrame.z : 0.0, spread = uParallel ? 0.0 : uFrame.z, through = 1.0;
  Colour sum_ = Colour(0.0);
#if COLOURED
  Colour passed = mat4(vec4(1.0), vec4(1.0), vec4(1.0), vec4(1.0));
#endif
  int own = -1, skip = -1;
#if PARTS > 0
  Gloss before; // of the surface whose mirrored ray is followed, and what its light has passed until there
  Colour passedBefore = Colour(1.0);
  before.object = -1;
#endif
  outXYZ = vec4(0.0, 0.0, 0.0, -1.0);
  outPlace = vec4(0.0, 0.0, -1.0, 0.0);
  outPoint = vec4(0.0);
  for (int bounce = 0; bounce <= BOUNCES + SEES; bounce++) {
    Hit hit = Hit(1e30, -1, -1, vec2(0.0));
    meet(ray, own, skip, false, hit);
    int object = hit.object;
    bool isMet = object >= 0, front = false;
    Place place;
    Surface surface;
    Colour sent = Colour(0.0);
    if (isMet) {
      front = placed(ray, hit, place);
      surface = surfaceAt(place.side, place.uv);
      if (front) sent = shade(place, ray, surface, hit);
    }
#if SEES
    if (before.object >= 0)
      for (int c = 0; c < 2; c++) sum_ += PRODUCT(passedBefore, lobeLight(before, c, isMet && uBaked, sent));
    if (bounce > BOUNCES || through <= uLeast) break;
#endif
    if (!isMet) {
#if HAS_LIGHT
#if COLOURED
      sum_ += PRODUCT(passed, decoded(skyAt(ray.d, spread)));
#else
      sum_ += through * decoded(skyAt(ray.d, spread));
#endif
#endif
      break;
    }
    if (bounce == 0) {
      outXYZ.w = float(place.side);
      outPlace = vec4(place.uv, surface.about);
      outPoint = vec4(place.point, 1.0);
    }
    if (!front) break;
    vec3 mirror = ray.d + 2.0 * place.cosine * place.normal;
    width += hit.t * spread;
#if COLOURED
    sum_ += PRODUCT(passed, sent);
#else
    Colour passed = Colour(through);
    sum_ += passed * sent;
#endif
#if PARTS > 0
    before = Gloss(place.side, surface.gloss, place.normal, mirror, place.cosine, through);
    passedBefore = passed;
#if !SEES
    for (int c = 0; c < 2; c++) sum_ += PRODUCT(passed, lobeLight(before, c, false, sent));
#endif
#endif
#if COLOURED
    passed = PRODUCT(passed, shapeRow(place.side, 6).z * reflectance(place.side, place.cosine));
    through = greatest(passed);
#else
    vec4 index = shapeRow(place.side, 6);
    through *= index.z * fresnel(place.cosine, index.x, index.y);
#endif
#if SEES
    if (through <= uLeast && max(surface.gloss.x, surface.gloss.z) * before.through <= uLeast / 4.0) break;
#else
    if (through <= uLeast) break;
#endif
    ray = Ray(raised(place, shapeRow(object, 0).w), mirror);
    spread += width * shapeRow(object, 4).z;
    own = object;
    skip = hit.triangle;
  }
#if COLOURED
  vec3 xyz = vec3(0.0); // what goes out has no index that is not constant
  for (int axis = 0; axis < 3; axis++)
    for (int i = 0; i < 4; i++) xyz[axis] += dot(uXYZFromColour[4 * axis + i], sum_[i]);
  outXYZ.xyz = xyz;
#else
  outXYZ.xyz = sum_;
#endif
}
