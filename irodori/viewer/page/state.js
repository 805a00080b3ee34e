"use strict";
// The whole picture as plain values, and as the part of an address behind the #.
//
// page = {step: number or null, state: of the renderer, compare: {mode, other, at} or null,
//         probes: points in mm, ruler: points in mm}
window.Irodori = window.Irodori || {};
(function (I) {
  const MODES = ["wipe", "difference", "metamerism", "rgb"];
  const OVERLAYS = ["status", "uncertainty", "gamut"];
  const DEFICIENCIES = ["protan", "deutan", "tritan"];
  const FAR = 1e6;
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
    if (!isBlock(base) || !isBlock(given)) return given;
    const made = I.clone(base);
    for (const key of Object.keys(given)) {
      if (!Object.hasOwn(base, key)) throw refusal(path + key, "x", I.text("no_such_key"));
      made[key] = WHOLE.includes(key) ? given[key] : laidOver(base[key], given[key], path + key + ".");
    }
    return made;
  }

  I.pageToHash = function (page, base) {
    const text = JSON.stringify(difference(JSON.parse(JSON.stringify(page, rounded)), base));
    const bytes = String.fromCharCode(...new TextEncoder().encode(text));
    return "v1." + btoa(bytes).replace(/\+/g, "-").replace(/\//g, "_").replace(/=+$/, "");
  };

  I.hashToPage = function (hash, base, header) {
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
    return I.checkedPage(laidOver(base, given, ""), base, header);
  };

  function refusal(field, found, accepted) {
    const shown = (JSON.stringify(found) ?? "nothing").slice(0, 60);
    return new I.Refusal("bad_state", { field: field, found: shown, accepted: accepted });
  }

  function number(field, value, low, high) {
    const inside = typeof value === "number" && value >= low && value <= high;
    if (!inside) throw refusal(field, value, `${low} … ${high}`);
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
      if (!known.includes(key)) throw refusal(`${field}.${key}`, value[key], known.join(", "));
  }

  function illuminant(field, value, header) {
    if (value === null) return;
    keys(field, value, ["name", "cct_K", "power", "label"]);
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
    if (value.environment !== null) choice(field + ".environment", value.environment, header.environments);
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

  function display(field, value, base) {
    keys(field, value, ["name", "primaries", "profile"]);
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
    if (!("primaries" in value)) return choice(field + ".name", value.name, ["sRGB", "Display P3", base.name]);
    keys(field + ".primaries", value.primaries, ["red_xy", "green_xy", "blue_xy", "white_xy", "gamma"]);
    for (const one of ["red_xy", "green_xy", "blue_xy", "white_xy"])
      numbers(`${field}.primaries.${one}`, value.primaries[one], 2, 0.0001, 0.9);
    return number(field + ".primaries.gamma", value.primaries.gamma, 1, 4);
  }

  // Return a page after a look at every value, or refuse it in one sentence.
  I.checkedPage = function (page, base, header) {
    const state = page.state;
    if (page.step !== null) number("step", page.step, 0, 99);
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
    display("display", state.display, base.state.display);
    if (page.compare !== null) {
      keys("compare", page.compare, ["mode", "other", "at"]);
      choice("compare.mode", page.compare.mode, MODES);
      light("compare.other", page.compare.other, header);
      number("compare.at", page.compare.at, 0, 1);
    }
    for (const name of ["probes", "ruler"]) {
      list(name, page[name], 2);
      page[name].forEach((one, index) => numbers(`${name}[${index}]`, one, 3, -FAR, FAR));
    }
    return page;
  };

  // ---- spectra of light in files

  // A table of wavelength in nm and power, at 400, 405, ... 700 nm.
  I.powerOfTable = function (text, label) {
    const rows = [];
    for (const line of text.replace(/^\uFEFF/, "").split(/\r?\n/)) {
      const cells = line
        .trim()
        .split(/[,;\t ]+/)
        .filter((cell) => cell !== "");
      if (cells.length < 2 || !/^[-+.\d]/.test(cells[0])) {
        // The same words as in irodori/spectra/spectral_files.py.
        if (/(^|[^a-z])(photons?(flux)?|quanta|quantum flux|[uµμ]mol|micromol)(?![a-z])/i.test(line))
          throw new I.Refusal("bad_table_photons", { file: label, found: line.trim().slice(0, 40) });
        continue;
      }
      const pair = cells.slice(0, 2).map(Number);
      if (!pair.every(Number.isFinite)) throw new I.Refusal("bad_table_row", { file: label, found: line.slice(0, 40) });
      rows.push(pair);
    }
    rows.sort((a, b) => a[0] - b[0]);
    const last = rows.length - 1;
    if (last < 1 || rows[0][0] > 400 || rows[last][0] < 700) {
      const found = last < 1 ? "–" : `${rows[0][0]}–${rows[last][0]} nm`;
      throw new I.Refusal("bad_table_span", { file: label, found: found });
    }
    if (rows.some((row) => row[1] < 0) || !rows.some((row) => row[1] > 0))
      throw new I.Refusal("bad_table_power", { file: label });
    const at = function (nm) {
      let i = 1;
      while (i < last && rows[i][0] < nm) i++;
      const [a, b] = [rows[i - 1], rows[i]];
      if (b[0] === a[0]) return b[1];
      return a[1] + (b[1] - a[1]) * Math.min(1, Math.max(0, (nm - a[0]) / (b[0] - a[0])));
    };
    // Lines of lamps in a table finer than 5 nm would fall between the samples: the mean over each sample's 5 nm.
    const fine = (rows[last][0] - rows[0][0]) / last < 4;
    const power = Array.from({ length: 61 }, (_, i) => {
      const nm = 400 + 5 * i;
      if (!fine) return at(nm);
      const steps = [-2, -1, 0, 1, 2].map((d) => at(Math.min(700, Math.max(400, nm + d))));
      return steps.reduce((sum, one) => sum + one, 0) / 5;
    });
    const top = Math.max(...power);
    if (!(top > 0)) throw new I.Refusal("bad_table_power", { file: label });
    return { power: power.map((one) => Number((one / top).toPrecision(5))), label: label.slice(0, 100) };
  };
})(window.Irodori);
