"use strict";
// Frames: as often as something changes, at a resolution that keeps 30 of them a second.
(function (I) {
  const app = I.app,
    $ = I.byId,
    canvas = $("picture"),
    stage = $("stage");

  const SLOWEST_MS = 33,
    IDLE_MS = 300,
    LONGEST_MS = 2000;

  const pace = { scale: 1, ms: 0, last: 0, asked: false, dirty: false, moved: 0, shownScale: 0, way: null, frames: 0 };

  function request() {
    if (pace.asked) return;
    pace.asked = true;
    requestAnimationFrame(step);
  }

  function redraw() {
    if (!app.page) return; // the size of the picture is known before there is one
    pace.dirty = true;
    pace.moved = performance.now();
    request();
  }

  function step(now) {
    pace.asked = false;
    if (pace.way) walk(now);
    if (pace.dirty) {
      pace.dirty = false;
      measure(now);
      draw(pace.scale);
      request();
    } else if (pace.shownScale < 1 && pace.shownScale < finest()) {
      pace.last = 0;
      if (performance.now() - pace.moved > IDLE_MS) draw(finest());
      else request();
    } else pace.last = 0;
  }

  // Frames that follow each other without a rest tell how long one takes.
  function measure(now) {
    if (pace.last) {
      const took = now - pace.last;
      pace.ms = pace.ms ? 0.8 * pace.ms + 0.2 * took : took;
      if (pace.ms > 1.15 * SLOWEST_MS) {
        pace.scale = Math.max(0.25, pace.scale * 0.85);
        pace.ms *= 0.8;
      } else if (pace.ms < 0.6 * SLOWEST_MS) pace.scale = Math.min(1, pace.scale * 1.08);
    }
    pace.last = now;
  }

  // A picture at rest is drawn whole, unless that would hold up the page for longer than two seconds.
  const finest = () => Math.min(1, pace.ms ? pace.scale * Math.sqrt(LONGEST_MS / pace.ms) : 1);

  function draw(scale) {
    app.renderer.draw(app.page.state, { compare: app.page.compare, scale });
    pace.shownScale = scale;
    pace.frames += 1;
    app.layMarks();
    if (!$("rate").hidden) {
      const rate = pace.ms && pace.last ? Math.round(1000 / pace.ms) : "–";
      $("rate").textContent = I.text("rate", {
        rate,
        scale: scale.toFixed(2),
        width: canvas.width,
        height: canvas.height,
      });
    }
  }

  function walk(now) {
    const t = Math.min(1, (now - pace.way.since) / 700),
      eased = t * t * (3 - 2 * t);
    app.page.state.camera = t < 1 ? I.between(pace.way.from, pace.way.to, eased) : pace.way.to;
    if (t >= 1) pace.way = null;
    redraw();
    if (!pace.way) app.settle();
  }

  function fit() {
    const box = stage.getBoundingClientRect(),
      dense = Math.min(2, window.devicePixelRatio || 1);
    const width = Math.max(1, Math.round(box.width * dense)),
      height = Math.max(1, Math.round(box.height * dense));
    if (canvas.width !== width || canvas.height !== height) {
      canvas.width = width;
      canvas.height = height;
      redraw();
    }
  }

  Object.assign(app, { pace, redraw, fit });
})(window.Irodori);
