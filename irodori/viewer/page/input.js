"use strict";
// Input: what pointer, fingers, wheel and keys do on the picture and on the line that divides it.
(function (I) {
  const app = I.app,
    $ = I.byId,
    canvas = $("picture"),
    stage = $("stage");

  const held = new Map();
  let grip = null;

  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };

  function movedOnTable(of, x, y, fromX, fromY) {
    const [width, height] = app.size(),
      z = of.position_mm[2],
      camera = app.page.state.camera;
    const a = I.onPlane(camera, fromX, fromY, width, height, z),
      b = I.onPlane(camera, x, y, width, height, z);
    if (a && b) shift(of, [b[0] - a[0], b[1] - a[1], 0]);
  }

  function shift(of, by) {
    of.position_mm = of.position_mm.map((value, i) => Math.min(2000, Math.max(-2000, value + by[i])));
  }

  function take(x, y) {
    if (app.tool === "object") {
      const found = app.renderer.probe(app.page.state, ...app.pixels(x, y));
      if (found) app.chosenObject = app.page.state.objects.findIndex((one) => one.name === found.object);
    }
    if (app.tool === "lamp") {
      const lamps = app.page.state.light.lamps,
        [width, height] = app.size();
      if (!lamps.length) app.say(I.text("no_lamp"));
      let nearest = 60;
      lamps.forEach((lamp, i) => {
        if (lamp.far) return;
        const at = I.project(app.page.state.camera, lamp.position_mm, width, height);
        const away = at ? Math.hypot(at[0] - x, at[1] - y) : Infinity;
        if (away < nearest) [nearest, app.chosenLamp] = [away, i];
      });
    }
  }

  function drag(x, y, fromX, fromY) {
    const dx = x - fromX,
      dy = y - fromY,
      { state } = app.page,
      lamp = state.light.lamps[app.chosenLamp],
      object = state.objects[app.chosenObject];
    if (app.tool === "room") state.light.turn_deg = turned(state.light.turn_deg + dx * 0.4);
    else if (app.tool === "object" && object) movedOnTable(object, x, y, fromX, fromY);
    else if (app.tool === "lamp" && lamp) movedOnTable(lamp, x, y, fromX, fromY);
    else I.orbit(state.camera, -dx * 0.35, dy * 0.35);
    app.changed();
  }

  const turned = (degrees) => ((((degrees + 180) % 360) + 360) % 360) - 180;

  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    held.set(event.pointerId, place(event));
    app.pace.way = null;
    if (held.size === 1) {
      grip = { at: place(event), start: place(event), far: false, pan: event.button === 2 || event.shiftKey };
      take(...grip.at);
    } else grip = null;
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!held.has(event.pointerId)) return;
    const before = held.get(event.pointerId),
      now = place(event);
    held.set(event.pointerId, now);
    if (held.size === 2) {
      const [a, b] = [...held.values()],
        other = a === now ? b : a;
      const apart = (p) => Math.max(10, Math.hypot(p[0] - other[0], p[1] - other[1]));
      I.zoom(app.page.state.camera, apart(before) / apart(now));
      I.pan(app.page.state.camera, (now[0] - before[0]) / 2, (now[1] - before[1]) / 2, stage.clientHeight);
      app.changed();
    } else if (grip) {
      grip.far ||= Math.hypot(now[0] - grip.start[0], now[1] - grip.start[1]) > 5;
      if (!grip.far) return;
      if (grip.pan) {
        I.pan(app.page.state.camera, now[0] - grip.at[0], now[1] - grip.at[1], stage.clientHeight);
        app.changed();
      } else drag(...now, ...grip.at);
      grip.at = now;
    }
  });
  const release = (event) => {
    held.delete(event.pointerId);
    if (event.type === "pointerup" && grip && !grip.far && (app.tool === "probe" || app.tool === "ruler"))
      app.point(...place(event));
    grip = null;
  };
  canvas.addEventListener("pointerup", release);
  canvas.addEventListener("pointercancel", release);
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      app.pace.way = null;
      I.zoom(app.page.state.camera, Math.exp(Math.max(-0.4, Math.min(0.4, event.deltaY * 0.0015))));
      app.changed();
    },
    { passive: false },
  );
  for (const name of ["focus", "blur"]) canvas.addEventListener(name, () => app.page && app.layMarks());

  const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || !app.page) return;
    const { key } = event,
      { state } = app.page,
      arrow = ARROWS[key],
      fast = event.shiftKey;
    const of =
      app.tool === "object"
        ? state.objects[app.chosenObject]
        : app.tool === "lamp"
          ? state.light.lamps[app.chosenLamp]
          : null;
    app.pace.way = null;
    if (key === "+" || key === "=") I.zoom(state.camera, 1 / 1.1);
    else if (key === "-" || key === "_") I.zoom(state.camera, 1.1);
    else if (key === "Home") state.camera = I.clone(app.base.state.camera);
    else if (key === "r" || key === "R") nextRoom();
    else if (/^[1-6]$/.test(key)) return choose(["view", "object", "room", "lamp", "probe", "ruler"][key - 1]);
    else if (arrow && app.tool === "view" && fast)
      I.pan(state.camera, -arrow[0] * 20, arrow[1] * 20, stage.clientHeight);
    else if (arrow && app.tool === "view") I.orbit(state.camera, arrow[0] * 5, arrow[1] * 4);
    else if (arrow && app.tool === "room")
      state.light.turn_deg = turned(state.light.turn_deg + (arrow[0] || arrow[1]) * (fast ? 1 : 5));
    else if (arrow && of) shift(of, I.onTable(state.camera, arrow[0] * (fast ? 10 : 2), arrow[1] * (fast ? 10 : 2)));
    else if (of && (key === "PageUp" || key === "PageDown")) shift(of, [0, 0, key === "PageUp" ? 2 : -2]);
    else if (app.tool === "object" && of && (key === "," || key === "."))
      of.turn_deg[2] = turned(of.turn_deg[2] + (key === "." ? 5 : -5));
    else if (of && (key === "n" || key === "N")) {
      if (app.tool === "object") app.chosenObject = (app.chosenObject + 1) % state.objects.length;
      else app.chosenLamp = (app.chosenLamp + 1) % state.light.lamps.length;
    } else if (app.tool === "lamp" && !of && (arrow || key === "Enter")) app.say(I.text("no_lamp"));
    else if (arrow && (app.tool === "probe" || app.tool === "ruler")) {
      const by = fast ? 0.05 : 0.01;
      app.cursor = [app.cursor[0] + arrow[0] * by, app.cursor[1] - arrow[1] * by].map((one) =>
        Math.min(0.999, Math.max(0.001, one)),
      );
      event.preventDefault();
      return app.layMarks();
    } else if ((key === "Enter" || key === " ") && (app.tool === "probe" || app.tool === "ruler")) {
      const [width, height] = app.size();
      app.point(app.cursor[0] * width, app.cursor[1] * height);
    } else return;
    event.preventDefault();
    app.changed();
  });

  function nextRoom() {
    const rooms = app.header.environments,
      { light } = app.page.state;
    if (rooms.length < 2) return app.say(I.text("one_room"));
    light.environment = rooms[(rooms.indexOf(light.environment) + 1) % rooms.length];
    return app.say(I.nameOf("environment", light.environment));
  }

  function choose(next) {
    app.tool = next;
    document.querySelector(`#tools input[value="${app.tool}"]`).checked = true;
    canvas.setAttribute(
      "aria-label",
      I.text("picture_of", { title: app.header.title, tool: I.text("tool_" + app.tool) }),
    );
    $("picture-help").textContent = app.describe() + " " + I.text("keys_" + app.tool);
    app.showStage();
    app.layMarks();
  }

  $("tools").addEventListener("change", (event) => choose(event.target.value));

  const wipe = $("wipe");
  const setWipe = (at) => {
    app.page.compare.at = Math.min(1, Math.max(0, at));
    app.changed();
  };
  wipe.addEventListener("pointerdown", (event) => wipe.setPointerCapture(event.pointerId));
  wipe.addEventListener("pointermove", (event) => {
    if (wipe.hasPointerCapture(event.pointerId))
      setWipe((event.clientX - stage.getBoundingClientRect().left) / stage.clientWidth);
  });
  wipe.addEventListener("keydown", (event) => {
    const by = { ArrowLeft: -0.02, ArrowDown: -0.02, ArrowRight: 0.02, ArrowUp: 0.02, PageUp: 0.1, PageDown: -0.1 }[
      event.key
    ];
    if (by) setWipe(app.page.compare.at + by);
    else if (event.key === "Home" || event.key === "End") setWipe(event.key === "End" ? 1 : 0);
    else return;
    event.preventDefault();
  });

  Object.assign(app, { choose, setWipe });
})(window.Irodori);
