"use strict";
// The whole picture as plain values, and as the part of an address behind the #.
//
// page = {step: number or null, state: of the renderer, compare: {mode, other, at} or null,
//         probes: [{surface: its number, texel: [row, column], position_mm}], ruler: points in mm}
window.Irodori = window.Irodori || {};
(function (I) {
  const MODES = ["wipe", "difference", "metamerism", "rgb"];
  const OVERLAYS = ["status", "uncertainty", "gamut"];
  const DEFICIENCIES = ["protan", "deutan", "tritan"];
  const FAR = 1e6,
    MOST_STEPS = 100;
  I.choices = { modes: MODES, overlays: OVERLAYS, deficiencies: DEFICIENCIES };

  I.clone = (value) => JSON.parse(JSON.stringify(value));
  I.newPage = (state) => ({ step: null, state: I.clone(state), compare: null, probes: [], ruler: [] });

  const isBlock = (value) => value !== null && typeof value === "object" && !Array.isArray(value);
  const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);
  const rounded = (key, value) => (typeof value === "number" ? Number(value.toPrecision(7)) : value);

  // Blocks of several forms, which are never mixed.
  const WHOLE = ["display", "illuminant"];

  // What differs from the way the page opens; blocks key by key, everything else whole.
  function difference(value, base) {
    if (!isBlock(value) || !isBlock(base)) return value;
    const found = {};
    for (const key of Object.keys(value))
      if (!same(value[key], base[key]))
        found[key] = WHOLE.includes(key) ? value[key] : difference(value[key], base[key]);
    return found;
  }

  function laidOver(base, given, path) {
    if (!isBlock(base)) return given;
    keys(path.slice(0, -1), given, Object.keys(base));
    const made = I.clone(base);
    for (const key of Object.keys(given))
      made[key] = WHOLE.includes(key) ? given[key] : laidOver(base[key], given[key], path + key + ".");
    return made;
  }

  I.pageToHash = function (page, base) {
    const text = JSON.stringify(difference(JSON.parse(JSON.stringify(page, rounded)), base));
    const bytes = String.fromCharCode(...new TextEncoder().encode(text));
    return "v1." + btoa(bytes).replace(/\+/g, "-").replace(/\//g, "_").replace(/=+$/, "");
  };

  // The lesson is the one that is shown, of which a page may be a step.
  I.hashToPage = function (hash, base, header, lesson) {
    let given;
    try {
      if (!hash.startsWith("v1.")) throw new Error("another version");
      const bytes = atob(hash.slice(3).replace(/-/g, "+").replace(/_/g, "/"));
      given = JSON.parse(
        new TextDecoder("utf-8", { fatal: true }).decode(Uint8Array.from(bytes, (c) => c.charCodeAt(0))),
      );
    } catch (error) {
      throw new I.Refusal("bad_address");
    }
    if (!isBlock(given)) throw new I.Refusal("bad_address");
    const page = laidOver(base, given, ""),
      steps = lesson?.steps.length ?? 0;
    if (page.step !== null) whole("step", page.step, MOST_STEPS);
    // A step that a teacher has added is in that page alone; the picture is shown all the same.
    if (page.step >= steps) page.step = null;
    return I.checkedPage(page, base, header);
  };

  function refusal(field, found, accepted) {
    const shown = (JSON.stringify(found) ?? "nothing").slice(0, 60);
    return new I.Refusal("bad_state", { field: field, found: shown, accepted: accepted });
  }

  function number(field, value, low, high) {
    const inside = typeof value === "number" && value >= low && value <= high;
    if (!inside) throw refusal(field, value, `${low} … ${high}`);
  }

  // A number of one of so many.
  function whole(field, value, count) {
    number(field, value, 0, count - 1);
    if (!Number.isInteger(value)) throw refusal(field, value, `0, 1 … ${count - 1}`);
  }

  function numbers(field, value, count, low, high) {
    if (!Array.isArray(value) || value.length !== count) throw refusal(field, value, `${count} × ${low} … ${high}`);
    value.forEach((one, index) => number(`${field}[${index}]`, one, low, high));
  }

  function list(field, value, most) {
    if (!Array.isArray(value) || value.length > most) throw refusal(field, value, `0 … ${most}`);
  }

  function choice(field, value, names) {
    if (!names.includes(value)) throw refusal(field, value, names.slice(0, 8).join(", "));
  }

  function yes(field, value) {
    if (typeof value !== "boolean") throw refusal(field, value, "true, false");
  }

  function keys(field, value, known) {
    if (!isBlock(value)) throw refusal(field, value, known.join(", "));
    for (const key of Object.keys(value))
      if (!known.includes(key)) throw refusal(field ? `${field}.${key}` : key, value[key], known.join(", "));
  }

  // The keys of a block that has one of several forms, each named after its first key.
  function formOf(value, forms) {
    const form = isBlock(value) && Object.keys(forms).find((key) => key in value);
    return form ? forms[form] : Object.keys(forms);
  }

  function illuminant(field, value, header) {
    if (value === null) return;
    keys(field, value, formOf(value, { name: ["name"], cct_K: ["cct_K"], power: ["power", "label"] }));
    if ("name" in value)
      choice(
        field + ".name",
        value.name,
        header.illuminants.map((one) => one.name),
      );
    else if ("cct_K" in value) number(field + ".cct_K", value.cct_K, 1700, 25000);
    else {
      numbers(field + ".power", value.power, 61, 0, FAR);
      if (!value.power.some((one) => one > 0)) throw refusal(field + ".power", 0, "> 0");
      const letters = typeof value.label === "string" ? [...value.label].length : 0;
      if (letters < 1 || letters > 100) throw refusal(field + ".label", value.label, "a name");
    }
  }

  function light(field, value, header) {
    keys(field, value, ["environment", "turn_deg", "illuminant", "lamps"]);
    choice(field + ".environment", value.environment, header.environments.length ? header.environments : [null]);
    number(field + ".turn_deg", value.turn_deg, -36000, 36000);
    illuminant(field + ".illuminant", value.illuminant, header);
    list(field + ".lamps", value.lamps, I.LAMPS);
    value.lamps.forEach((lamp, index) => {
      const at = `${field}.lamps[${index}]`;
      keys(at, lamp, ["position_mm", "size_mm", "strength", "illuminant", "on", "far"]);
      numbers(at + ".position_mm", lamp.position_mm, 3, -FAR, FAR);
      number(at + ".size_mm", lamp.size_mm, 0, 1e4);
      number(at + ".strength", lamp.strength, 0, 1000);
      illuminant(at + ".illuminant", lamp.illuminant, header);
      yes(at + ".on", lamp.on);
      yes(at + ".far", lamp.far);
    });
  }

  // On which side of the line from a to b a point lies, by its sign.
  const side = (point, a, b) => (b[0] - a[0]) * (point[1] - a[1]) - (b[1] - a[1]) * (point[0] - a[0]);

  // Refuse primaries of a screen that do not enclose its white.
  I.checkPrimaries = function (field, value) {
    keys(field, value, ["red_xy", "green_xy", "blue_xy", "white_xy", "gamma"]);
    for (const one of ["red_xy", "green_xy", "blue_xy", "white_xy"])
      numbers(`${field}.${one}`, value[one], 2, 0.0001, 0.9);
    number(field + ".gamma", value.gamma, 1, 4);
    const corners = [value.red_xy, value.green_xy, value.blue_xy],
      sides = corners.map((a, i) => Math.sign(side(value.white_xy, a, corners[(i + 1) % 3])));
    if (Math.abs(sides[0] + sides[1] + sides[2]) !== 3)
      throw refusal(field + ".white_xy", value.white_xy, I.text("enclosed_white"));
  };

  function display(field, value, header) {
    keys(field, value, formOf(value, { profile: ["profile"], primaries: ["primaries"], name: ["name"] }));
    if ("profile" in value) {
      keys(field + ".profile", value.profile, ["label", "xyz_from_rgb", "codes"]);
      if (typeof value.profile.label !== "string" || value.profile.label.length > 100)
        throw refusal(field + ".profile.label", value.profile.label, "a name");
      for (const [key, count, low, high] of [
        ["xyz_from_rgb", 3, -10, 10],
        ["codes", I.PROFILE_POINTS, 0, 1],
      ]) {
        if (!Array.isArray(value.profile[key]) || value.profile[key].length !== 3)
          throw refusal(`${field}.profile.${key}`, value.profile[key], `3 × ${count}`);
        value.profile[key].forEach((row, i) => numbers(`${field}.profile.${key}[${i}]`, row, count, low, high));
      }
      return undefined;
    }
    if ("primaries" in value) return I.checkPrimaries(field + ".primaries", value.primaries);
    return choice(
      field + ".name",
      value.name,
      header.displays.map((one) => one.name),
    );
  }

  // Return a page after a look at every value, or refuse it in one sentence.
  I.checkedPage = function (page, base, header) {
    const state = page.state;
    numbers("camera.target_mm", state.camera.target_mm, 3, -FAR, FAR);
    number("camera.azimuth_deg", state.camera.azimuth_deg, -36000, 36000);
    number("camera.elevation_deg", state.camera.elevation_deg, -90, 90);
    number("camera.distance_mm", state.camera.distance_mm, 1, FAR);
    number("camera.fov_deg", state.camera.fov_deg, 1, 120);
    number("camera.roll_deg", state.camera.roll_deg, -36000, 36000);
    number("camera.height_mm", state.camera.height_mm, 0, FAR);
    light("light", state.light, header);
    const names = base.state.objects.map((one) => one.name);
    if (!Array.isArray(state.objects) || state.objects.length !== names.length)
      throw refusal("objects", state.objects, names.join(", "));
    state.objects.forEach((one, index) => {
      const at = `objects[${index}]`;
      keys(at, one, Object.keys(base.state.objects[index]));
      choice(at + ".name", one.name, [names[index]]);
      numbers(at + ".position_mm", one.position_mm, 3, -FAR, FAR);
      numbers(at + ".turn_deg", one.turn_deg, 3, -36000, 36000);
      yes(at + ".visible", one.visible);
    });
    choice(
      "observer",
      state.observer,
      header.observers.map((one) => one.name),
    );
    choice("deficiency", state.deficiency, [null, ...DEFICIENCIES]);
    choice("overlay", state.overlay, [null, ...OVERLAYS]);
    number("exposure_ev", state.exposure_ev, -10, 10);
    display("display", state.display, header);
    if (page.compare !== null) {
      keys("compare", page.compare, ["mode", "other", "at"]);
      choice("compare.mode", page.compare.mode, MODES);
      light("compare.other", page.compare.other, header);
      number("compare.at", page.compare.at, 0, 1);
    }
    list("ruler", page.ruler, 2);
    page.ruler.forEach((one, index) => numbers(`ruler[${index}]`, one, 3, -FAR, FAR));
    list("probes", page.probes, 2);
    page.probes.forEach((one, index) => {
      const at = `probes[${index}]`,
        sides = header.objects.flatMap(({ behind }, i) => [i, behind ?? i]);
      keys(at, one, ["surface", "texel", "position_mm"]);
      choice(at + ".surface", one.surface, sides);
      numbers(at + ".position_mm", one.position_mm, 3, -FAR, FAR);
      if (!Array.isArray(one.texel) || one.texel.length !== 2) throw refusal(at + ".texel", one.texel, "2 × 0, 1 …");
      I.surfaces(header)[one.surface].texels.forEach((count, i) => whole(`${at}.texel[${i}]`, one.texel[i], count));
    });
    return page;
  };

  // ---- spectra of light in files

  // The value at a place between points [place, value] of increasing places, by straight lines.
  I.onLine = function (points, at) {
    const next = points.findIndex(([place]) => place > at),
      i = next < 0 ? points.length - 1 : Math.max(next, 1),
      [a, b] = [points[i - 1], points[i]];
    return a[1] + ((b[1] - a[1]) * (at - a[0])) / (b[0] - a[0]);
  };

  // The mean of straight lines between points over a triangle of this half width about a place, as `_average_matrix` of
  // irodori/spectra/resampling.py computes it.
  function triangleMean(points, at, half) {
    const inside = points.map(([place]) => place).filter((place) => Math.abs(place - at) < half && place !== at);
    const knots = [at - half, ...inside, at, at + half].sort((a, b) => a - b);
    const weighted = (place) => I.onLine(points, place) * (1 - Math.abs(place - at) / half);
    // Line times line is a parabola, for which Simpson's rule is exact.
    const parts = knots.slice(1).map((b, i) => {
      const a = knots[i];
      return ((b - a) * (weighted(a) + 4 * weighted((a + b) / 2) + weighted(b))) / 6;
    });
    return parts.reduce((sum, one) => sum + one, 0) / half;
  }

  // Sprague's interpolation between points [place, value] of even steps, as `_sprague_matrix` of
  // irodori/spectra/resampling.py computes it: a polynomial through six values, of which two beyond each end are made
  // of the first or the last six (CIE 167:2005).
  const POLYNOMIAL = [
    [0, 0, 24, 0, 0, 0],
    [2, -16, 0, 16, -2, 0],
    [-1, 16, -30, 16, -1, 0],
    [-9, 39, -70, 66, -33, 7],
    [13, -64, 126, -124, 61, -12],
    [-5, 25, -50, 50, -25, 5],
  ];
  const ENDS = [
    [884, -1960, 3033, -2648, 1080, -180],
    [508, -540, 488, -367, 144, -24],
  ];
  const inner = (a, b) => a.reduce((sum, x, i) => sum + x * b[i], 0);

  function sprague(points, at) {
    const values = points.map(([, value]) => value),
      beyond = (six) => ENDS.map((row) => inner(row, six) / 209),
      all = [...beyond(values), ...values, ...beyond(values.slice(-6).reverse()).reverse()],
      last = points.length - 1,
      place = (last * (at - points[0][0])) / (points[last][0] - points[0][0]),
      first = Math.min(Math.floor(place), last - 1),
      around = all.slice(first, first + 6);
    return POLYNOMIAL.reduceRight((sum, row) => sum * (place - first) + inner(row, around) / 24, 0);
  }

  // Rows of wavelength in nm and power, by increasing wavelength. Cells are separated by semicolons or white space, and
  // may then have decimal commas, or else by commas; lines that begin with no number are words.
  function tableRows(text, label) {
    const all = text.replace(/^\uFEFF/, "").split(/\r?\n/),
      lines = all.filter((line) => /^\s*[-+.\d]/.test(line));
    // The same words as in irodori/spectra/spectral_files.py.
    const photons = /(^|[^a-z])(photons?(flux)?|quanta|quantum flux|[uµμ]mol|micromol)(?![a-z])/i,
      words = all.find((line) => !lines.includes(line) && photons.test(line));
    if (words !== undefined)
      throw new I.Refusal("bad_table_photons", { file: label, found: words.trim().slice(0, 40) });
    const rows = lines.map((line) => {
      const filled = line.trim().replace(/[,;\s]+$/, ""), // a spreadsheet's empty columns are cut off
        cells = filled.split(/[;\s]+/).map((cell) => cell.replace(/,$/, ""));
      return cells.length > 1 ? cells : filled.split(",");
    });
    const hasCommas = rows.some((row) => row.some((cell) => cell.includes(",")));
    const numbers = rows.map((row, i) => {
      const pair = row.map((cell) => (hasCommas && cell.includes(".") ? NaN : Number(cell.replace(",", "."))));
      if (pair.length !== 2 || row.includes("") || !pair.every(Number.isFinite))
        throw new I.Refusal("bad_table_row", { file: label, found: lines[i].slice(0, 40) });
      return pair;
    });
    numbers.sort((a, b) => a[0] - b[0]);
    const twice = numbers.find(([nm], i) => i > 0 && nm === numbers[i - 1][0]);
    if (twice) throw new I.Refusal("bad_table_twice", { file: label, nm: twice[0] });
    return numbers;
  }

  // The step as in irodori/spectra/tables.py; the noise under 0, as a share of the peak, as in spectral_files.py there.
  const MOST_STEP_NM = 20,
    NOISE = 0.01;

  // A table of wavelength in nm and power, at 400, 405, ... 700 nm.
  I.powerOfTable = function (text, label) {
    const rows = tableRows(text, label),
      last = rows.length - 1;
    if (last < 1 || rows[0][0] > 400 || rows[last][0] < 700) {
      const found = last < 1 ? "–" : `${rows[0][0]}–${rows[last][0]} nm`;
      throw new I.Refusal("bad_table_span", { file: label, found: found });
    }
    const steps = rows.slice(1).map(([nm], i) => nm - rows[i][0]),
      gap = steps.findIndex((step, i) => step > MOST_STEP_NM + 1e-9 && rows[i + 1][0] > 400 && rows[i][0] < 700);
    if (gap >= 0) throw new I.Refusal("bad_table_gap", { file: label, nm: rows[gap][0], step: MOST_STEP_NM });
    const [least, peak] = [Math.min, Math.max].map((of) => rows.reduce((found, row) => of(found, row[1]), 0));
    if (least < -NOISE * peak || !(peak > 0)) throw new I.Refusal("bad_table_power", { file: label });
    // Lines of lamps in a table finer than the samples would fall between them.
    const fine = rows.filter(([nm]) => nm >= 400 && nm <= 700).length > 61;
    const even = rows.length >= 6 && Math.max(...steps) - Math.min(...steps) <= 1e-3,
      on = (value) => Array.from({ length: 61 }, (_, i) => value(400 + 5 * i)),
      straight = (nm) => I.onLine(rows, nm);
    let power;
    if (fine) {
      // Beyond the ends of the table, its end values continue.
      const more = [[rows[0][0] - 5, rows[0][1]], ...rows, [rows[last][0] + 5, rows[last][1]]];
      power = on((nm) => triangleMean(more, nm, 5));
    } else {
      power = on(even ? (nm) => sprague(rows, nm) : straight);
      if (Math.min(...power) < least) power = on(straight);
    }
    const top = Math.max(...power);
    if (!(top > 0)) throw new I.Refusal("bad_table_power", { file: label });
    // The curve of a light can be drawn on from 0 up.
    return { power: power.map((one) => Number((Math.max(one, 0) / top).toPrecision(5))), label: label.slice(0, 100) };
  };
})(window.Irodori);
