"use strict";
// Dialogs: check of the screen, truth of the picture, self-check of the page, help; and the line at the foot.
(function (I) {
  const app = I.app,
    h = I.h,
    $ = I.byId,
    canvas = $("picture");

  function dialog(key, ...content) {
    $("dialog-title").textContent = I.text(key);
    $("dialog-body").replaceChildren(...content);
    if (!$("dialog").open) $("dialog").showModal();
  }

  function checkScreen() {
    const patches = (codes) =>
      h(
        "div",
        { class: "patches", "aria-hidden": "true" },
        ...codes.map((code) => {
          const patch = h("i");
          patch.style.background = `rgb(${code} ${code} ${code})`;
          return patch;
        }),
      );
    const dark = [0, 4, 8, 12, 16, 20, 24, 28],
      light = [227, 231, 235, 239, 243, 247, 251, 255];
    // Lines of black and white, one device pixel each, shine half as much as white; so does the code 188 of sRGB.
    const lines = h("canvas", { width: 400, height: 64 }),
      pen = lines.getContext("2d");
    for (let row = 0; row < 64; row++) {
      pen.fillStyle = row % 2 ? "#fff" : "#000";
      pen.fillRect(0, row, 400, 1);
    }
    const row = h(
      "div",
      { class: "patches", "aria-hidden": "true" },
      ...[188, null, 188].map((code) => {
        if (code === null) return lines;
        const patch = h("i");
        patch.style.background = "rgb(188 188 188)";
        return patch;
      }),
    );
    const ratio = window.devicePixelRatio || 1;
    lines.style.cssText = `flex: none; width: ${400 / ratio}px; height: ${64 / ratio}px`;
    const verdict = h("p", { role: "status" });
    const seen = { dark: 8, light: 8 };
    const asked = new I.Controls();
    const ask = (which) =>
      asked.slider({
        key: "steps_" + which,
        low: 1,
        high: 8,
        step: 1,
        get: () => seen[which],
        show: String,
        set: (value) => {
          seen[which] = value;
          asked.update();
          verdict.textContent = I.text(
            Math.min(seen.dark, seen.light) >= 7
              ? "screen_good"
              : seen.dark < seen.light
                ? "screen_dark"
                : "screen_light",
          );
        },
      });
    dialog(
      "check_screen",
      h("p", { text: "check_words" }),
      patches(dark),
      ask("dark"),
      patches(light),
      ask("light"),
      row,
      h("p", { text: "check_lines" }),
      verdict,
    );
  }

  const table = (rows) =>
    h("table", {}, ...rows.map(([name, value]) => h("tr", {}, h("th", { scope: "row" }, name), h("td", {}, value))));
  const pairOf = (one) =>
    one ? I.text("mean_p99", { mean: one.mean.toFixed(3), p99: one.p99.toFixed(3) }) : I.text("not_checked");

  function truth() {
    const stated = app.header.stated_errors;
    const rows = [
      [I.text("against_cpu"), pairOf(stated.cpu)],
      [I.text("against_reference"), pairOf(stated.reference)],
      [I.text("data_loss"), pairOf(stated.data_loss)],
      [I.text("room"), app.header.environments.map((name) => I.nameOf("environment", name)).join(", ")],
      [I.text("made"), app.header.made],
      [I.text("programs_linked"), I.text("ms", { ms: Math.round(app.renderer.figures().programs_linked_ms) })],
      ...Object.entries(app.header.hashes).map(([name, value]) => [I.nameOf("hash", name), [value].flat().join(" ")]),
    ];
    const test = app.controls.button("selftest", () => selftest());
    dialog("about_picture", table(rows), test);
  }

  async function selftest() {
    dialog("selftest", h("p", { text: "selftest_runs" }));
    try {
      const rows = await I.selftest(app.renderer),
        names = Object.keys(rows[0] ?? {});
      const cell = (value) =>
        typeof value === "number" ? Number(value.toPrecision(3)) : value === null ? "–" : String(value);
      dialog(
        "selftest",
        h(
          "table",
          {},
          h("tr", {}, ...names.map((name) => h("th", { scope: "col" }, I.nameOf("column", name)))),
          ...rows.map((one) => h("tr", {}, ...names.map((name) => h("td", {}, cell(one[name]))))),
        ),
      );
    } catch (error) {
      dialog("selftest", h("p", {}, I.sentence(error)));
    }
    app.redraw();
  }

  function help() {
    const keys = (key) =>
      I.text(key)
        .split(/(\[[^\]]+\])/)
        .map((part) => (part.startsWith("[") && part.length > 2 ? h("kbd", {}, part.slice(1, -1)) : part));
    dialog(
      "help",
      h("p", { text: "help_words" }),
      table(
        ["view", "object", "room", "lamp", "probe", "ruler"].map((name) => [
          I.text("tool_" + name),
          h("span", {}, ...keys("help_" + name)),
        ]),
      ),
      h("p", {}, ...keys("help_all")),
    );
  }

  function showTruthLine() {
    const { cpu, data_loss: loss } = app.header.stated_errors;
    $("truth-line").textContent = [
      cpu ? I.text("truth_cpu", { error: pairOf(cpu) }) : I.text("truth_unchecked"),
      I.text("truth_loss", { error: pairOf(loss) }),
      app.header.environments.map((name) => I.nameOf("environment", name)).join(", "),
      app.header.made,
      I.text("truth_hash", { hash: app.header.hashes.scene.slice(0, 8) }),
    ]
      .filter(Boolean)
      .join(" · ");
  }

  Object.assign(app, { checkScreen, truth, selftest, help, showTruthLine });
})(window.Irodori);
