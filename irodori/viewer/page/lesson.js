"use strict";
// Steps of a lesson: from the form of a scene's file to a picture, back, and as the text of such a file.
window.Irodori = window.Irodori || {};
(function (I) {
  const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);

  // The scene's own lamps from far away shine in every step.
  function lightOf(given, base) {
    const own = base.lamps.filter((lamp) => lamp.far);
    return {
      environment: given.environment ?? base.environment,
      turn_deg: given.turn_deg ?? 0,
      illuminant: given.illuminant ?? null,
      lamps: [
        ...I.clone(own),
        ...(given.lamps ?? []).map((lamp) => ({
          size_mm: 60,
          strength: 1,
          illuminant: null,
          far: false,
          ...I.clone(lamp),
          on: true,
        })),
      ],
    };
  }

  // The picture of a step. A step says all that differs from how the page opens, so that its picture does not
  // depend on the way that led to it. Refuses what the scene does not have.
  I.pageOfStep = function (step, index, base, header) {
    const page = I.clone(base);
    const state = page.state;
    page.step = index;
    if (step.view) {
      const view = header.views.find((one) => one.name === step.view);
      if (!view)
        throw new I.Refusal("bad_state", {
          field: "view",
          found: step.view,
          accepted: header.views.map((one) => one.name).join(", "),
        });
      state.camera = I.clone(view.camera);
    }
    if (step.camera)
      state.camera = { fov_deg: state.camera.fov_deg, roll_deg: 0, height_mm: 0, ...I.clone(step.camera) };
    state.light = lightOf(step.light ?? {}, base.state.light);
    for (const pose of step.objects ?? []) {
      const one = state.objects.find((placed) => placed.name === pose.name);
      if (!one)
        throw new I.Refusal("bad_state", {
          field: "objects",
          found: pose.name,
          accepted: state.objects.map((placed) => placed.name).join(", "),
        });
      Object.assign(one, I.clone(pose));
    }
    for (const key of ["observer", "deficiency", "overlay", "exposure_ev"])
      if (step[key] !== undefined) state[key] = step[key];
    if (step.compare) {
      page.compare = {
        mode: step.compare.mode,
        at: step.compare.at ?? 0.5,
        other: lightOf(step.compare.light ?? {}, base.state.light),
      };
    }
    return I.checkedPage(page, base, header);
  };

  function lightGiven(light, base) {
    const given = {};
    if (light.environment !== base.environment) given.environment = light.environment;
    if (light.turn_deg) given.turn_deg = light.turn_deg % 360;
    if (light.illuminant) given.illuminant = light.illuminant;
    const lamps = light.lamps
      .filter((lamp) => lamp.on && !lamp.far)
      .map(({ on, far, illuminant, ...lamp }) => (illuminant ? { ...lamp, illuminant } : lamp));
    if (lamps.length) given.lamps = lamps;
    return given;
  }

  // The step of a picture, with the words that belong to it.
  I.stepOfPage = function (page, words, base) {
    const state = page.state;
    const step = { title: words.title, text: words.text };
    for (const key of ["picture", "picture_file", "given_here"]) if (words[key]) step[key] = words[key];
    if (!same(state.camera, base.state.camera))
      step.camera = {
        ...I.clone(state.camera),
        azimuth_deg: state.camera.azimuth_deg % 360,
        roll_deg: state.camera.roll_deg % 360,
      };
    const light = lightGiven(state.light, base.state.light);
    if (Object.keys(light).length) step.light = light;
    const poses = state.objects.flatMap((one, index) => {
      const own = base.state.objects[index],
        pose = { name: one.name };
      for (const key of ["position_mm", "turn_deg"])
        if (!same(one[key], own[key])) pose[key] = one[key].map((value) => (key === "turn_deg" ? value % 360 : value));
      if (one.visible !== own.visible) pose.visible = one.visible;
      return Object.keys(pose).length > 1 ? [pose] : [];
    });
    if (poses.length) step.objects = poses;
    if (page.compare) {
      step.compare = { mode: page.compare.mode, at: page.compare.at };
      const other = lightGiven(page.compare.other, base.state.light);
      if (Object.keys(other).length) step.compare.light = other;
    }
    for (const key of ["observer", "deficiency", "overlay", "exposure_ev"]) {
      if (state[key] !== base.state[key]) step[key] = state[key];
    }
    if (words.notes?.length) step.notes = words.notes;
    return step;
  };

  // ---- pictures of steps

  const KINDS = { "image/png": [0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a], "image/jpeg": [0xff, 0xd8, 0xff] };
  I.MOST_PICTURE = 1e6; // bytes, as a scene's file takes it

  // Give a step a picture from a file; refuses what the scene's file would not take.
  I.givePicture = function (lesson, step, bytes, file) {
    const kind = Object.keys(KINDS).find((one) => KINDS[one].every((byte, i) => bytes[i] === byte));
    if (!kind || bytes.length > I.MOST_PICTURE) throw new I.Refusal("bad_picture", { file });
    let text = "";
    for (let i = 0; i < bytes.length; i += 32768) text += String.fromCharCode(...bytes.subarray(i, i + 32768));
    // Another picture of the same name gets a number.
    const [, stem, end] = /^(.*?)(\.[^.]*)?$/.exec(file.replace(/[^\p{L}\p{N}._-]/gu, "-").slice(-80));
    const taken = lesson.steps.filter((one) => one !== step).map((one) => one.picture_file);
    let name = stem + (end ?? "");
    for (let i = 2; taken.includes(name); i++) name = `${stem}-${i}${end ?? ""}`;
    Object.assign(step, { picture: `data:${kind};base64,${btoa(text)}`, picture_file: name, given_here: true });
  };

  // Pictures that were given in the page: their names, as the lesson's text has them, and addresses.
  I.givenPictures = (lesson) =>
    lesson.steps.filter((one) => one.given_here).map((one) => [one.picture_file, one.picture]);

  // ---- YAML 1.1: strings as in JSON, with what YAML does not print escaped; lists of numbers in one line

  // 1e-7 would be a text there, and 1.0e-7 is a number.
  const numeral = (value) => String(Number(value.toPrecision(7))).replace(/^(-?\d+)e/, "$1.0e");
  const quoted = (value) =>
    JSON.stringify(value.replace(/\p{Surrogate}/gu, "\ufffd")).replace(
      /[\x7f-\x9f\u2028\u2029\ufeff\ufffe\uffff]/g,
      (one) => "\\u" + one.charCodeAt(0).toString(16).padStart(4, "0"),
    );
  const scalar = (value) =>
    typeof value === "number" ? numeral(value) : typeof value === "string" ? quoted(value) : JSON.stringify(value);

  function lines(value, indent) {
    const pad = " ".repeat(indent);
    if (Array.isArray(value))
      return value.flatMap((one) => {
        const inner = lines(one, indent + 2);
        return [pad + "- " + inner[0].trimStart(), ...inner.slice(1)];
      });
    return Object.entries(value).flatMap(([name, one]) => {
      const key = /^(no|on|off|yes)$/.test(name) ? quoted(name) : name; // Norwegian would be false
      if (one === null || typeof one !== "object") return [`${pad}${key}: ${scalar(one)}`];
      if (Array.isArray(one) && (one.length === 0 || typeof one[0] === "number"))
        return [`${pad}${key}: [${one.map(scalar).join(", ")}]`];
      return [`${pad}${key}:`, ...lines(one, indent + 2)];
    });
  }

  // The key `lesson` of a scene's file.
  I.lessonYaml = function (lesson) {
    const plain = I.clone(lesson);
    for (const step of plain.steps) {
      if (step.picture_file) step.picture = step.picture_file;
      delete step.picture_file;
      delete step.given_here;
    }
    return ["lesson:", ...lines(plain, 2)].join("\n") + "\n";
  };
})(window.Irodori);
