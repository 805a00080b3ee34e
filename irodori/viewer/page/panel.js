"use strict";
// The panel beside the picture and its tabs; each page of it has a script of its own.
(function (I) {
  const app = I.app,
    h = I.h,
    $ = I.byId;

  const TABS = ["lesson", "light", "compare", "objects", "seeing"];

  const degrees = (value) => `${Math.round(value)}°`;
  const millimetres = (value) => I.text("mm", { mm: Math.round(value) });

  function build() {
    app.controls = new I.Controls();
    app.showNotes();
    const pages = {
      lesson: app.lessonPage,
      light: app.lightPage,
      compare: app.comparePage,
      objects: app.objectsPage,
      seeing: app.seeingPage,
    };
    $("tabs").replaceChildren(
      ...TABS.map((name) =>
        h("button", {
          type: "button",
          role: "tab",
          id: "tab-" + name,
          "aria-selected": String(name === app.tab),
          "aria-controls": "page-" + name,
          tabindex: name === app.tab ? 0 : -1,
          text: "tab_" + name,
          on: { click: () => openTab(name) },
        }),
      ),
    );
    const scrolled = $("pages").scrollTop;
    $("pages").replaceChildren(
      ...TABS.map((name) =>
        h(
          "div",
          {
            role: "tabpanel",
            id: "page-" + name,
            "aria-labelledby": "tab-" + name,
            tabindex: 0,
            hidden: name !== app.tab,
          },
          ...pages[name](),
        ),
      ),
    );
    $("pages").scrollTop = scrolled;
  }

  // Build anew what a change of structure asks for, and leave the focus where it was.
  function rebuild(focus) {
    build();
    app.changed();
    if (focus) document.querySelector(focus)?.focus();
  }

  function openTab(name) {
    app.tab = name;
    build();
    $("pages").scrollTop = 0;
    $("tab-" + name).focus();
  }

  $("tabs").addEventListener("keydown", (event) => {
    const names = TABS,
      at = names.indexOf(app.tab);
    const next = {
      ArrowRight: (at + 1) % names.length,
      ArrowLeft: (at + names.length - 1) % names.length,
      Home: 0,
      End: names.length - 1,
    }[event.key];
    if (next === undefined) return;
    event.preventDefault();
    openTab(names[next]);
  });

  Object.assign(app, { degrees, millimetres, build, rebuild });
})(window.Irodori);
