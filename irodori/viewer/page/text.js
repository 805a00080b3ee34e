"use strict";
// Words of the page in the reader's language, from the tables that stand in the page.
window.Irodori = window.Irodori || {};
(function (I) {
  const tables = JSON.parse(document.getElementById("languages").textContent);
  let current = "en";

  I.byId = (id) => document.getElementById(id);

  // An error whose sentence is in the tables: one clear sentence for the reader.
  I.Refusal = class extends Error {
    constructor(key, values) {
      super(key);
      this.key = key;
      this.values = values || {};
    }
  };

  I.languages = () => Object.keys(tables).map((code) => [code, tables[code]._name]);
  I.language = () => current;

  I.text = function (key, values) {
    const words = tables[current][key] ?? tables.en[key];
    if (words === undefined) throw new Error("no words for " + key);
    return words.replace(/\{(\w+)\}/g, (_, name) => (values && name in values ? values[name] : "?"));
  };

  // Words of a thing that may have its own, or else the name it came with.
  I.nameOf = (kind, name, label) => tables[current][kind + ":" + name] ?? tables.en[kind + ":" + name] ?? label ?? name;

  // A text given by language: the reader's, or English, or the first.
  I.inLanguage = (texts) => texts[current] ?? texts.en ?? Object.values(texts)[0] ?? "";

  I.sentence = (error) => (error instanceof I.Refusal ? I.text(error.key, error.values) : error.message);

  I.setLanguage = function (code) {
    current = tables[code] ? code : "en";
    document.documentElement.lang = current;
    for (const one of document.querySelectorAll("[data-text]")) one.textContent = I.text(one.dataset.text);
    for (const one of document.querySelectorAll("[data-label]"))
      one.setAttribute("aria-label", I.text(one.dataset.label));
  };

  I.preferredLanguage = function () {
    for (const wanted of navigator.languages || []) {
      const code = wanted.slice(0, 2).toLowerCase();
      if (tables[code]) return code;
    }
    return "en";
  };
})(window.Irodori);
