"use strict";
// Labelled controls made of the browser's own elements. Each is made with `get` and `set` and joins a list, whose
// `update` shows what the state has become.
window.Irodori = window.Irodori || {};
(function (I) {
  let made = 0;

  // An element; `on` holds listeners, `text` and `label` keys of the tables, the rest are attributes.
  I.h = function (tag, given, ...children) {
    const { on, text, label, ...attributes } = given || {};
    const element = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) {
      if (value === true) element.setAttribute(name, "");
      else if (value !== false && value !== undefined && value !== null) element.setAttribute(name, value);
    }
    for (const [name, listener] of Object.entries(on || {})) element.addEventListener(name, listener);
    if (text) element.textContent = I.text(text);
    if (label) element.setAttribute("aria-label", I.text(label));
    element.append(...children.filter((child) => child !== null && child !== undefined));
    return element;
  };
  const h = I.h;

  I.Controls = class {
    constructor() {
      this.updates = [];
    }

    update() {
      for (const one of this.updates) one();
    }

    // show: words of the value, in the reader's language.
    slider({ key, name, get, set, low, high, step, show }) {
      const id = `c${++made}`;
      const output = h("output", { for: id });
      const input = h("input", {
        type: "range",
        id,
        min: low,
        max: high,
        step,
        on: { input: () => set(Number(input.value)) },
      });
      const update = () => {
        input.value = get();
        output.textContent = show(get());
        input.setAttribute("aria-valuetext", show(get()));
      };
      this.updates.push(update);
      update();
      return h(
        "div",
        { class: "control" },
        h("span", { class: "named" }, h("label", { for: id }, name ?? I.text(key)), output),
        input,
      );
    }

    // options: [[value, words]] or [[group, [[value, words]]]]
    select({ key, options, get, set }) {
      const id = `c${++made}`;
      const option = ([value, words]) => h("option", { value }, words);
      const entries = options.map(([first, second]) =>
        Array.isArray(second) ? h("optgroup", { label: null }, ...second.map(option)) : option([first, second]),
      );
      options.forEach(([first, second], i) => {
        if (Array.isArray(second)) entries[i].label = first;
      });
      const input = h("select", { id, on: { change: () => set(input.value) } }, ...entries);
      const update = () => {
        input.value = get();
      };
      this.updates.push(update);
      update();
      return h("div", { class: "control" }, h("label", { for: id, class: "named" }, I.text(key)), input);
    }

    tick({ key, name, get, set }) {
      const input = h("input", { type: "checkbox", on: { change: () => set(input.checked) } });
      const update = () => {
        input.checked = get();
      };
      this.updates.push(update);
      update();
      return h("label", { class: "tick" }, input, name ?? I.text(key));
    }

    // One of several: [[value, key of its words]]
    choice({ key, options, get, set }) {
      const name = `c${++made}`;
      const inputs = options.map(([value]) =>
        h("input", { type: "radio", name, value, on: { change: () => set(value) } }),
      );
      const update = () =>
        inputs.forEach((input, i) => {
          input.checked = options[i][0] === get();
        });
      this.updates.push(update);
      update();
      const rows = options.map(([, words], i) => h("label", { class: "tick" }, inputs[i], I.text(words)));
      return h("fieldset", { class: "group" }, h("legend", { text: key }), h("div", {}, ...rows));
    }

    number({ name, get, set, low, high, step }) {
      const input = h("input", {
        type: "number",
        min: low,
        max: high,
        step,
        "aria-label": name,
        on: {
          change: () => {
            const value = Number(input.value);
            if (input.value !== "" && value >= low && value <= high) set(value);
            update();
          },
        },
      });
      const update = () => {
        input.value = get();
      };
      this.updates.push(update);
      update();
      return input;
    }

    button(key, act, given) {
      return h("button", { type: "button", text: key, ...given, on: { click: act } });
    }

    group(key, ...children) {
      return h("section", { class: "group" }, key ? h("h2", { text: key }) : null, ...children);
    }

    // The spectrum of a light: a published one, a colour temperature, drawn, or from a file.
    illuminant({ key, get, set, header, power, none, openFile }) {
      const DRAWN = ":drawn",
        WARM = ":cct",
        FILE = ":file",
        NONE = "";
      const body = h("div", { class: "group-body" });
      const kind = () => {
        const now = get();
        return now === null ? NONE : "name" in now ? now.name : "cct_K" in now ? WARM : DRAWN;
      };
      const families = {};
      for (const one of header.illuminants) {
        const family = /^D\d/.test(one.name)
          ? "daylight"
          : /^FL/.test(one.name)
            ? "fluorescent"
            : /^LED/.test(one.name)
              ? "led"
              : "other";
        (families[family] ??= []).push([one.name, I.nameOf("illuminant", one.name, one.label)]);
      }
      const options = [[NONE, I.text(none)]];
      for (const family of ["daylight", "other", "fluorescent", "led"])
        if (families[family]) options.push([I.text("family_" + family), families[family]]);
      options.push([WARM, I.text("cct")], [DRAWN, I.text("drawn")], [FILE, I.text("from_file")]);
      const select = this.select({
        key,
        options,
        get: kind,
        set: (value) => {
          if (value === FILE) {
            this.update();
            openFile();
          } else if (value === NONE) set(null);
          else if (value === WARM) set({ cct_K: 3000 });
          else if (value === DRAWN) set({ power: this.shape(get(), power), label: I.text("drawn") });
          else set({ name: value });
        },
      });
      let shown = null,
        wavelength = 30,
        inner = new I.Controls(),
        note = null;
      const strokes = (index) => {
        wavelength = index;
      };
      const update = () => {
        const now = get();
        const form = now === null ? "none" : "cct_K" in now ? "cct" : "power" in now ? "power" : "name";
        if (form === shown && now !== null) {
          body.querySelector("svg").replaceWith(this.drawing(now, power, set, strokes));
          if (note) note.textContent = now.label;
          inner.update();
          return;
        }
        shown = form;
        inner = new I.Controls();
        note = null;
        body.replaceChildren();
        if (now === null) return;
        body.append(this.drawing(now, power, set, strokes));
        if (form === "cct")
          body.append(
            inner.slider({
              // Even steps of the reciprocal look even to the eye.
              key: "cct",
              low: 40,
              high: 588,
              step: 1,
              get: () => Math.round(1e6 / get().cct_K),
              set: (mired) => set({ cct_K: Math.min(25000, Math.max(1700, Math.round(1e6 / mired))) }),
              show: (mired) => `${Math.round(1e5 / mired) * 10} K`,
            }),
          );
        if (form === "power") {
          note = h("p", { class: "hint" }, now.label);
          body.append(
            note,
            inner.slider({
              key: "wavelength",
              low: 400,
              high: 700,
              step: 5,
              get: () => 400 + 5 * wavelength,
              set: (nm) => {
                wavelength = (nm - 400) / 5;
                inner.update();
              },
              show: (nm) => `${nm} nm`,
            }),
            inner.slider({
              key: "power_there",
              low: 0,
              high: 1,
              step: 0.01,
              get: () => get().power[wavelength],
              set: (value) => set(I.drawnAt(get(), wavelength, value, 3)),
              show: (value) => value.toFixed(2),
            }),
          );
        }
      };
      this.updates.push(update);
      update();
      return h("div", { class: "group-inner" }, select, body);
    }

    // Power scaled to at most 1.
    shape(illuminant, power) {
      const values = illuminant === null ? Array(61).fill(0.5) : power(illuminant);
      const top = Math.max(...values);
      return Array.from(values, (one) => Number((one / top).toPrecision(4)));
    }

    drawing(illuminant, power, set, reached) {
      const values = this.shape(illuminant, power);
      const drawn = "power" in illuminant;
      const svg = I.plot([{ values, sigma: null }], 1, I.text("spectrum_of_light"));
      if (!drawn) return svg;
      svg.classList.add("drawable");
      const box = () => svg.getBoundingClientRect();
      const draw = (event, place) => {
        const [index, value] = I.plotPoint(place, event, 1);
        reached(index);
        illuminant = I.drawnAt(illuminant, index, value, 1);
        set(illuminant);
      };
      svg.addEventListener("pointerdown", (event) => {
        // The drawing is made anew at every stroke: the moves that follow are the window's, in the place of the first.
        const place = box();
        const move = (next) => draw(next, place);
        move(event);
        const end = () => {
          window.removeEventListener("pointermove", move);
          window.removeEventListener("pointerup", end);
          window.removeEventListener("pointercancel", end);
        };
        window.addEventListener("pointermove", move);
        window.addEventListener("pointerup", end);
        window.addEventListener("pointercancel", end);
      });
      return svg;
    }
  };

  // A drawn spectrum with another value at a sample, and its neighbours pulled along.
  I.drawnAt = function (illuminant, index, value, reach) {
    const power = illuminant.power.slice();
    for (let i = Math.max(0, index - reach); i <= Math.min(60, index + reach); i++) {
      const pull = 1 - Math.abs(i - index) / (reach + 1);
      power[i] = Number((power[i] + (value - power[i]) * pull).toPrecision(4));
    }
    // A light without any power shows nothing.
    if (!power.some((one) => one > 0)) power[index] = 0.01;
    return { power, label: I.text("drawn") };
  };
})(window.Irodori);
