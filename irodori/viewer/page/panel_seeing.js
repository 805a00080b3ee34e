"use strict";
// The panel's page of eye and screen: observer, colour vision, overlays, display, speed.
(function (I) {
  const app = I.app,
    h = I.h,
    $ = I.byId;

  function seeingPage() {
    const { state } = app.page;
    const parts = [
      app.controls.group(
        "eye",
        app.controls.select({
          key: "observer",
          options: app.header.observers.map((one) => [one.name, I.nameOf("observer", one.name, one.label)]),
          get: () => app.page.state.observer,
          set: (value) => {
            app.page.state.observer = value;
            app.changed();
          },
        }),
        app.controls.select({
          key: "deficiency",
          options: [["", I.text("none")], ...I.choices.deficiencies.map((one) => [one, I.text("deficiency_" + one)])],
          get: () => app.page.state.deficiency ?? "",
          set: (value) => {
            app.page.state.deficiency = value || null;
            app.changed();
          },
        }),
      ),
      app.controls.choice({
        key: "overlay",
        options: [["", "none"], ...I.choices.overlays.map((one) => [one, "overlay_" + one])],
        get: () => app.page.state.overlay ?? "",
        set: (value) => {
          app.page.state.overlay = value || null;
          app.changed();
        },
      }),
    ];
    const OWN = ":primaries",
      wide = window.matchMedia("(color-gamut: p3)").matches;
    const options = [
      ...app.header.displays.map(({ name }) => [name, name === "Display P3" && !wide ? I.text("p3_not_here") : name]),
      [OWN, I.text("own_primaries")],
    ];
    const PROFILE = ":profile",
      own = state.display.profile;
    if (own) options.push([PROFILE, own.label]);
    const screen = app.controls.group(
      "screen",
      app.controls.select({
        key: "display",
        options,
        get: () => app.page.state.display.name ?? (app.page.state.display.profile ? PROFILE : OWN),
        set: (value) => {
          if (value === PROFILE) return;
          app.page.state.display =
            value === OWN
              ? {
                  primaries: {
                    red_xy: [0.64, 0.33],
                    green_xy: [0.3, 0.6],
                    blue_xy: [0.15, 0.06],
                    white_xy: [0.3127, 0.329],
                    gamma: 2.2,
                  },
                }
              : { name: value };
          app.rebuild("#page-seeing .group:last-of-type select");
        },
      }),
    );
    if (state.display.primaries) {
      const cell = (key, i) =>
        h(
          "td",
          {},
          app.controls.number({
            name: `${I.text(key)} ${"xy"[i]}`,
            low: 0.0001,
            high: 0.9,
            step: 0.0001,
            get: () => app.page.state.display.primaries?.[key][i] ?? "",
            set: (value) =>
              app.tell(() => {
                const next = I.clone(app.page.state.display.primaries);
                next[key][i] = value;
                I.checkPrimaries("display.primaries", next);
                app.page.state.display.primaries = next;
                app.changed();
              }),
          }),
        );
      screen.append(
        h(
          "table",
          {},
          ...["red_xy", "green_xy", "blue_xy", "white_xy"].map((key) =>
            h("tr", {}, h("th", { scope: "row", text: key }), cell(key, 0), cell(key, 1)),
          ),
        ),
        app.controls.slider({
          key: "gamma",
          low: 1,
          high: 4,
          step: 0.05,
          get: () => app.page.state.display.primaries?.gamma ?? 2.2,
          set: (value) => {
            app.page.state.display.primaries.gamma = value;
            app.changed();
          },
          show: (value) => value.toFixed(2),
        }),
      );
    }
    screen.append(
      app.controls.button("open_profile", () => app.askFile((file) => app.takeFile(file, null))),
      app.controls.button("check_screen", app.checkScreen),
    );
    parts.push(
      screen,
      app.controls.group(
        "speed",
        app.controls.tick({
          key: "show_rate",
          get: () => !$("rate").hidden,
          set: (value) => {
            $("rate").hidden = !value;
            app.redraw();
          },
        }),
      ),
    );
    return parts;
  }

  Object.assign(app, { seeingPage });
})(window.Irodori);
