"use strict";
// Spectra as line drawings.
window.Irodori = window.Irodori || {};
(function (I) {
  const W = 320,
    H = 160,
    LEFT = 30,
    RIGHT = 8,
    TOP = 8,
    BOTTOM = 30;
  const x = (i) => LEFT + (i / 60) * (W - LEFT - RIGHT);
  const y = (value, top) => H - BOTTOM - (Math.min(value, top * 1.02) / top) * (H - TOP - BOTTOM);

  I.svg = function (tag, attributes, ...children) {
    const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const [name, value] of Object.entries(attributes || {})) made.setAttribute(name, value);
    made.append(...children);
    return made;
  };

  // A hint of the spectrum's colours under the axis; for orientation only.
  const HUES = [
    [400, "#4b2a7a"],
    [440, "#2f3fae"],
    [480, "#2f87a8"],
    [510, "#2f9a5f"],
    [550, "#6fae3c"],
    [580, "#c2b23a"],
    [610, "#c47a35"],
    [650, "#a83a34"],
    [700, "#6e2224"],
  ];

  // curves: [{values: 61 numbers, sigma: 61 numbers or null}], at most two; top: value at the upper edge.
  I.plot = function (curves, top, title) {
    const made = I.svg("svg", { class: "plot", viewBox: `0 0 ${W} ${H}`, role: "img", "aria-label": title });
    const hues = I.svg("linearGradient", { id: "hues" });
    for (const [nm, colour] of HUES) hues.append(I.svg("stop", { offset: `${(nm - 400) / 3}%`, "stop-color": colour }));
    made.append(I.svg("defs", {}, hues));
    made.append(I.svg("rect", { x: LEFT, y: H - BOTTOM + 1, width: W - LEFT - RIGHT, height: 6, fill: "url(#hues)" }));
    made.append(I.svg("path", { class: "axis", d: `M${LEFT} ${TOP}V${H - BOTTOM}H${W - RIGHT}` }));
    for (const nm of [400, 500, 600, 700])
      made.append(
        I.svg(
          "text",
          { x: x((nm - 400) / 5), y: H - 8, "text-anchor": nm === 400 ? "start" : nm === 700 ? "end" : "middle" },
          nm === 700 ? "700 nm" : String(nm),
        ),
      );
    for (const part of [0, 0.5, 1])
      made.append(
        I.svg(
          "text",
          { x: LEFT - 5, y: y(part * top, top) + 4, "text-anchor": "end" },
          String(Number((part * top).toPrecision(2))),
        ),
      );
    curves.forEach((curve, number) => {
      const path = (values) => values.map((value, i) => `${x(i).toFixed(1)} ${y(Math.max(0, value), top).toFixed(1)}`);
      if (curve.sigma) {
        const upper = path(curve.values.map((value, i) => value + 2 * curve.sigma[i]));
        const lower = path(curve.values.map((value, i) => value - 2 * curve.sigma[i])).reverse();
        made.append(I.svg("path", { class: "band", d: "M" + [...upper, ...lower].join("L") + "Z" }));
      }
      made.append(I.svg("path", { class: number ? "curve second" : "curve", d: "M" + path(curve.values).join("L") }));
    });
    return made;
  };

  // Sample and value under an event, of a plot that fills a box of the window.
  I.plotPoint = function (box, event, top) {
    const px = ((event.clientX - box.left) / box.width) * W,
      py = ((event.clientY - box.top) / box.height) * H;
    const index = Math.round(((px - LEFT) / (W - LEFT - RIGHT)) * 60);
    const value = ((H - BOTTOM - py) / (H - TOP - BOTTOM)) * top;
    return [Math.min(60, Math.max(0, index)), Math.min(top, Math.max(0, value))];
  };
})(window.Irodori);
