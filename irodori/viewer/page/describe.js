"use strict";
// The picture in words, for those who do not see it.
(function (I) {
  const app = I.app;

  const illuminantWords = (one, none) =>
    one === null
      ? I.text(none)
      : "name" in one
        ? I.nameOf("illuminant", one.name, app.header.illuminants.find((x) => x.name === one.name)?.label)
        : "cct_K" in one
          ? `${one.cct_K} K`
          : one.label;
  const objectWords = (one) => I.nameOf("object", one.name, app.header.objects.find((x) => x.name === one.name)?.label);

  function describe() {
    const { camera, light } = app.page.state;
    const parts = [
      I.text("describe_view", {
        side: Math.round(camera.azimuth_deg),
        up: Math.round(camera.elevation_deg),
        away: Math.round(camera.distance_mm),
      }),
      I.text("describe_light", {
        light: illuminantWords(light.illuminant, "as_captured"),
        turn: Math.round(light.turn_deg),
      }),
    ];
    const missing = app.missingWords(light);
    if (missing) parts.push(missing);
    const lamps = light.lamps.filter((one) => one.on).length;
    if (lamps) parts.push(I.text("describe_lamps", { count: lamps }));
    if (app.page.compare)
      parts.push(
        I.text("describe_compare", {
          mode: I.text("mode_" + app.page.compare.mode),
          other:
            app.page.compare.mode === "rgb" ? "" : illuminantWords(app.page.compare.other.illuminant, "as_captured"),
          at: Math.round(100 * app.page.compare.at),
        }),
      );
    if (app.page.state.overlay)
      parts.push(I.text("describe_overlay", { overlay: I.text("overlay_" + app.page.state.overlay) }));
    if (app.header.environments.length > 1)
      parts.push(I.text("describe_room", { room: I.nameOf("environment", light.environment) }));
    if (!app.knowsLight()) parts.push(I.text("light_updating"));
    const hidden = app.page.state.objects.filter((one) => !one.visible).map(objectWords);
    if (hidden.length) parts.push(I.text("describe_hidden", { names: hidden.join(", ") }));
    return parts.join(" ");
  }

  Object.assign(app, { illuminantWords, objectWords, describe });
})(window.Irodori);
