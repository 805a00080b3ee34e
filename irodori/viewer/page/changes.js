"use strict";
// Changes of the state and what follows them: the picture, the controls, the address, and words of what was refused.
(function (I) {
  const app = I.app,
    $ = I.byId;
  const calm = window.matchMedia("(prefers-reduced-motion: reduce)");

  function changed() {
    app.redraw();
    app.controls.update();
    app.showStage();
    clearTimeout(app.settling);
    app.settling = setTimeout(settle, 500);
  }

  // After a change has come to rest: the address, and words for those who do not see the picture.
  function settle() {
    clearTimeout(app.settling);
    app.settling = null;
    const at = app.pace.way ? { ...app.page, state: { ...app.page.state, camera: app.pace.way.to } } : app.page;
    const hash = I.pageToHash(at, app.base);
    history.replaceState(
      null,
      "",
      hash === I.pageToHash(app.base, app.base) ? location.pathname + location.search : "#" + hash,
    );
    tellPicture();
    if (knowsLight()) return;
    app.renderer.findLight(app.page.state, app.page.compare, () => {
      app.redraw();
      if (knowsLight()) tellPicture();
    });
  }

  const knowsLight = () => app.renderer.knowsLight(app.page.state, app.page.compare);

  function tellPicture() {
    const words = app.describe();
    if ($("live").textContent !== words) $("live").textContent = words;
    $("picture-help").textContent = words + " " + I.text("keys_" + app.tool);
    $("updating").hidden = knowsLight();
  }

  function put(next, smooth) {
    const from = app.page?.state.camera;
    app.page = next;
    app.chosenObject = Math.min(app.chosenObject, app.page.state.objects.length - 1);
    app.chosenLamp = Math.max(0, Math.min(app.chosenLamp, app.page.state.light.lamps.length - 1));
    app.chosenNote = null;
    app.pace.way = null;
    if (smooth && from && !calm.matches) {
      app.pace.way = { from: I.clone(from), to: I.clone(app.page.state.camera), since: performance.now() };
      app.page.state.camera = I.clone(from);
    }
    app.build();
    app.showCard();
    changed();
  }

  function goTo(index) {
    tell(() => put(I.pageOfStep(app.lesson.steps[index], index, keptSettings(), app.header), true));
    $("pages").scrollTop = 0;
  }

  // A refusal is told in a sentence; any other error is the page's own and is not hidden.
  function tell(act) {
    try {
      act();
    } catch (error) {
      if (!(error instanceof I.Refusal)) throw error;
      say(I.sentence(error));
    }
  }

  // A step sets the whole picture but not the learner's screen.
  const keptSettings = () => ({
    ...I.clone(app.base),
    state: { ...I.clone(app.base.state), display: I.clone(app.page.state.display) },
  });

  let saying = null;

  function say(words) {
    $("message").textContent = words;
    $("message").hidden = false;
    clearTimeout(saying);
    saying = setTimeout(
      () => {
        $("message").hidden = true;
      },
      Math.max(5000, words.length * 80),
    );
  }

  Object.assign(app, { changed, settle, put, goTo, tell, say, knowsLight });
})(window.Irodori);
