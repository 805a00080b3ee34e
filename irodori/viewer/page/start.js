"use strict";
// The start: the head of the page, its address, and the data that it opens with.
(function (I) {
  const app = I.app,
    h = I.h,
    $ = I.byId,
    canvas = $("picture"),
    stage = $("stage");

  function speak(code) {
    I.setLanguage(code);
    $("language").value = I.language();
    if (!app.page) return;
    $("caption").textContent = app.header.description ?? "";
    app.showTruthLine();
    app.build();
    app.choose(app.tool);
    app.showCard();
    app.changed();
    app.settle();
  }

  $("reset").addEventListener("click", () => app.put(I.clone(app.base), true));
  $("snapshot").addEventListener("click", app.snapshot);
  $("open").addEventListener("click", () => app.askFile((file) => app.takeFile(file, null)));
  $("help-open").addEventListener("click", app.help);
  $("truth-open").addEventListener("click", app.truth);
  $("language").addEventListener("change", () => speak($("language").value));

  function fromAddress(hash) {
    if (hash === "selftest") return void app.selftest();
    if (!hash) return void app.put(I.clone(app.base), false);
    app.put(I.clone(app.base), false);
    app.tell(() => app.put(I.hashToPage(hash, app.base, app.header, app.lesson), false));
  }

  // Where nothing can be drawn: the picture as it was rendered, and why.
  function stayStill(error) {
    document.body.classList.add("still");
    $("poster").hidden = false;
    $("truth-open").hidden = true;
    $("poster-text").textContent = I.sentence(error);
  }

  async function start() {
    I.setLanguage(I.preferredLanguage());
    $("language").append(...I.languages().map(([code, name]) => h("option", { value: code, lang: code }, name)));
    $("language").value = I.language();
    try {
      const data = await I.readPayload($("payload").textContent);
      app.header = data.header;
      $("payload").remove();
      app.renderer = I.renderer = new I.Renderer(canvas, data);
      app.fit();
      await app.renderer.ready;
    } catch (error) {
      stayStill(error);
      return;
    }
    app.lesson = app.header.lesson ? I.clone(app.header.lesson) : null;
    if (!app.lesson) app.tab = "light";
    app.base = I.newPage(app.renderer.defaultState());
    app.renderer.onlost = () => app.say(I.text("context_lost"));
    app.renderer.onrestored = () => {
      $("message").hidden = true;
      app.redraw();
      app.settle();
    };
    app.page = I.clone(app.base);
    // The page writes its own state there as soon as it speaks.
    const asked = location.hash.slice(1);
    speak(I.language());
    fromAddress(asked);
    window.addEventListener("hashchange", () => fromAddress(location.hash.slice(1)));
    new ResizeObserver(app.fit).observe(stage);
    document.body.dataset.ready = "yes";
  }

  // For tests and for those who look behind the page.
  I.page = () =>
    I.clone(app.pace.way ? { ...app.page, state: { ...app.page.state, camera: app.pace.way.to } } : app.page);
  I.pace = () => ({
    scale: app.pace.scale,
    ms: app.pace.ms,
    frames: app.pace.frames,
    atRest: app.settling === null && !app.pace.way,
  });
  I.lesson = () => I.clone(app.lesson);
  start();
})(window.Irodori);
