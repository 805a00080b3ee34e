"use strict";
// Stands for the renderer where the page's actions are tested: the same calls, a few discs instead of light transport.
window.Irodori = window.Irodori || {};
(function (I) {
  const calls = (I.calls = []);
  const finite = (value) =>
    typeof value === "number"
      ? Number.isFinite(value)
      : value === null || typeof value !== "object" || Object.values(value).every(finite);

  I.readPayload = async (text) => {
    if (window.damagedPayload) throw new Error("The data of this page are damaged.");
    return {
      header: JSON.parse(new TextDecoder().decode(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)))),
      planes: {},
    };
  };

  I.selftest = async () => [{ check: "double", mean: 0.01, p99: 0.1 }];

  I.Renderer = class {
    constructor(canvas, data) {
      if (window.noWebGL2) throw new I.Refusal("no_webgl2");
      [this.canvas, this.header] = [canvas, data.header];
      this.ready = Promise.resolve();
    }

    defaultState() {
      return {
        camera: {
          target_mm: [0, 0, 22],
          azimuth_deg: -90,
          elevation_deg: 27,
          distance_mm: 370,
          fov_deg: 34,
          roll_deg: 0,
          height_mm: 0,
        },
        light: {
          environment: "classroom",
          turn_deg: 0,
          illuminant: null,
          lamps: JSON.parse(JSON.stringify(this.header.lamps)),
        },
        objects: this.header.objects.map(({ name, position_mm }) => ({
          name,
          position_mm: [...position_mm],
          turn_deg: [0, 0, 0],
          visible: true,
        })),
        observer: this.header.observers[0].name,
        deficiency: null,
        display: { name: "sRGB" },
        exposure_ev: 0,
        overlay: null,
      };
    }

    power(one) {
      if (one.power) return one.power;
      if (one.name) return this.header.illuminants.find((each) => each.name === one.name).power;
      return Array.from({ length: 61 }, (_, i) => {
        const m = (400 + 5 * i) * 1e-9;
        return 1e-30 / (m ** 5 * (Math.exp(0.014388 / (m * one.cct_K)) - 1));
      });
    }

    tint(one) {
      if (!one) return [1, 1, 1];
      const power = this.power(one),
        band = (a, b) => power.slice(a, b).reduce((x, y) => x + y, 0) / (b - a),
        g = band(20, 40) || 1;
      return [band(40, 61) / g, 1, band(0, 20) / g].map((each) => Math.min(1.6, Math.max(0.3, each ** 0.4)));
    }

    discs(state) {
      const { width, height } = this.canvas;
      return state.objects
        .flatMap((one, i) => {
          const at = one.visible && I.project(state.camera, one.position_mm, width, height),
            r = this.header.objects[i].radius_mm;
          return at
            ? [
                {
                  i,
                  x: at[0],
                  y: at[1],
                  depth: at[2],
                  r: (r * height) / 2 / Math.tan((state.camera.fov_deg * Math.PI) / 360) / at[2],
                },
              ]
            : [];
        })
        .sort((a, b) => b.depth - a.depth);
    }

    draw(state, { compare, scale }) {
      if (!finite(state) || !finite(compare) || !(scale >= 0.25 && scale <= 1))
        throw new Error("not a number: " + JSON.stringify([state, compare, scale]));
      calls.push(scale);
      // ms of a whole picture on a machine that a test makes slow
      for (const end = performance.now() + (window.slowness || 0) * scale * scale; performance.now() < end;);
      const pen = this.canvas.getContext("2d"),
        { width, height } = this.canvas;
      const paint = (light, mode) => {
        const [r, g, b] = this.tint(light.illuminant),
          gain = 2 ** state.exposure_ev;
        const colour = (c) =>
          mode === "difference" || mode === "metamerism"
            ? "#2b3a67"
            : `rgb(${Math.min(255, c[0] * r * gain)} ${Math.min(255, c[1] * g * gain)} ${Math.min(255, c[2] * b * gain)})`;
        const sky = pen.createLinearGradient(0, 0, 0, height);
        sky.addColorStop(0, colour([190, 205, 194]));
        sky.addColorStop(0.3, colour([160, 175, 168]));
        sky.addColorStop(0.34, colour([150, 98, 70]));
        sky.addColorStop(1, colour([120, 74, 52]));
        pen.fillStyle = sky;
        pen.fillRect(0, 0, width, height);
        for (const disc of this.discs(state)) {
          const c = this.header.objects[disc.i].colour,
            turn = (light.turn_deg * Math.PI) / 180;
          const ball = pen.createRadialGradient(
            disc.x + disc.r * 0.35 * Math.sin(turn),
            disc.y - disc.r * 0.4,
            disc.r * 0.1,
            disc.x,
            disc.y,
            disc.r,
          );
          ball.addColorStop(0, colour(c.map((one) => Math.min(255, one + 60))));
          ball.addColorStop(1, colour(c.map((one) => one * 0.55)));
          pen.fillStyle = ball;
          pen.beginPath();
          pen.arc(disc.x, disc.y, disc.r, 0, 7);
          pen.fill();
        }
      };
      paint(state.light, null);
      if (compare) {
        pen.save();
        pen.beginPath();
        pen.rect(compare.at * width, 0, width, height);
        pen.clip();
        paint(compare.mode === "rgb" ? state.light : compare.other, compare.mode);
        pen.restore();
      }
    }

    probe(state, x, y) {
      const disc = this.discs(state)
        .reverse()
        .find((one) => Math.hypot(one.x - x, one.y - y) < one.r);
      if (!disc) return null;
      return this.known({ surface: disc.i, texel: [3, 4], position_mm: [...state.objects[disc.i].position_mm] });
    }

    known(place) {
      const reflectance = Array.from({ length: 61 }, (_, i) => 0.1 + 0.6 / (1 + Math.exp((40 - i) / 4)));
      return {
        ...place,
        object: this.header.objects[place.surface].name,
        reflectance,
        sigma: reflectance.map((_, i) => 0.01 + 0.0005 * i),
        alpha: 0.9,
        beta: 0.4,
        mu_rad: NaN,
        status: "paint",
      };
    }

    missing() {
      return window.missingLight ?? [];
    }

    knowsLight() {
      return true;
    }

    figures() {
      return { frames_per_s: 30, scale: 1, programs_linked_ms: 12 };
    }
  };
})(window.Irodori);
