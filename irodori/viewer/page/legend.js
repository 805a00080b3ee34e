"use strict";
// What the colours of maps and overlays mean: those of display.glsl.
window.Irodori = window.Irodori || {};
(function (I) {
  const MOST_DIFFERENCE = 10;
  const STATUS = { measured: "#9a9a9a", paint: "#3380ff", filled: "#ff9900", unknown: "#cc0080" };

  // x in 0..1
  function scaleColour(x) {
    const channels = [
      0.28 + x * (-0.35 + x * (0.35 + x * 0.71)),
      0.01 + x * (1.4 - x * 0.5),
      0.33 + x * (1.1 + x * (-2.9 + x * 1.6)),
    ];
    return (
      "#" +
      channels
        .map((one) =>
          Math.round(255 * Math.min(1, Math.max(0, one)))
            .toString(16)
            .padStart(2, "0"),
        )
        .join("")
    );
  }

  const scale = (top) =>
    [0, 0.25, 0.5, 0.75, 1].map((part) => ({
      label: (part === 1 ? "≥ " : "") + Number((part * top).toPrecision(2)),
      colour: scaleColour(part),
    }));

  // Rows of a legend: {label, colour}.
  I.legend = function (what, header) {
    if (what === "status")
      return Object.entries(STATUS).map(([name, colour]) => ({ label: I.text("status_" + name), colour }));
    if (what === "gamut") return [{ label: I.text("status_outside"), colour: "#ff00ff" }];
    return scale(what === "uncertainty" ? header.most_uncertainty : MOST_DIFFERENCE);
  };
})(window.Irodori);
