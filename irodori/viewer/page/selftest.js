// The page's own check: small frames that the product's renderer made on a processor, drawn again here.
"use strict";
var Irodori = Irodori || {};

Irodori.lab = function (xyz, white) {
  const f = xyz
    .map((x, i) => x / white[i])
    .map((t) => (t <= 216 / 24389 ? ((24389 / 27) * t + 16) / 116 : Math.cbrt(t)));
  return [116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])];
};

Irodori.ciede2000 = function (one, two) {
  const turn = 2 * Math.PI,
    degree = Math.PI / 180,
    seventh = (x) => Math.sqrt(x ** 7 / (x ** 7 + 25 ** 7));
  const stretch = 1.5 - 0.5 * seventh(0.5 * (Math.hypot(one[1], one[2]) + Math.hypot(two[1], two[2])));
  const [a, b] = [one, two].map(([l, x, y]) => {
    const hue = Math.atan2(y, x * stretch);
    return { l, c: Math.hypot(x * stretch, y), h: hue < 0 ? hue + turn : hue };
  });
  const grey = a.c * b.c === 0,
    c = 0.5 * (a.c + b.c);
  let dh = grey ? 0 : b.h - a.h,
    h = a.h + b.h;
  if (dh > Math.PI) dh -= turn;
  else if (dh < -Math.PI) dh += turn;
  if (!grey) h = Math.abs(a.h - b.h) <= Math.PI ? h / 2 : h < turn ? (h + turn) / 2 : (h - turn) / 2;
  const t =
    1 -
    0.17 * Math.cos(h - 30 * degree) +
    0.24 * Math.cos(2 * h) +
    0.32 * Math.cos(3 * h + 6 * degree) -
    0.2 * Math.cos(4 * h - 63 * degree);
  const l = (0.5 * (a.l + b.l) - 50) ** 2,
    around = Math.exp(-(((h / degree - 275) / 25) ** 2));
  const dl = (b.l - a.l) / (1 + (0.015 * l) / Math.sqrt(20 + l)),
    dc = (b.c - a.c) / (1 + 0.045 * c);
  const dt = (2 * Math.sqrt(a.c * b.c) * Math.sin(dh / 2)) / (1 + 0.015 * c * t);
  return Math.sqrt(
    Math.max(dl * dl + dc * dc + dt * dt - 2 * seventh(c) * Math.sin(60 * degree * around) * dc * dt, 0),
  );
};

// Rows of the table of checks: what was drawn, CIEDE2000 to the product's renderer, and how long it took here.
Irodori.selftest = async function (renderer) {
  const { header, planes } = renderer.data,
    rows = [];
  for (const [number, check] of (header.selftest || []).entries()) {
    const state = renderer.defaultState(),
      [height, width] = check.size;
    Object.assign(state.light, check.light);
    state.observer = check.observer;
    await renderer.findLight(state);
    const start = performance.now(),
      xyz = renderer.readXYZ(state, width, height),
      wanted = planes["selftest/" + number];
    const milliseconds = performance.now() - start,
      white = renderer.lit.whiteXYZ,
      found = [];
    for (let i = 0; i < width * height; i++)
      found.push(
        Irodori.ciede2000(
          Irodori.lab(
            [0, 1, 2].map((c) => wanted[3 * i + c]),
            white,
          ),
          Irodori.lab(
            [0, 1, 2].map((c) => xyz[4 * i + c]),
            white,
          ),
        ),
      );
    found.sort((p, q) => p - q);
    rows.push({
      environment: check.light.environment,
      turn_deg: check.light.turn_deg,
      illuminant: check.light.illuminant ? check.light.illuminant.name : null,
      observer: check.observer,
      mean: found.reduce((sum, x) => sum + x, 0) / found.length,
      p99: found[Math.floor(0.99 * (found.length - 1))],
      milliseconds,
    });
  }
  return rows;
};
