"use strict";
// Screens: what the page sends them for a colour. A screen is one of the header's by its name, given by measured
// primaries, or by its ICC profile: a matrix and tone curves.
window.Irodori = window.Irodori || {};
(function (I) {
  const D50 = [0.9642, 1, 0.8249],
    POINTS = 65,
    CODES = 1024;
  const inverse = (m) => I.inverse(m),
    sums = (m) => m.map((row) => row[0] + row[1] + row[2]);
  const times = (m, v) => m.map((row) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);
  const sRGB = (x) => (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055);
  // Codes are kept at even steps of a root of the light, over which they are nearly a straight line.
  const ROOT = 2.4;

  // Linear RGB of XYZ, the white that it shows (Y = 1), and the code of a channel's linear light.
  I.screen = function (given, displays) {
    if (given.profile) {
      const { xyz_from_rgb: matrix, codes } = given.profile;
      return {
        rgb_from_xyz: inverse(matrix),
        white_xyz: sums(matrix),
        code: (channel, x) => {
          const at = Math.min(POINTS - 1, x ** (1 / ROOT) * (POINTS - 1)),
            i = Math.min(POINTS - 2, Math.floor(at));
          return codes[channel][i] + (at - i) * (codes[channel][i + 1] - codes[channel][i]);
        },
      };
    }
    if (given.primaries) {
      const { red_xy, green_xy, blue_xy, white_xy, gamma } = given.primaries;
      const [r, g, b, w] = [red_xy, green_xy, blue_xy, white_xy].map(([x, y]) => [x / y, 1, (1 - x - y) / y]);
      const level = I.solved(
        [0, 1, 2].map((i) => [r[i], g[i], b[i]]),
        w,
      );
      const matrix = [0, 1, 2].map((i) => [r[i] * level[0], g[i] * level[1], b[i] * level[2]]);
      return { rgb_from_xyz: inverse(matrix), white_xyz: w, code: (_, x) => x ** (1 / gamma) };
    }
    return { ...(displays.find((one) => one.name === given.name) || displays[0]), code: (_, x) => sRGB(x) };
  };

  // Codes of the three channels at even steps of the root of linear light, four numbers a step.
  I.codeTable = function (screen) {
    const table = new Float32Array(4 * CODES);
    for (let i = 0; i < CODES; i++)
      for (let c = 0; c < 3; c++) table[4 * i + c] = screen.code(c, (i / (CODES - 1)) ** ROOT);
    return { data: table, width: CODES, height: 1 };
  };

  // ---- ICC.1:2022: profiles of a matrix and curves

  function refuse(file, found) {
    throw new I.Refusal("bad_profile", { file, found: I.text(found) });
  }

  // Linear light of a code, 0..1.
  function curveOf(view, start, file) {
    const kind = view.getUint32(start),
      fixed = (i) => view.getInt32(start + 12 + 4 * i) / 65536;
    if (kind === 0x70617261) {
      // para
      const number = view.getUint16(start + 8);
      if (number > 4) refuse(file, "profile_curve");
      const p = Array.from({ length: [1, 3, 4, 5, 7][number] }, (_, i) => fixed(i));
      const [g, a = 1, b = 0] = p,
        c = number > 2 ? p[3] : 0,
        d = number > 2 ? p[4] : number ? -b / a : -1;
      const [e, f] = number === 2 ? [p[3], p[3]] : number === 4 ? [p[5], p[6]] : [0, 0];
      return (x) => (x >= d ? Math.max(a * x + b, 0) ** g + e : c * x + f);
    }
    if (kind !== 0x63757276) refuse(file, "profile_curve"); // curv
    const count = view.getUint32(start + 8),
      value = (i) => view.getUint16(start + 12 + 2 * i);
    if (count < 2) {
      const power = count ? value(0) / 256 : 1;
      return (x) => x ** power;
    }
    value(count - 1);
    return (x) => {
      const at = x * (count - 1),
        i = Math.min(count - 2, Math.floor(at));
      return (value(i) + (at - i) * (value(i + 1) - value(i))) / 65535;
    };
  }

  // The code of linear light by halving, for a curve that rises from about 0 to about 1.
  function codeOf(curve, light) {
    let low = 0,
      high = 1;
    for (let i = 0; i < 30; i++) {
      const middle = (low + high) / 2;
      if (curve(middle) < light) low = middle;
      else high = middle;
    }
    return Number(((low + high) / 2).toFixed(5));
  }

  function read(bytes, file) {
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength),
      tags = {};
    if (view.getUint32(36) !== 0x61637370 || view.getUint32(0) > bytes.length) refuse(file, "profile_damaged");
    if (view.getUint32(12) !== 0x6d6e7472 || view.getUint32(16) !== 0x52474220) refuse(file, "profile_other");
    for (let i = 0, at = 132; i < Math.min(view.getUint32(128), 200); i++, at += 12) {
      tags[String.fromCharCode(...bytes.subarray(at, at + 4))] = view.getUint32(at + 4);
      if (view.getUint32(at + 4) + view.getUint32(at + 8) > bytes.length) refuse(file, "profile_damaged");
    }
    if (Object.keys(tags).some((name) => /^(A2B|B2A)/.test(name))) refuse(file, "profile_tables");
    const needed = ["rXYZ", "gXYZ", "bXYZ", "rTRC", "gTRC", "bTRC", "wtpt"];
    if (needed.some((name) => !(name in tags))) refuse(file, "profile_tables");
    const numbers = (name, count) =>
      Array.from({ length: count }, (_, i) => view.getInt32(tags[name] + 8 + 4 * i) / 65536);
    const columns = needed.slice(0, 3).map((name) => numbers(name, 3)),
      colorants = [0, 1, 2].map((i) => columns.map((one) => one[i]));
    if (sums(colorants).some((x, i) => !(Math.abs(x - D50[i]) < 0.02))) refuse(file, "profile_white");
    // Colorants are adapted to D50; the screen's own white is what `chad` says, or in version 2 `wtpt`, by Bradford.
    const bradford = [
      [0.8951, 0.2664, -0.1614],
      [-0.7502, 1.7135, 0.0367],
      [0.0389, -0.0685, 1.0296],
    ];
    let own;
    if ("chad" in tags) {
      const flat = numbers("chad", 9);
      own = I.product(inverse([0, 3, 6].map((i) => flat.slice(i, i + 3))), colorants);
    } else {
      const from = times(bradford, D50),
        to = times(bradford, numbers("wtpt", 3));
      own = I.product(
        I.product(
          inverse(bradford),
          bradford.map((row, i) => row.map((x) => (x * to[i]) / from[i])),
        ),
        colorants,
      );
    }
    const white = sums(own);
    if (!own.flat().every(Number.isFinite) || !white.every((x) => x > 0 && x < 10)) refuse(file, "profile_white");
    const curves = needed.slice(3, 6).map((name) => curveOf(view, tags[name], file));
    const codes = curves.map((curve) => {
      const steps = Array.from({ length: 256 }, (_, i) => curve(i / 255));
      if (
        !(Math.abs(steps[255] - 1) < 0.02) ||
        steps.some((x, i) => !Number.isFinite(x) || x < steps[Math.max(i - 1, 0)] - 1e-4)
      )
        refuse(file, "profile_curve");
      return Array.from({ length: POINTS }, (_, i) => codeOf(curve, (i / (POINTS - 1)) ** ROOT));
    });
    return {
      profile: {
        label: file.slice(0, 100),
        xyz_from_rgb: own.map((row) => row.map((x) => Number((x / white[1]).toPrecision(7)))),
        codes,
      },
    };
  }

  // The screen of an ICC profile as it stands in a state; refuses what is no matrix and curves.
  I.screenOfProfile = function (bytes, file) {
    try {
      return read(bytes, file);
    } catch (error) {
      if (error instanceof RangeError) refuse(file, "profile_damaged");
      throw error;
    }
  };

  I.PROFILE_POINTS = POINTS;
})(window.Irodori);
