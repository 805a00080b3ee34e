// Spectra and their transport to tristimulus values: its constants for one light, observer and set of lamps. A change
// of any of these changes these numbers and nothing else.
"use strict";
var Irodori = Irodori || {};

// The materials of a page: those of its objects, then the backs and the transmittances of thin sheets; these have the
// shape and the place of their front, whose number is `of`.
Irodori.surfaces = function (header) {
  return [...header.objects, ...header.sides.map((side) => ({ ...header.objects[side.of], ...side }))];
};

Irodori.Spectra = class {
  constructor(data) {
    this.header = data.header;
    this.planes = data.planes;
    this.count = 61;
    const rows = (plane, n) => Array.from({ length: n }, (_, i) => plane.subarray(61 * i, 61 * i + 61));
    this.lights = data.header.environments.map((_, i) => {
      const basis = this.planes["light/" + i + "/basis"];
      return { basis: rows(basis, basis.length / 61), white: this.planes["light/" + i + "/white"] };
    });
    this.objects = Irodori.surfaces(data.header).map((entry, i) => {
      const plane = (name) => this.planes["object/" + i + "/" + name];
      return { basis: rows(plane("basis"), entry.bases), index: rows(plane("index"), 2) };
    });
  }

  named(list, name, what) {
    const found = list.find((entry) => entry.name === name);
    if (!found)
      throw new Error("The " + what + ": found " + name + "; accepted: " + list.map((e) => e.name).join(", ") + ".");
    return found;
  }

  // Relative power of {name}, {cct_K} or {power}, 61 numbers.
  power(illuminant) {
    if (illuminant === null || illuminant === undefined) illuminant = { name: "D65" };
    if (illuminant.power) {
      const power = illuminant.power;
      const isOne =
        power.length === 61 && Array.from(power).every((x) => Number.isFinite(x) && x >= 0) && power.some((x) => x > 0);
      if (!isOne) throw new Error("A light's power: found other numbers; accepted: 61 numbers from 0 on, not all 0.");
      return Float64Array.from(power);
    }
    if (illuminant.cct_K !== undefined) return this.temperature(Number(illuminant.cct_K));
    return Float64Array.from(this.named(this.header.illuminants, illuminant.name, "light").power);
  }

  // CIE daylight from 4000 K on, a blackbody under it.
  temperature(kelvin) {
    if (!(kelvin >= 1000 && kelvin <= 25000))
      throw new Error("A colour temperature: found " + kelvin + "; accepted: 1000 to 25000 K.");
    const out = new Float64Array(61);
    if (kelvin < 4000) {
      for (let i = 0; i < 61; i++) {
        const metres = (400 + 5 * i) * 1e-9;
        out[i] = (1e-13 / (Math.pow(metres, 5) * Math.expm1(0.014387769 / (metres * kelvin)))) * 1e-18;
      }
      return out;
    }
    const t = kelvin,
      x =
        t <= 7000
          ? -4.607e9 / t ** 3 + 2.9678e6 / t ** 2 + 99.11 / t + 0.244063
          : -2.0064e9 / t ** 3 + 1.9018e6 / t ** 2 + 247.48 / t + 0.23704;
    const y = -3 * x * x + 2.87 * x - 0.275,
      m = 0.0241 + 0.2562 * x - 0.7341 * y;
    const m1 = (-1.3515 - 1.7703 * x + 5.9114 * y) / m,
      m2 = (0.03 - 31.4424 * x + 30.0717 * y) / m;
    const [s0, s1, s2] = this.header.daylight;
    for (let i = 0; i < 61; i++) out[i] = Math.max(s0[i] + m1 * s1[i] + m2 * s2[i], 0);
    return out;
  }

  luminance(spectrum) {
    const xyz = this.header.observers[0].xyz;
    let sum = 0;
    for (let i = 0; i < 61; i++) sum += xyz[i][1] * spectrum[i];
    return sum;
  }

  // Whether the light of an environment has power at each wavelength: less than 1e-4 of its peak is noise, which no
  // factor makes light. `irodori.viewer.stage` compares the page with the renderer by the same rule.
  lit(light) {
    const least = 1e-4 * Math.max(...light.white);
    return Array.from(light.white, (x) => x > least);
  }

  // Wavelengths, nm, at which an exchanged illuminant has power and the light of its environment has none.
  missing({ environment, illuminant }) {
    const light = this.lights[Math.max(this.header.environments.indexOf(environment), 0)];
    if (!illuminant || !light || !(Math.max(...light.white) > 0)) return [];
    const power = this.power(illuminant),
      has = this.lit(light);
    return this.header.wavelength_nm.filter((_, i) => !has[i] && power[i] > 0);
  }

  // Factor on the light of an environment that gives its white another spectrum of the same luminance.
  ratio(light, illuminant) {
    const out = new Float64Array(61).fill(1);
    if (illuminant === null || illuminant === undefined) return out;
    const power = this.power(illuminant),
      scale = this.luminance(light.white) / this.luminance(power);
    const has = this.lit(light);
    for (let i = 0; i < 61; i++) out[i] = has[i] ? (power[i] * scale) / light.white[i] : 0;
    return out;
  }

  // Irradiance of a lamp of strength 1 on a surface that faces it.
  lampSpectrum(lamp) {
    const power = this.power(lamp.illuminant),
      scale = (Math.PI * this.header.unit_luminance) / this.luminance(power);
    return power.map((x) => x * scale);
  }

  // All that depends on spectra: see `forms` and `quadrature`.
  constants(part, observerName, isRGB) {
    const number = Math.max(this.header.environments.indexOf(part.environment), 0);
    const light = this.lights[number],
      lamps = (part.lamps || []).filter((lamp) => lamp.on !== false);
    const ratio = this.ratio(light, part.illuminant);
    const basis = light.basis.map((row) => row.map((x, i) => x * ratio[i]));
    const spectra = lamps.map((lamp) => this.lampSpectrum(lamp));
    let white = Float64Array.from(light.white, (x, i) => x * ratio[i]);
    lamps.forEach((lamp, l) => {
      const p = lamp.position_mm,
        far = Math.hypot(p[0], p[1], p[2]) || 1,
        fall = lamp.far ? 1 : (500 / far) ** 2;
      const factor = (lamp.strength * Math.max(p[2] / far, 0) * fall) / Math.PI;
      white = white.map((x, i) => x + factor * spectra[l][i]);
    });
    // Light from under the horizon alone leaves no white: then it is what the lamps give a surface that faces them.
    if (!(Math.max(...white) > 0)) white = white.map((_, i) => spectra.reduce((sum, s) => sum + s[i] / Math.PI, 0));
    const weights = this.named(this.header.observers, observerName, "observer").xyz;
    let level = 0;
    for (let i = 0; i < 61; i++) level += weights[i][1] * white[i];
    const matrix = [0, 1, 2].map((c) => weights.map((row) => row[c] * (level > 0 ? 100 / level : 0)));
    const xyz = (spectrum) => matrix.map((row) => row.reduce((sum, w, i) => sum + w * spectrum[i], 0));
    const found = { number, lamps, basis, spectra, white, matrix, xyz, whiteXYZ: xyz(white) };
    if (isRGB) found.rgb = this.products(found);
    return found;
  }

  // Linear sRGB of spectra of light, and of surfaces under the white, as a plain renderer multiplies them.
  products(constants) {
    const fromXYZ = this.header.displays[0].rgb_from_xyz;
    const rgb = (xyz) => fromXYZ.map((row) => row[0] * xyz[0] + row[1] * xyz[1] + row[2] * xyz[2]);
    const white = rgb(constants.whiteXYZ);
    return {
      light: (spectrum) => rgb(constants.xyz(spectrum)),
      surface: (s) => rgb(constants.xyz(constants.white.map((x, i) => x * s[i]))).map((x, c) => x / white[c]),
      back: Irodori.inverse(fromXYZ),
    };
  }

  // XYZ of light times surface; as a plain renderer computes it where the constants are those of one.
  pair(constants, light, surface) {
    if (!constants.rgb) return constants.xyz(Array.from(light, (x, i) => x * surface[i]));
    const a = constants.rgb.light(light),
      b = constants.rgb.surface(surface);
    return constants.rgb.back.map((row) => row.reduce((sum, x, i) => sum + x * a[i] * b[i], 0));
  }

  // XYZ of light times surface for every pair of their vectors: rows and columns as the shader reads them.
  forms(constants, width, rows) {
    const n = this.objects.length,
      out = new Float32Array(4 * width * rows),
      KS = this.widest;
    const put = (row, column, xyz) => out.set(xyz, 4 * (row * width + column));
    this.objects.forEach((object, o) =>
      object.basis.forEach((surface, j) => {
        constants.basis.forEach((light, i) => put(o, i * KS + j, this.pair(constants, light, surface)));
        constants.spectra.forEach((light, l) =>
          put(
            n + l * n + o,
            j,
            this.pair(constants, light, surface).map((x) => x / Math.PI),
          ),
        );
      }),
    );
    return out;
  }

  get widest() {
    return Math.max(...this.objects.map((object) => object.basis.length));
  }

  // Up to 16 numbers that stand for a spectrum where mirrors have colours: wavelengths and their weights.
  channels(constants) {
    if (constants.rgb) {
      const of = constants.rgb.light,
        fromXYZ = this.header.displays[0].rgb_from_xyz;
      const weight = fromXYZ.map((row) =>
        constants.white.map((w, i) =>
          Math.abs(w * [0, 1, 2].reduce((sum, c) => sum + row[c] * constants.matrix[c][i], 0)),
        ),
      );
      const mean = (values) =>
        weight.map((w) => w.reduce((sum, x, i) => sum + x * values[i], 0) / w.reduce((sum, x) => sum + x, 0));
      return { light: of, surface: constants.rgb.surface, index: mean, xyz: constants.rgb.back };
    }
    const { samples } = this.header.quadrature[constants.number],
      moments = this.planes["quadrature/" + constants.number + "/moments"],
      n = samples.length;
    const light = this.lights[constants.number];
    const ratio = constants.white.map((x, i) => (light.white[i] > 0 ? x / light.white[i] : 1));
    const moment = (a, b) => moments[61 * a + b] * ratio[a] * ratio[b];
    const gram = samples.map((a) => samples.map((b) => moment(a, b)));
    const trace = gram.reduce((sum, row, i) => sum + row[i], 0);
    gram.forEach((row, i) => (row[i] += (1e-9 * trace) / n));
    const xyz = constants.matrix.map((row) =>
      Irodori.solved(
        gram,
        samples.map((a) => row.reduce((sum, w, i) => sum + w * moment(a, i), 0)),
      ),
    );
    const at = (values) => samples.map((s) => values[s]);
    return { light: at, surface: at, index: at, xyz };
  }
};

// The solution of a small system of linear equations, by elimination with pivots.
Irodori.solved = function (matrix, right) {
  const a = matrix.map((row, i) => [...row, right[i]]),
    n = a.length;
  for (let i = 0; i < n; i++) {
    let best = i;
    for (let r = i + 1; r < n; r++) if (Math.abs(a[r][i]) > Math.abs(a[best][i])) best = r;
    [a[i], a[best]] = [a[best], a[i]];
    for (let r = i + 1; r < n; r++) {
      const factor = a[r][i] / a[i][i];
      for (let c = i; c <= n; c++) a[r][c] -= factor * a[i][c];
    }
  }
  const x = new Array(n).fill(0);
  for (let i = n - 1; i >= 0; i--) {
    let sum = a[i][n];
    for (let c = i + 1; c < n; c++) sum -= a[i][c] * x[c];
    x[i] = sum / a[i][i];
  }
  return x;
};
Irodori.inverse = function (m) {
  const columns = [0, 1, 2].map((c) =>
    Irodori.solved(
      m,
      [0, 1, 2].map((r) => (r === c ? 1 : 0)),
    ),
  );
  return [0, 1, 2].map((r) => columns.map((column) => column[r]));
};
Irodori.product = function (a, b) {
  return a.map((row) => [0, 1, 2].map((c) => row[0] * b[0][c] + row[1] * b[1][c] + row[2] * b[2][c]));
};
// CAT16, full adaptation, from one white to another, both XYZ.
Irodori.adaptation = function (from, to) {
  const cones = [
    [0.401288, 0.650173, -0.051461],
    [-0.250268, 1.204414, 0.045854],
    [-0.002079, 0.048952, 0.953127],
  ];
  const of = (xyz) => cones.map((row) => row[0] * xyz[0] + row[1] * xyz[1] + row[2] * xyz[2]);
  const a = of(from),
    b = of(to);
  return Irodori.product(
    Irodori.inverse(cones),
    cones.map((row, i) => row.map((x) => (x * b[i]) / a[i])),
  );
};
