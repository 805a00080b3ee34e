"use strict";
// What lies over the picture: wipe, notes, legend, ruler, marks of the probe, lamps, scale bar.
(function (I) {
  const app = I.app,
    h = I.h,
    $ = I.byId,
    canvas = $("picture"),
    stage = $("stage");

  const size = () => [stage.clientWidth, stage.clientHeight];

  function layMarks() {
    const marks = $("marks"),
      [width, height] = size(),
      camera = app.page.state.camera;
    marks.replaceChildren();
    marks.setAttribute("viewBox", `0 0 ${width} ${height}`);
    const place = (point) => I.project(camera, point, width, height);
    const both = (tag, attributes) =>
      marks.append(I.svg(tag, { ...attributes, class: "halo" }), I.svg(tag, { ...attributes, class: "core" }));
    app.page.probes.forEach((point, i) => {
      const at = place(point.position_mm);
      if (!at) return;
      both("circle", { cx: at[0], cy: at[1], r: 9 });
      marks.append(I.svg("text", { x: at[0], y: at[1] - 15 }, "AB"[i]));
    });
    const ends = app.page.ruler.map(place);
    if (ends.length === 2 && ends[0] && ends[1]) {
      both("path", { d: `M${ends[0][0]} ${ends[0][1]}L${ends[1][0]} ${ends[1][1]}` });
      const words = I.text("mm", { mm: I.distance(...app.page.ruler).toFixed(1) });
      marks.append(I.svg("text", { x: (ends[0][0] + ends[1][0]) / 2, y: (ends[0][1] + ends[1][1]) / 2 - 10 }, words));
    }
    for (const at of ends) if (at) both("circle", { cx: at[0], cy: at[1], r: 4 });
    if (app.tool === "lamp")
      app.page.state.light.lamps.forEach((lamp, i) => {
        if (lamp.far) return;
        const at = place(lamp.position_mm),
          foot = place([lamp.position_mm[0], lamp.position_mm[1], 0]);
        if (!at) return;
        if (foot) both("path", { d: `M${at[0]} ${at[1]}L${foot[0]} ${foot[1]}`, "stroke-dasharray": "2 5" });
        both("circle", { cx: at[0], cy: at[1], r: i === app.chosenLamp ? 16 : 11 });
        marks.append(I.svg("text", { x: at[0], y: at[1] + 5 }, String(i + 1)));
      });
    if (
      (app.tool === "probe" || app.tool === "ruler") &&
      document.activeElement === canvas &&
      canvas.matches(":focus-visible")
    ) {
      const x = app.cursor[0] * width,
        y = app.cursor[1] * height;
      both("path", { d: `M${x - 18} ${y}h12M${x + 6} ${y}h12M${x} ${y - 18}v12M${x} ${y + 6}v12` });
    }
    for (const note of $("notes").children) {
      const at = place(JSON.parse(note.dataset.at));
      note.hidden = !at || at[0] < 0 || at[1] < 0 || at[0] > width || at[1] > height;
      if (at) [note.style.left, note.style.top] = [`${at[0]}px`, `${at[1]}px`];
    }
    const [mm, px] = I.scaleBar(camera, height, Math.min(150, width / 4));
    $("scale-line").style.width = `${px}px`;
    $("scale-text").textContent = I.text("mm", { mm });
  }

  function showStage() {
    const { compare, state } = app.page,
      wipe = $("wipe");
    wipe.hidden = !compare;
    if (compare) {
      const percent = Math.round(100 * compare.at);
      wipe.style.left = `${(100 * compare.at).toFixed(3)}%`;
      wipe.setAttribute("aria-valuenow", percent);
      wipe.setAttribute("aria-valuetext", I.text("percent", { value: percent }));
      wipe.setAttribute("aria-label", I.text("wipe_line"));
      $("wipe-left").textContent = app.illuminantWords(state.light.illuminant, "as_captured");
      $("wipe-right").textContent =
        compare.mode === "wipe"
          ? app.illuminantWords(compare.other.illuminant, "as_captured")
          : compare.mode === "rgb"
            ? I.text("mode_rgb")
            : I.text("between", {
                mode: I.text("mode_" + compare.mode),
                other: app.illuminantWords(compare.other.illuminant, "as_captured"),
              });
    }
    $("wipe-left").hidden = !compare || compare.at < 0.12 || !$("card").hidden;
    $("wipe-right").hidden = !compare || compare.at > 0.97;
    const what = compare && compare.mode !== "wipe" && compare.mode !== "rgb" ? compare.mode : state.overlay;
    showLegend(what);
    canvas.classList.toggle("point", app.tool === "probe" || app.tool === "ruler");
  }

  let legendOf = null;

  function showLegend(what) {
    const key = what && what + I.language();
    if (key === legendOf) return;
    legendOf = key;
    $("legend").hidden = !what;
    if (!what) return;
    const rows = I.legend(what, app.header).map((one) => {
      const patch = h("i", { "aria-hidden": "true" });
      patch.style.background = one.colour;
      return h("li", {}, patch, one.label);
    });
    $("legend").replaceChildren(h("figcaption", { text: "legend_" + what }), h("ul", {}, ...rows));
  }

  function showNotes() {
    const notes = app.page.step === null ? [] : (app.lesson?.steps[app.page.step]?.notes ?? []);
    $("notes").replaceChildren(
      ...notes.map((note, i) => {
        const words = I.inLanguage(note.text);
        const mark = h(
          "button",
          {
            type: "button",
            class: "note" + (i === app.chosenNote ? " chosen" : ""),
            "aria-label": I.text("note", { number: i + 1, words }),
            "data-at": JSON.stringify(note.position_mm),
            on: {
              click: () => {
                app.chosenNote = i;
                app.say(words);
                showNotes();
                layMarks();
                $("notes").children[i].focus();
              },
            },
          },
          h("span", { "aria-hidden": "true" }, String(i + 1)),
        );
        return mark;
      }),
    );
  }

  Object.assign(app, { size, layMarks, showStage, showNotes });
})(window.Irodori);
