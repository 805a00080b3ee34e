// From tristimulus values to what a display is sent: comparison of two lights, overlays, adaptation, tone curve.
precision highp float;
precision highp sampler2D;

out vec4 outColour;
uniform sampler2D uOne, uTwo, uPlace, uCodes;
uniform vec2 uCanvas;
uniform int uMode;        // 0 one light, 1 wipe, 2 difference, 3 each light against its own white
uniform int uOverlay;     // 0 none, 1 status, 2 uncertainty, 3 gamut
uniform float uAt;
uniform mat3 uShown, uShownTwo; // linear RGB of the display from XYZ, adapted, exposure included
uniform mat3 uDeficiency;       // on linear sRGB
uniform mat3 uDisplayFromSRGB, uSRGBFromDisplay;
uniform vec3 uWhite, uWhiteTwo;
uniform float uMostDifference, uMostUncertainty;

// The screen's codes of linear light, see screens.js.
vec3 encoded(vec3 linear) {
  int last = textureSize(uCodes, 0).x - 1;
  vec3 place = pow(clamp(linear, 0.0, 1.0), vec3(1.0 / 2.4)) * float(last), found;
  for (int c = 0; c < 3; c++) {
    int i = min(int(place[c]), last - 1);
    vec4 low = texelFetch(uCodes, ivec2(i, 0), 0), high = texelFetch(uCodes, ivec2(i + 1, 0), 0);
    found[c] = mix(low[c], high[c], place[c] - float(i));
  }
  return found;
}
float root3(float t) { return t <= 216.0 / 24389.0 ? (24389.0 / 27.0 * t + 16.0) / 116.0 : pow(t, 1.0 / 3.0); }
vec3 lab(vec3 xyz, vec3 white) {
  vec3 r = xyz / white, f = vec3(root3(r.x), root3(r.y), root3(r.z));
  return vec3(116.0 * f.y - 16.0, 500.0 * (f.x - f.y), 200.0 * (f.y - f.z));
}
float ciede2000(vec3 a, vec3 b) {
  const float TURN = 6.28318530718;
  float mean = 0.5 * (length(a.yz) + length(b.yz)), m7 = pow(mean, 7.0);
  float g = 0.5 * (1.0 - sqrt(m7 / (m7 + 6103515625.0)));
  a.y *= 1.0 + g;
  b.y *= 1.0 + g;
  float c1 = length(a.yz), c2 = length(b.yz), c = 0.5 * (c1 + c2);
  float h1 = c1 > 0.0 ? mod(atan(a.z, a.y) + TURN, TURN) : 0.0, h2 = c2 > 0.0 ? mod(atan(b.z, b.y) + TURN, TURN) : 0.0;
  float dh = h2 - h1;
  if (c1 * c2 == 0.0) dh = 0.0;
  else if (dh > 0.5 * TURN) dh -= TURN;
  else if (dh < -0.5 * TURN) dh += TURN;
  float h = h1 + h2;
  if (c1 * c2 > 0.0) h = abs(h1 - h2) <= 0.5 * TURN ? 0.5 * h : 0.5 * (h < TURN ? h + TURN : h - TURN);
  float t = 1.0 - 0.17 * cos(h - radians(30.0)) + 0.24 * cos(2.0 * h) + 0.32 * cos(3.0 * h + radians(6.0))
    - 0.2 * cos(4.0 * h - radians(63.0));
  float l = 0.5 * (a.x + b.x) - 50.0, c7 = pow(c, 7.0), hd = (degrees(h) - 275.0) / 25.0;
  float sl = 1.0 + 0.015 * l * l / sqrt(20.0 + l * l), sc = 1.0 + 0.045 * c, sh = 1.0 + 0.015 * c * t;
  float rt = -2.0 * sqrt(c7 / (c7 + 6103515625.0)) * sin(radians(60.0) * exp(-hd * hd));
  vec3 d = vec3((b.x - a.x) / sl, (c2 - c1) / sc, 2.0 * sqrt(c1 * c2) * sin(0.5 * dh) / sh);
  return sqrt(max(dot(d, d) + rt * d.y * d.z, 0.0));
}
vec3 scaleColour(float x) { // dark blue to yellow, even in lightness
  x = clamp(x, 0.0, 1.0);
  float red = 0.28 + x * (-0.35 + x * (0.35 + x * 0.71)), green = 0.01 + x * (1.4 - x * 0.5);
  float blue = 0.33 + x * (1.1 + x * (-2.9 + x * 1.6));
  return clamp(vec3(red, green, blue), 0.0, 1.0);
}

void main() {
  vec2 place = vec2(gl_FragCoord.x, uCanvas.y - gl_FragCoord.y) / uCanvas;
  vec4 one = texture(uOne, place), about = texelFetch(uPlace, ivec2(place * vec2(textureSize(uPlace, 0))), 0);
  bool second = uMode == 1 && place.x > uAt;
  vec3 xyz = second ? texture(uTwo, place).xyz : one.xyz;
  vec3 linear = (second ? uShownTwo : uShown) * xyz;
  linear = uDisplayFromSRGB * (uDeficiency * (uSRGBFromDisplay * linear));
  bool outside = any(lessThan(linear, vec3(-1e-3))) || any(greaterThan(linear, vec3(1.001)));
  vec3 shown = encoded(linear);
  if (uMode >= 2 && place.x > uAt) {
    vec3 other = texture(uTwo, place).xyz;
    float found = ciede2000(lab(one.xyz, uWhite), lab(other, uMode == 2 ? uWhite : uWhiteTwo));
    shown = scaleColour(found / uMostDifference);
  }
  if (uMode != 0 && uAt > 0.0 && abs(place.x - uAt) * uCanvas.x < 1.0) shown = vec3(1.0);
  float grey = dot(shown, vec3(0.2126, 0.7152, 0.0722));
  bool stripe = mod(gl_FragCoord.x + gl_FragCoord.y, 8.0) < 4.0;
  if (uOverlay == 1 && about.z >= 0.0) {
    int status = int(about.z + 0.5);
    vec3 tint = status == 0 ? vec3(grey)
      : status == 1 ? vec3(0.2, 0.5, 1.0)
      : status == 2 ? vec3(1.0, 0.6, 0.0)
      : vec3(0.8, 0.0, 0.5);
    shown = status == 0 ? vec3(grey) : mix(vec3(grey), tint, stripe ? 0.8 : 0.5);
  }
  if (uOverlay == 2 && about.z >= 0.0) shown = scaleColour(about.w / uMostUncertainty);
  if (uOverlay == 3 && outside) shown = stripe ? vec3(1.0, 0.0, 1.0) : vec3(grey);
  outColour = vec4(shown, 1.0);
}
