"use strict";
// The panel's page of the objects: which are shown, where they stand, how they are turned.
(function (I) {
  const app = I.app,
    h = I.h;

  function objectsPage() {
    const { objects } = app.page.state;
    if (!objects.length) return [h("p", { class: "hint", text: "no_objects" })];
    const one = () => app.page.state.objects[app.chosenObject];
    const part = (key, field, index, low, high, show) =>
      app.controls.slider({
        key,
        low,
        high,
        step: 1,
        show,
        get: () => one()[field][index],
        set: (value) => {
          one()[field][index] = value;
          app.changed();
        },
      });
    const parts = [
      app.controls.group(
        null,
        app.controls.select({
          key: "object",
          options: objects.map((each, i) => [String(i), app.objectWords(each)]),
          get: () => String(app.chosenObject),
          set: (value) => {
            app.chosenObject = Number(value);
            app.changed();
          },
        }),
        app.controls.tick({
          key: "visible",
          get: () => one().visible,
          set: (value) => {
            one().visible = value;
            app.changed();
          },
        }),
      ),
      app.controls.group(
        "turn",
        part("turn_z", "turn_deg", 2, -180, 180, app.degrees),
        part("turn_x", "turn_deg", 0, -180, 180, app.degrees),
        part("turn_y", "turn_deg", 1, -180, 180, app.degrees),
      ),
      app.controls.group(
        "place",
        part("axis_x", "position_mm", 0, -250, 250, app.millimetres),
        part("axis_y", "position_mm", 1, -250, 250, app.millimetres),
        part("axis_z", "position_mm", 2, -100, 250, app.millimetres),
        app.controls.button("put_back", () => {
          app.page.state.objects[app.chosenObject] = I.clone(app.base.state.objects[app.chosenObject]);
          app.changed();
        }),
      ),
    ];
    if (objects.length > 1) {
      let other = objects.findIndex((_, i) => i !== app.chosenObject);
      const pick = app.controls.select({
        key: "swap_with",
        options: objects.map((each, i) => [String(i), app.objectWords(each)]),
        get: () => String(other),
        set: (value) => {
          other = Number(value);
        },
      });
      parts.push(
        app.controls.group(
          "swap",
          pick,
          app.controls.button("swap_places", () => {
            const [a, b] = [one(), app.page.state.objects[other]];
            [a.position_mm, b.position_mm] = [b.position_mm, a.position_mm];
            app.changed();
          }),
        ),
      );
    }
    return parts;
  }

  Object.assign(app, { objectsPage });
})(window.Irodori);
