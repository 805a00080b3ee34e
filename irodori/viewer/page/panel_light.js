"use strict";
// The panel's page of the light: illuminant, room, exposure, lamps.
(function (I) {
  const app = I.app,
    h = I.h;

  const power = (one) => app.renderer.power(one);

  function illuminantPicker(light, key, none) {
    return app.controls.illuminant({
      key,
      none,
      header: app.header,
      power,
      get: () => light().illuminant,
      set: (value) => {
        light().illuminant = value;
        app.changed();
      },
      openFile: () =>
        app.askFile((file) =>
          app.takeFile(file, (power) => {
            light().illuminant = power;
          }),
        ),
    });
  }

  // Where the room's light has no power, an exchanged light cannot have any.
  function exchangeNote(light) {
    const note = h("p", { class: "hint", role: "status" });
    const update = () => {
      note.textContent = missingWords(light());
      note.hidden = note.textContent === "";
    };
    app.controls.updates.push(update);
    update();
    return note;
  }

  function missingWords(light) {
    const missing = app.renderer.missing(light),
      spans = [];
    for (const nm of missing)
      if (spans.length && nm === spans.at(-1)[1] + 5) spans.at(-1)[1] = nm;
      else spans.push([nm, nm]);
    const words = spans.map(([first, last]) => (first === last ? `${first} nm` : `${first}–${last} nm`));
    return missing.length ? I.text("light_missing", { spans: words.join(", ") }) : "";
  }

  function roomControls(light) {
    const parts = [
      app.controls.slider({
        key: "turn_room",
        low: -180,
        high: 180,
        step: 1,
        get: () => light().turn_deg,
        set: (value) => {
          light().turn_deg = value;
          app.changed();
        },
        show: app.degrees,
      }),
    ];
    if (app.header.environments.length > 1)
      parts.unshift(
        app.controls.select({
          key: "room",
          options: app.header.environments.map((name) => [name, I.nameOf("environment", name)]),
          get: () => light().environment,
          set: (value) => {
            light().environment = value;
            app.changed();
          },
        }),
      );
    return parts;
  }

  function lightPage() {
    const light = () => app.page.state.light,
      lamps = app.page.state.light.lamps;
    const parts = [
      app.controls.group("spectrum", illuminantPicker(light, "illuminant", "as_captured"), exchangeNote(light)),
      app.controls.group("room_group", ...roomControls(light)),
      app.controls.group(
        "exposure_group",
        app.controls.slider({
          key: "exposure",
          low: -4,
          high: 4,
          step: 0.1,
          get: () => app.page.state.exposure_ev,
          set: (value) => {
            app.page.state.exposure_ev = value;
            app.changed();
          },
          show: (value) => I.text("stops", { value: (value > 0 ? "+" : "") + value.toFixed(1) }),
        }),
      ),
    ];
    const group = app.controls.group("lamps");
    lamps.forEach((own, i) => {
      if (own.far) return;
      const lamp = () => app.page.state.light.lamps[i] ?? lamps[i];
      const set = (key) => (value) => {
        lamp()[key] = value;
        app.chosenLamp = i;
        app.changed();
      };
      const axis = (key, index, low, high) =>
        app.controls.slider({
          key,
          low,
          high,
          step: 1,
          get: () => lamp().position_mm[index],
          show: app.millimetres,
          set: (value) => {
            lamp().position_mm[index] = value;
            app.chosenLamp = i;
            app.changed();
          },
        });
      const name = I.text("lamp_number", { number: i + 1 });
      group.append(
        h(
          "fieldset",
          { class: "group" },
          h("legend", {}, name),
          h(
            "div",
            { class: "group-inner" },
            app.controls.tick({ key: "lamp_on", get: () => lamp().on, set: set("on") }),
            app.controls.slider({
              key: "lamp_size",
              low: 0,
              high: 300,
              step: 1,
              get: () => lamp().size_mm,
              set: set("size_mm"),
              show: app.millimetres,
            }),
            app.controls.slider({
              key: "lamp_strength",
              low: 0,
              high: 5,
              step: 0.05,
              get: () => lamp().strength,
              set: set("strength"),
              show: (value) => value.toFixed(2),
            }),
            axis("axis_x", 0, -500, 500),
            axis("axis_y", 1, -500, 500),
            axis("axis_z", 2, 10, 600),
            illuminantPicker(lamp, "lamp_spectrum", "lamp_d65"),
            app.controls.button(
              "remove_lamp",
              () => {
                app.page.state.light.lamps.splice(i, 1);
                app.chosenLamp = 0;
                app.rebuild("#add-lamp");
              },
              { "aria-label": I.text("remove_lamp") + " " + (i + 1) },
            ),
          ),
        ),
      );
    });
    group.append(
      app.controls.button(
        "add_lamp",
        () => {
          app.page.state.light.lamps.push({
            position_mm: [-60 + 30 * lamps.length, 20, 110],
            size_mm: 60,
            strength: 1,
            illuminant: null,
            on: true,
            far: false,
          });
          app.chosenLamp = app.page.state.light.lamps.length - 1;
          app.choose("lamp");
          app.rebuild("#add-lamp");
        },
        { id: "add-lamp", disabled: lamps.length >= I.LAMPS },
      ),
    );
    parts.push(group);
    return parts;
  }

  Object.assign(app, { illuminantPicker, exchangeNote, missingWords, roomControls, lightPage });
})(window.Irodori);
