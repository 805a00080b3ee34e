"use strict";
// The panel's page of comparisons: two lights, or a renderer of three numbers.
(function (I) {
  const app = I.app,
    h = I.h;

  function comparePage() {
    const mode = app.controls.choice({
      key: "comparison",
      options: [["", "mode_none"], ...I.choices.modes.map((one) => [one, "mode_" + one])],
      get: () => app.page.compare?.mode ?? "",
      set: (value) => {
        const other = app.page.compare?.other ?? {
          ...I.clone(app.page.state.light),
          illuminant: app.page.state.light.illuminant?.name === "A" ? { name: "D65" } : { name: "A" },
        };
        app.page.compare =
          value === ""
            ? null
            : { mode: value, other, at: app.page.compare?.at ?? (value === "wipe" || value === "rgb" ? 0.5 : 0) };
        app.build();
        app.changed();
        document.querySelector(`#page-compare input[value="${value}"]`)?.focus();
      },
    });
    const parts = [mode];
    if (!app.page.compare) return [...parts, h("p", { class: "hint", text: "compare_hint" })];
    parts.push(
      h("p", { class: "hint", text: "about_" + app.page.compare.mode }),
      app.controls.group(
        "line",
        app.controls.slider({
          key: "wipe_line",
          low: 0,
          high: 100,
          step: 1,
          get: () => Math.round(100 * (app.page.compare?.at ?? 0)),
          set: (value) => app.setWipe(value / 100),
          show: (value) => I.text("percent", { value }),
        }),
      ),
    );
    if (app.page.compare.mode !== "rgb") {
      const other = () => app.page.compare?.other ?? app.page.state.light;
      parts.push(
        app.controls.group(
          "second_light",
          app.illuminantPicker(other, "illuminant", "as_captured"),
          app.exchangeNote(other),
          ...app.roomControls(other),
        ),
        app.controls.button("exchange", () => {
          [app.page.state.light, app.page.compare.other] = [app.page.compare.other, app.page.state.light];
          app.rebuild();
        }),
      );
    }
    return parts;
  }

  Object.assign(app, { comparePage });
})(window.Irodori);
