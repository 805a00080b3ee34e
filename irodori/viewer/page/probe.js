"use strict";
// Probe and ruler: what is known of a point that is pointed at, and the card that tells it.
(function (I) {
  const app = I.app,
    h = I.h,
    $ = I.byId,
    canvas = $("picture");

  function pixels(x, y) {
    const [width, height] = app.size();
    return [(x / width) * canvas.width, (y / height) * canvas.height];
  }

  function point(x, y) {
    const found = app.renderer.probe(app.page.state, ...pixels(x, y));
    if (!found) {
      app.say(I.text("nothing_there"));
      return;
    }
    if (app.tool === "ruler") {
      app.page.ruler = [...(app.page.ruler.length === 2 ? [] : app.page.ruler), found.position_mm];
      if (app.page.ruler.length === 2) app.say(I.text("ruler_reads", { mm: I.distance(...app.page.ruler).toFixed(1) }));
    } else {
      const { surface, texel, position_mm } = found;
      app.page.probes = [...app.page.probes, { surface, texel, position_mm }].slice(-2);
      showCard();
    }
    app.changed();
  }

  // Half the error band where it is narrowest or widest, and the wavelength.
  const bound = (name, sigma) => {
    const error = Math[name](...sigma);
    return { [name]: (2 * error).toFixed(3), [name + "_nm"]: 400 + 5 * sigma.indexOf(error) };
  };

  function spectrumWords(one) {
    const at = (nm) => one.reflectance[(nm - 400) / 5].toFixed(2);
    const known = one.sigma
      ? I.text("error_band", { ...bound("min", one.sigma), ...bound("max", one.sigma) })
      : I.text("error_unknown");
    return I.text("spectrum_words", { short: at(450), middle: at(550), long: at(650) }) + " " + known;
  }

  function showCard() {
    const card = $("card"),
      probed = app.page.probes.map((place) => app.renderer.known(place));
    card.hidden = probed.length === 0;
    app.showStage();
    if (card.hidden) return;
    const figure = (value, digits, unit) =>
      Number.isFinite(value) ? value.toFixed(digits) + unit : I.text("unknown_value");
    const rows = probed.flatMap((one, i) => {
      const letter = probed.length > 1 ? "AB"[i] + " · " : "";
      return [
        h("h3", {}, letter + app.objectWords({ name: one.object })),
        h("p", {}, I.text("status_long_" + one.status)),
        h("p", { class: "hint" }, spectrumWords(one)),
        h(
          "dl",
          {},
          ...[
            ["alpha", one.alpha, 3, ""],
            ["beta", one.beta, 3, ""],
            ["mu", one.mu_rad, 3, " rad"],
          ].flatMap(([key, value, digits, unit]) => [h("dt", { text: key }), h("dd", {}, figure(value, digits, unit))]),
        ),
      ];
    });
    const curves = probed.map((one) => ({ values: one.reflectance, sigma: one.sigma }));
    const top = Math.max(1, ...curves.flatMap((one) => one.values));
    const clear = app.controls.button("clear", () => {
      app.page.probes = [];
      showCard();
      app.changed();
      canvas.focus();
    });
    card.replaceChildren(
      h("h2", { text: "reflectance" }),
      I.plot(curves, top, probed.map(spectrumWords).join(" ")),
      ...rows,
      clear,
    );
    $("live").textContent = probed
      .slice(-1)
      .map(
        (one) =>
          `${app.objectWords({ name: one.object })}. ${I.text("status_long_" + one.status)} ${spectrumWords(one)}`,
      )
      .join("");
  }

  Object.assign(app, { pixels, point, showCard });
})(window.Irodori);
