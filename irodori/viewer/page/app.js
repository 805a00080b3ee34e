'use strict';
// The page: what the learner does becomes a state, the renderer draws it, the controls and the address show it.
(function (I) {
  const h = I.h;
  const $ = (id) => document.getElementById(id);
  const canvas = $('picture'), stage = $('stage');
  const TABS = ['lesson', 'light', 'compare', 'objects', 'seeing'];
  const SLOWEST_MS = 33, IDLE_MS = 300, LONGEST_MS = 2000;
  const calm = window.matchMedia('(prefers-reduced-motion: reduce)');

  let renderer, header, base, page, lesson;
  let controls = new I.Controls();
  let tab = 'lesson', tool = 'view', chosenObject = 0, chosenLamp = 0, chosenNote = null, teaching = false;
  let probed = [], cursor = [0.5, 0.5], fileTaker = (file) => takeFile(file, null);

  // ---- drawing: as often as something changes, at a resolution that keeps 30 frames a second

  const pace = {scale: 1, ms: 0, last: 0, asked: false, dirty: false, moved: 0, shownScale: 0, way: null, frames: 0};

  function request() {
    if (pace.asked) return;
    pace.asked = true;
    requestAnimationFrame(step);
  }

  function redraw() {
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
    renderer.draw(page.state, {compare: page.compare, scale});
    pace.shownScale = scale;
    pace.frames += 1;
    layMarks();
    if (!$('rate').hidden) {
      const rate = pace.ms && pace.last ? Math.round(1000 / pace.ms) : '–';
      $('rate').textContent = I.text('rate', {rate, scale: scale.toFixed(2), width: canvas.width, height: canvas.height});
    }
  }

  function walk(now) {
    const t = Math.min(1, (now - pace.way.since) / 700), eased = t * t * (3 - 2 * t);
    page.state.camera = t < 1 ? I.between(pace.way.from, pace.way.to, eased) : pace.way.to;
    if (t >= 1) pace.way = null;
    redraw();
    if (!pace.way) settle();
  }

  function fit() {
    const box = stage.getBoundingClientRect(), dense = Math.min(2, window.devicePixelRatio || 1);
    const width = Math.max(1, Math.round(box.width * dense)), height = Math.max(1, Math.round(box.height * dense));
    if (canvas.width !== width || canvas.height !== height) {
      canvas.width = width;
      canvas.height = height;
      redraw();
    }
  }

  // ---- what changes the state

  let settling = null;

  function changed() {
    redraw();
    controls.update();
    showStage();
    clearTimeout(settling);
    settling = setTimeout(settle, 500);
  }

  // After a change has come to rest: the address, and words for those who do not see the picture.
  function settle() {
    clearTimeout(settling);
    settling = null;
    const at = pace.way ? {...page, state: {...page.state, camera: pace.way.to}} : page;
    const hash = I.pageToHash(at, base);
    history.replaceState(null, '', hash === I.pageToHash(base, base) ? location.pathname + location.search : '#' + hash);
    const words = describe();
    if ($('live').textContent !== words) $('live').textContent = words;
    $('picture-help').textContent = words + ' ' + I.text('keys_' + tool);
  }

  function put(next, smooth) {
    const from = page?.state.camera;
    page = next;
    chosenObject = Math.min(chosenObject, page.state.objects.length - 1);
    chosenLamp = Math.max(0, Math.min(chosenLamp, page.state.light.lamps.length - 1));
    chosenNote = null;
    pace.way = null;
    probed = [];
    if (smooth && from && !calm.matches) {
      pace.way = {from: I.clone(from), to: I.clone(page.state.camera), since: performance.now()};
      page.state.camera = I.clone(from);
    }
    build();
    changed();
    if (page.probes.length) whenDrawn(reprobe);
  }

  const whenDrawn = (act) => requestAnimationFrame(() => requestAnimationFrame(act));

  function goTo(index) {
    tell(() => put(I.pageOfStep(lesson.steps[index], index, keptSettings(), header), true));
    $('pages').scrollTop = 0;
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
  const keptSettings = () => ({...I.clone(base), state: {...I.clone(base.state), display: I.clone(page.state.display)}});

  let saying = null;

  function say(words) {
    $('message').textContent = words;
    $('message').hidden = false;
    clearTimeout(saying);
    saying = setTimeout(() => { $('message').hidden = true; }, Math.max(5000, words.length * 80));
  }

  // ---- words of the picture

  const illuminantWords = (one, none) => (one === null ? I.text(none) : 'name' in one ? I.nameOf('illuminant', one.name, header.illuminants.find((x) => x.name === one.name)?.label)
    : 'cct_K' in one ? `${one.cct_K} K` : one.label);
  const objectWords = (one) => I.nameOf('object', one.name, header.objects.find((x) => x.name === one.name)?.label);

  function describe() {
    const {camera, light} = page.state;
    const parts = [I.text('describe_view', {side: Math.round(camera.azimuth_deg), up: Math.round(camera.elevation_deg), away: Math.round(camera.distance_mm)}),
      I.text('describe_light', {light: illuminantWords(light.illuminant, 'as_captured'), turn: Math.round(light.turn_deg)})];
    const lamps = light.lamps.filter((one) => one.on).length;
    if (lamps) parts.push(I.text('describe_lamps', {count: lamps}));
    if (page.compare) parts.push(I.text('describe_compare', {mode: I.text('mode_' + page.compare.mode), other: page.compare.mode === 'rgb' ? '' : illuminantWords(page.compare.other.illuminant, 'as_captured'), at: Math.round(100 * page.compare.at)}));
    if (page.state.overlay) parts.push(I.text('describe_overlay', {overlay: I.text('overlay_' + page.state.overlay)}));
    if (header.environments.length > 1) parts.push(I.text('describe_room', {room: I.nameOf('environment', light.environment)}));
    const shadows = header.objects.reduce((bits, one, i) => (one.shadow ? bits | (1 << i) : bits), 0);
    if (shadows && I.shadowed(header, page.state) !== shadows) parts.push(I.text('describe_no_shadows'));
    const hidden = page.state.objects.filter((one) => !one.visible).map(objectWords);
    if (hidden.length) parts.push(I.text('describe_hidden', {names: hidden.join(', ')}));
    return parts.join(' ');
  }

  // ---- over the picture: wipe, notes, legend, ruler, probe, lamps

  const size = () => [stage.clientWidth, stage.clientHeight];

  function layMarks() {
    const marks = $('marks'), [width, height] = size(), camera = page.state.camera;
    marks.replaceChildren();
    marks.setAttribute('viewBox', `0 0 ${width} ${height}`);
    const place = (point) => I.project(camera, point, width, height);
    const both = (tag, attributes) => marks.append(I.svg(tag, {...attributes, class: 'halo'}), I.svg(tag, {...attributes, class: 'core'}));
    page.probes.forEach((point, i) => {
      const at = place(point);
      if (!at) return;
      both('circle', {cx: at[0], cy: at[1], r: 9});
      marks.append(I.svg('text', {x: at[0], y: at[1] - 15}, 'AB'[i]));
    });
    const ends = page.ruler.map(place);
    if (ends.length === 2 && ends[0] && ends[1]) {
      both('path', {d: `M${ends[0][0]} ${ends[0][1]}L${ends[1][0]} ${ends[1][1]}`});
      const words = I.text('mm', {mm: I.distance(...page.ruler).toFixed(1)});
      marks.append(I.svg('text', {x: (ends[0][0] + ends[1][0]) / 2, y: (ends[0][1] + ends[1][1]) / 2 - 10}, words));
    }
    for (const at of ends) if (at) both('circle', {cx: at[0], cy: at[1], r: 4});
    if (tool === 'lamp') page.state.light.lamps.forEach((lamp, i) => {
      if (lamp.far) return;
      const at = place(lamp.position_mm), foot = place([lamp.position_mm[0], lamp.position_mm[1], 0]);
      if (!at) return;
      if (foot) both('path', {d: `M${at[0]} ${at[1]}L${foot[0]} ${foot[1]}`, 'stroke-dasharray': '2 5'});
      both('circle', {cx: at[0], cy: at[1], r: i === chosenLamp ? 16 : 11});
      marks.append(I.svg('text', {x: at[0], y: at[1] + 5}, String(i + 1)));
    });
    if ((tool === 'probe' || tool === 'ruler') && document.activeElement === canvas && canvas.matches(':focus-visible')) {
      const x = cursor[0] * width, y = cursor[1] * height;
      both('path', {d: `M${x - 18} ${y}h12M${x + 6} ${y}h12M${x} ${y - 18}v12M${x} ${y + 6}v12`});
    }
    for (const note of $('notes').children) {
      const at = place(JSON.parse(note.dataset.at));
      note.hidden = !at || at[0] < 0 || at[1] < 0 || at[0] > width || at[1] > height;
      if (at) [note.style.left, note.style.top] = [`${at[0]}px`, `${at[1]}px`];
    }
    const [mm, px] = I.scaleBar(camera, height, Math.min(150, width / 4));
    $('scale-line').style.width = `${px}px`;
    $('scale-text').textContent = I.text('mm', {mm});
  }

  function showStage() {
    const {compare, state} = page, wipe = $('wipe');
    wipe.hidden = !compare;
    if (compare) {
      const percent = Math.round(100 * compare.at);
      wipe.style.left = `${(100 * compare.at).toFixed(3)}%`;
      wipe.setAttribute('aria-valuenow', percent);
      wipe.setAttribute('aria-valuetext', I.text('percent', {value: percent}));
      wipe.setAttribute('aria-label', I.text('wipe_line'));
      $('wipe-left').textContent = illuminantWords(state.light.illuminant, 'as_captured');
      $('wipe-right').textContent = compare.mode === 'wipe' ? illuminantWords(compare.other.illuminant, 'as_captured')
        : compare.mode === 'rgb' ? I.text('mode_rgb') : I.text('between', {mode: I.text('mode_' + compare.mode), other: illuminantWords(compare.other.illuminant, 'as_captured')});
    }
    $('wipe-left').hidden = !compare || compare.at < 0.12 || !$('card').hidden;
    $('wipe-right').hidden = !compare || compare.at > 0.97;
    const what = compare && compare.mode !== 'wipe' && compare.mode !== 'rgb' ? compare.mode : state.overlay;
    showLegend(what);
    canvas.classList.toggle('point', tool === 'probe' || tool === 'ruler');
  }

  let legendOf = null;

  function showLegend(what) {
    const key = what && what + I.language();
    if (key === legendOf) return;
    legendOf = key;
    $('legend').hidden = !what;
    if (!what) return;
    const rows = I.legend(what, header).map((one) => {
      const patch = h('i', {'aria-hidden': 'true'});
      patch.style.background = one.colour;
      return h('li', {}, patch, one.label);
    });
    $('legend').replaceChildren(h('figcaption', {text: 'legend_' + what}), h('ul', {}, ...rows));
  }

  function showNotes() {
    const notes = page.step === null ? [] : lesson?.steps[page.step]?.notes ?? [];
    $('notes').replaceChildren(...notes.map((note, i) => {
      const words = I.inLanguage(note.text);
      const mark = h('button', {type: 'button', class: 'note' + (i === chosenNote ? ' chosen' : ''), 'aria-label': I.text('note', {number: i + 1, words}), 'data-at': JSON.stringify(note.position_mm),
        on: {click: () => { chosenNote = i; say(words); showNotes(); layMarks(); $('notes').children[i].focus(); }}}, h('span', {'aria-hidden': 'true'}, String(i + 1)));
      return mark;
    }));
  }

  // ---- probe and ruler

  function pixels(x, y) {
    const [width, height] = size();
    return [(x / width) * canvas.width, (y / height) * canvas.height];
  }

  function point(x, y) {
    const found = renderer.probe(page.state, ...pixels(x, y));
    if (!found) {
      say(I.text('nothing_there'));
      return;
    }
    if (tool === 'ruler') {
      page.ruler = [...(page.ruler.length === 2 ? [] : page.ruler), found.position_mm];
      if (page.ruler.length === 2) say(I.text('ruler_reads', {mm: I.distance(...page.ruler).toFixed(1)}));
    } else {
      page.probes = [...page.probes, found.position_mm].slice(-2);
      probed = [...probed, found].slice(-2);
      showCard();
    }
    changed();
  }

  // The data of points that came with an address, where the eye sees them.
  function reprobe() {
    const [width, height] = size();
    const found = page.probes.map((one) => {
      const at = I.project(page.state.camera, one, width, height);
      return at && renderer.probe(page.state, ...pixels(at[0], at[1]));
    });
    probed = found.every(Boolean) ? found : [];
    if (!probed.length) page.probes = [];
    showCard();
    changed();
  }

  function spectrumWords(one) {
    const at = (nm) => one.reflectance[(nm - 400) / 5].toFixed(2);
    const error = Math.max(...one.sigma);
    const known = Number.isFinite(error) ? I.text('error_band', {error: (2 * error).toFixed(3)}) : I.text('error_unknown');
    return I.text('spectrum_words', {short: at(450), middle: at(550), long: at(650)}) + ' ' + known;
  }

  function showCard() {
    const card = $('card');
    card.hidden = probed.length === 0;
    showStage();
    if (card.hidden) return;
    const figure = (value, digits, unit) => (Number.isFinite(value) ? value.toFixed(digits) + unit : I.text('unknown_value'));
    const rows = probed.flatMap((one, i) => {
      const letter = probed.length > 1 ? 'AB'[i] + ' · ' : '';
      return [h('h3', {}, letter + objectWords({name: one.object})),
        h('p', {}, I.text('status_long_' + one.status)),
        h('p', {class: 'hint'}, spectrumWords(one)),
        h('dl', {}, ...[['alpha', one.alpha, 3, ''], ['beta', one.beta, 3, ''], ['mu', one.mu_rad, 3, ' rad']]
          .flatMap(([key, value, digits, unit]) => [h('dt', {text: key}), h('dd', {}, figure(value, digits, unit))]))];
    });
    const curves = probed.map((one) => ({values: Array.from(one.reflectance), sigma: Array.from(one.sigma).every(Number.isFinite) ? Array.from(one.sigma) : null}));
    const top = Math.max(1, ...curves.flatMap((one) => one.values));
    const clear = controls.button('clear', () => {
      page.probes = [];
      probed = [];
      showCard();
      changed();
      canvas.focus();
    });
    card.replaceChildren(h('h2', {text: 'reflectance'}), I.plot(curves, top, probed.map(spectrumWords).join(' ')), ...rows, clear);
    $('live').textContent = probed.slice(-1).map((one) => `${objectWords({name: one.object})}. ${I.text('status_long_' + one.status)} ${spectrumWords(one)}`).join('');
  }

  // ---- what the hand does on the picture

  const held = new Map();
  let grip = null;

  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };

  function movedOnTable(of, x, y, fromX, fromY) {
    const [width, height] = size(), z = of.position_mm[2], camera = page.state.camera;
    const a = I.onPlane(camera, fromX, fromY, width, height, z), b = I.onPlane(camera, x, y, width, height, z);
    if (a && b) shift(of, [b[0] - a[0], b[1] - a[1], 0]);
  }

  function shift(of, by) {
    of.position_mm = of.position_mm.map((value, i) => Math.min(2000, Math.max(-2000, value + by[i])));
  }

  function take(x, y) {
    if (tool === 'object') {
      const found = renderer.probe(page.state, ...pixels(x, y));
      if (found) chosenObject = page.state.objects.findIndex((one) => one.name === found.object);
    }
    if (tool === 'lamp') {
      const lamps = page.state.light.lamps, [width, height] = size();
      if (!lamps.length) say(I.text('no_lamp'));
      let nearest = 60;
      lamps.forEach((lamp, i) => {
        if (lamp.far) return;
        const at = I.project(page.state.camera, lamp.position_mm, width, height);
        const away = at ? Math.hypot(at[0] - x, at[1] - y) : Infinity;
        if (away < nearest) [nearest, chosenLamp] = [away, i];
      });
    }
  }

  function drag(x, y, fromX, fromY) {
    const dx = x - fromX, dy = y - fromY, {state} = page, lamp = state.light.lamps[chosenLamp], object = state.objects[chosenObject];
    if (tool === 'room') state.light.turn_deg = turned(state.light.turn_deg + dx * 0.4);
    else if (tool === 'object' && object) movedOnTable(object, x, y, fromX, fromY);
    else if (tool === 'lamp' && lamp) movedOnTable(lamp, x, y, fromX, fromY);
    else I.orbit(state.camera, -dx * 0.35, dy * 0.35);
    changed();
  }

  const turned = (degrees) => ((((degrees + 180) % 360) + 360) % 360) - 180;

  canvas.addEventListener('pointerdown', (event) => {
    canvas.setPointerCapture(event.pointerId);
    held.set(event.pointerId, place(event));
    pace.way = null;
    if (held.size === 1) {
      grip = {at: place(event), start: place(event), far: false, pan: event.button === 2 || event.shiftKey};
      take(...grip.at);
    } else grip = null;
  });
  canvas.addEventListener('pointermove', (event) => {
    if (!held.has(event.pointerId)) return;
    const before = held.get(event.pointerId), now = place(event);
    held.set(event.pointerId, now);
    if (held.size === 2) {
      const [a, b] = [...held.values()], other = a === now ? b : a;
      const apart = (p) => Math.max(10, Math.hypot(p[0] - other[0], p[1] - other[1]));
      I.zoom(page.state.camera, apart(before) / apart(now));
      I.pan(page.state.camera, (now[0] - before[0]) / 2, (now[1] - before[1]) / 2, stage.clientHeight);
      changed();
    } else if (grip) {
      grip.far ||= Math.hypot(now[0] - grip.start[0], now[1] - grip.start[1]) > 5;
      if (!grip.far) return;
      if (grip.pan) {
        I.pan(page.state.camera, now[0] - grip.at[0], now[1] - grip.at[1], stage.clientHeight);
        changed();
      } else drag(...now, ...grip.at);
      grip.at = now;
    }
  });
  const release = (event) => {
    held.delete(event.pointerId);
    if (event.type === 'pointerup' && grip && !grip.far && (tool === 'probe' || tool === 'ruler')) point(...place(event));
    grip = null;
  };
  canvas.addEventListener('pointerup', release);
  canvas.addEventListener('pointercancel', release);
  canvas.addEventListener('contextmenu', (event) => event.preventDefault());
  canvas.addEventListener('wheel', (event) => {
    event.preventDefault();
    pace.way = null;
    I.zoom(page.state.camera, Math.exp(Math.max(-0.4, Math.min(0.4, event.deltaY * 0.0015))));
    changed();
  }, {passive: false});
  for (const name of ['focus', 'blur']) canvas.addEventListener(name, () => page && layMarks());

  const ARROWS = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]};

  canvas.addEventListener('keydown', (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || !page) return;
    const {key} = event, {state} = page, arrow = ARROWS[key], fast = event.shiftKey;
    const of = tool === 'object' ? state.objects[chosenObject] : tool === 'lamp' ? state.light.lamps[chosenLamp] : null;
    pace.way = null;
    if (key === '+' || key === '=') I.zoom(state.camera, 1 / 1.1);
    else if (key === '-' || key === '_') I.zoom(state.camera, 1.1);
    else if (key === 'Home') state.camera = I.clone(base.state.camera);
    else if (key === 'r' || key === 'R') nextRoom();
    else if (/^[1-6]$/.test(key)) return choose(['view', 'object', 'room', 'lamp', 'probe', 'ruler'][key - 1]);
    else if (arrow && tool === 'view' && fast) I.pan(state.camera, -arrow[0] * 20, arrow[1] * 20, stage.clientHeight);
    else if (arrow && tool === 'view') I.orbit(state.camera, arrow[0] * 5, arrow[1] * 4);
    else if (arrow && tool === 'room') state.light.turn_deg = turned(state.light.turn_deg + (arrow[0] || arrow[1]) * (fast ? 1 : 5));
    else if (arrow && of) shift(of, I.onTable(state.camera, arrow[0] * (fast ? 10 : 2), arrow[1] * (fast ? 10 : 2)));
    else if (of && (key === 'PageUp' || key === 'PageDown')) shift(of, [0, 0, key === 'PageUp' ? 2 : -2]);
    else if (tool === 'object' && of && (key === ',' || key === '.')) of.turn_deg[2] = turned(of.turn_deg[2] + (key === '.' ? 5 : -5));
    else if (of && (key === 'n' || key === 'N')) {
      if (tool === 'object') chosenObject = (chosenObject + 1) % state.objects.length;
      else chosenLamp = (chosenLamp + 1) % state.light.lamps.length;
    } else if (tool === 'lamp' && !of && (arrow || key === 'Enter')) say(I.text('no_lamp'));
    else if (arrow && (tool === 'probe' || tool === 'ruler')) {
      const by = fast ? 0.05 : 0.01;
      cursor = [cursor[0] + arrow[0] * by, cursor[1] - arrow[1] * by].map((one) => Math.min(0.999, Math.max(0.001, one)));
      event.preventDefault();
      return layMarks();
    } else if ((key === 'Enter' || key === ' ') && (tool === 'probe' || tool === 'ruler')) {
      const [width, height] = size();
      point(cursor[0] * width, cursor[1] * height);
    } else return;
    event.preventDefault();
    changed();
  });

  function nextRoom() {
    const rooms = header.environments, {light} = page.state;
    if (rooms.length < 2) return say(I.text('one_room'));
    light.environment = rooms[(rooms.indexOf(light.environment) + 1) % rooms.length];
    return say(I.nameOf('environment', light.environment));
  }

  function choose(next) {
    tool = next;
    document.querySelector(`#tools input[value="${tool}"]`).checked = true;
    canvas.setAttribute('aria-label', I.text('picture_of', {title: header.title, tool: I.text('tool_' + tool)}));
    $('picture-help').textContent = describe() + ' ' + I.text('keys_' + tool);
    showStage();
    layMarks();
  }

  $('tools').addEventListener('change', (event) => choose(event.target.value));

  const wipe = $('wipe');
  const setWipe = (at) => {
    page.compare.at = Math.min(1, Math.max(0, at));
    changed();
  };
  wipe.addEventListener('pointerdown', (event) => wipe.setPointerCapture(event.pointerId));
  wipe.addEventListener('pointermove', (event) => {
    if (wipe.hasPointerCapture(event.pointerId)) setWipe((event.clientX - stage.getBoundingClientRect().left) / stage.clientWidth);
  });
  wipe.addEventListener('keydown', (event) => {
    const by = {ArrowLeft: -0.02, ArrowDown: -0.02, ArrowRight: 0.02, ArrowUp: 0.02, PageUp: 0.1, PageDown: -0.1}[event.key];
    if (by) setWipe(page.compare.at + by);
    else if (event.key === 'Home' || event.key === 'End') setWipe(event.key === 'End' ? 1 : 0);
    else return;
    event.preventDefault();
  });

  // ---- the panel

  const degrees = (value) => `${Math.round(value)}°`;
  const millimetres = (value) => I.text('mm', {mm: Math.round(value)});

  function build() {
    controls = new I.Controls();
    showNotes();
    const pages = {lesson: lessonPage, light: lightPage, compare: comparePage, objects: objectsPage, seeing: seeingPage};
    $('tabs').replaceChildren(...TABS.map((name) => h('button', {type: 'button', role: 'tab', id: 'tab-' + name, 'aria-selected': String(name === tab), 'aria-controls': 'page-' + name,
      tabindex: name === tab ? 0 : -1, text: 'tab_' + name, on: {click: () => openTab(name)}})));
    const scrolled = $('pages').scrollTop;
    $('pages').replaceChildren(...TABS.map((name) => h('div', {role: 'tabpanel', id: 'page-' + name, 'aria-labelledby': 'tab-' + name, tabindex: 0, hidden: name !== tab}, ...pages[name]())));
    $('pages').scrollTop = scrolled;
  }

  // Build anew what a change of structure asks for, and leave the focus where it was.
  function rebuild(focus) {
    build();
    changed();
    if (focus) document.querySelector(focus)?.focus();
  }

  function openTab(name) {
    tab = name;
    build();
    $('pages').scrollTop = 0;
    $('tab-' + name).focus();
  }

  $('tabs').addEventListener('keydown', (event) => {
    const names = TABS, at = names.indexOf(tab);
    const next = {ArrowRight: (at + 1) % names.length, ArrowLeft: (at + names.length - 1) % names.length, Home: 0, End: names.length - 1}[event.key];
    if (next === undefined) return;
    event.preventDefault();
    openTab(names[next]);
  });

  const paragraphs = (words) => words.trim().split(/\n\s*\n/).map((one) => h('p', {}, one.replace(/\s*\n\s*/g, ' ')));

  function lessonPage() {
    if (!lesson) return [h('p', {class: 'hint', text: 'no_lesson'}), teacherGroup()];
    const at = page.step, one = at === null ? null : lesson.steps[at], count = lesson.steps.length;
    // Words that the teacher changes in the fields below.
    const worded = (element, show) => {
      controls.updates.push(show);
      show();
      return element;
    };
    const title = h('p', {class: 'lesson-title'});
    const parts = [worded(title, () => { title.textContent = I.inLanguage(lesson.title); })];
    if (one) {
      const heading = h('h2', {class: 'step-title'}), prose = h('div', {class: 'prose'}), notes = h('ol', {class: 'noted'});
      parts.push(worded(heading, () => { heading.textContent = I.inLanguage(one.title); }), prose);
      const text = h('div', {class: 'prose'});
      prose.append(worded(text, () => { text.replaceChildren(...paragraphs(I.inLanguage(one.text))); }));
      if (one.picture) prose.append(h('img', {src: one.picture, alt: I.text('picture_of_step', {title: I.inLanguage(one.title)})}));
      if (one.notes?.length) prose.append(worded(notes, () => { notes.replaceChildren(...one.notes.map((note) => h('li', {}, I.inLanguage(note.text)))); }));
    }
    if (count) parts.push(h('div', {class: 'stepper'},
      controls.button('previous', () => stepTo((at ?? 0) - 1, '.stepper button:first-child'), {disabled: at === null || at === 0}),
      h('span', {}, at === null ? I.text('step_count', {count}) : I.text('step_of', {number: at + 1, count})),
      controls.button(at === null ? 'begin' : 'next', () => stepTo(at === null ? 0 : at + 1, '.stepper button:last-child'), {class: 'chief', disabled: at === count - 1})));
    parts.push(h('ol', {class: 'steps'}, ...lesson.steps.map((step, i) => {
      const button = h('button', {type: 'button', 'data-number': i + 1, 'aria-current': i === at ? 'step' : null, on: {click: () => stepTo(i, `.steps li:nth-child(${i + 1}) button`)}});
      return h('li', {}, worded(button, () => { button.textContent = I.inLanguage(step.title); }));
    })));
    parts.push(teacherGroup());
    return parts;
  }

  function stepTo(index, focus) {
    goTo(index);
    const again = document.querySelector(focus);
    (again && !again.disabled ? again : document.querySelector(`.steps li:nth-child(${index + 1}) button`))?.focus({preventScroll: true});
    if ($('live')) $('live').textContent = I.inLanguage(lesson.steps[index].title);
  }

  // ---- the teacher's part

  function teacherGroup() {
    const group = h('section', {class: 'group'}, h('h2', {text: 'for_teachers'}));
    if (!teaching) {
      group.append(controls.button('edit_lesson', () => {
        teaching = true;
        lesson ??= {title: {[I.language()]: header.title}, steps: []};
        rebuild('#step-title');
      }));
      return group;
    }
    const code = I.language(), at = page.step, one = at === null ? null : lesson.steps[at];
    const field = (id, key, element, value, take) => {
      element.id = id;
      element.value = value;
      element.addEventListener('input', () => take(element.value));
      return h('div', {class: 'control'}, h('label', {for: id, class: 'named', text: key}), element);
    };
    const text = () => h('input', {type: 'text', maxlength: 200});
    const written = (texts) => (words) => {
      if (words.trim()) texts[code] = words.trim();
      controls.update();
      showNotes();
      layMarks();
    };
    group.append(h('p', {class: 'hint', text: 'teacher_hint'}), field('lesson-title', 'lesson_title', text(), lesson.title[code] ?? '', written(lesson.title)));
    if (one) group.append(field('step-title', 'step_title', text(), one.title[code] ?? '', written(one.title)),
      field('step-text', 'step_text', h('textarea', {maxlength: 4000}), one.text[code] ?? '', written(one.text)),
      h('div', {class: 'row'},
        controls.button('step_takes_picture', () => {
          lesson.steps[at] = I.stepOfPage(page, one, base);
          rebuild();
          say(I.text('step_taken', {number: at + 1}));
        }),
        controls.button('note_here', () => {
          if (!page.probes.length) return say(I.text('probe_first'));
          (one.notes ??= []).push({position_mm: page.probes.at(-1).map((value) => Math.round(value * 10) / 10), text: {[code]: I.text('new_note')}});
          return rebuild('#note-' + (one.notes.length - 1));
        }, {disabled: (one.notes?.length ?? 0) >= 20}),
        controls.button('step_picture', () => askFile(takePicture)),
        ...(one.picture ? [controls.button('remove_picture', () => {
          for (const key of ['picture', 'picture_file', 'given_here']) delete one[key];
          rebuild('#step-title');
        })] : [])),
      ...(one.notes ?? []).map((note, i) => h('div', {}, field('note-' + i, 'note_text', text(), note.text[code] ?? '', written(note.text)),
        controls.button('remove_note', () => { one.notes.splice(i, 1); rebuild('#step-title'); }))),
      h('div', {class: 'row'},
        controls.button('earlier', () => moveStep(at, -1), {disabled: at === 0}),
        controls.button('later', () => moveStep(at, 1), {disabled: at === lesson.steps.length - 1}),
        controls.button('remove_step', () => {
          lesson.steps.splice(at, 1);
          page.step = null;
          rebuild('#add-step');
        })));
    group.append(controls.button('add_step', () => {
      const words = {title: {[code]: I.text('new_step')}, text: {[code]: I.text('new_text')}};
      lesson.steps.push(I.stepOfPage(page, words, base));
      page.step = lesson.steps.length - 1;
      rebuild('#step-title');
    }, {id: 'add-step', disabled: lesson.steps.length >= 100}),
    controls.button('export_lesson', exportLesson, {disabled: !lesson.steps.length}));
    return group;
  }

  function exportLesson() {
    save(new Blob([I.lessonYaml(lesson)], {type: 'text/yaml'}), `${header.scene}-lesson.yaml`);
    const pictures = I.givenPictures(lesson);
    for (const [name, address] of pictures) {
      const bytes = Uint8Array.from(atob(address.split(',')[1]), (letter) => letter.charCodeAt(0));
      save(new Blob([bytes], {type: address.slice(5, address.indexOf(';'))}), name);
    }
    if (pictures.length) say(I.text('pictures_exported', {files: pictures.map(([name]) => name).join(', ')}));
  }

  function moveStep(at, by) {
    const [one] = lesson.steps.splice(at, 1);
    lesson.steps.splice(at + by, 0, one);
    page.step = at + by;
    rebuild('#step-title');
  }

  // ---- light

  const power = (one) => renderer.power(one);

  function illuminantPicker(light, key, none) {
    return controls.illuminant({key, none, header, power, get: () => light().illuminant, set: (value) => {
      light().illuminant = value;
      changed();
    }, openFile: () => askFile((file) => takeFile(file, (power) => { light().illuminant = power; }))});
  }

  function roomControls(light) {
    const parts = [controls.slider({key: 'turn_room', low: -180, high: 180, step: 1, get: () => light().turn_deg, set: (value) => { light().turn_deg = value; changed(); }, show: degrees})];
    if (header.environments.length > 1) parts.unshift(controls.select({key: 'room', options: header.environments.map((name) => [name, I.nameOf('environment', name)]),
      get: () => light().environment, set: (value) => { light().environment = value; changed(); }}));
    return parts;
  }

  function lightPage() {
    const light = () => page.state.light, lamps = page.state.light.lamps;
    const parts = [controls.group('spectrum', illuminantPicker(light, 'illuminant', 'as_captured')), controls.group('room_group', ...roomControls(light)),
      controls.group('exposure_group', controls.slider({key: 'exposure', low: -4, high: 4, step: 0.1, get: () => page.state.exposure_ev, set: (value) => { page.state.exposure_ev = value; changed(); },
        show: (value) => I.text('stops', {value: (value > 0 ? '+' : '') + value.toFixed(1)})}))];
    const group = controls.group('lamps');
    const fits = (lamp) => I.lampPoints([...page.state.light.lamps.filter((one) => one !== lamp), {size_mm: 60}]) <= I.MOST_LAMP_POINTS;
    const resize = (lamp, set) => (value) => {
      if (value > 0 && !fits(lamp())) {
        say(I.text('too_many_balls'));
        controls.update();
      } else set(value);
    };
    lamps.forEach((own, i) => {
      if (own.far) return;
      const lamp = () => page.state.light.lamps[i] ?? lamps[i];
      const set = (key) => (value) => { lamp()[key] = value; chosenLamp = i; changed(); };
      const axis = (key, index, low, high) => controls.slider({key, low, high, step: 1, get: () => lamp().position_mm[index], show: millimetres,
        set: (value) => { lamp().position_mm[index] = value; chosenLamp = i; changed(); }});
      const name = I.text('lamp_number', {number: i + 1});
      group.append(h('fieldset', {class: 'group'}, h('legend', {}, name), h('div', {class: 'group-inner'},
        controls.tick({key: 'lamp_on', get: () => lamp().on, set: set('on')}),
        controls.slider({key: 'lamp_size', low: 0, high: 300, step: 1, get: () => lamp().size_mm, set: resize(lamp, set('size_mm')), show: millimetres}),
        controls.slider({key: 'lamp_strength', low: 0, high: 5, step: 0.05, get: () => lamp().strength, set: set('strength'), show: (value) => value.toFixed(2)}),
        axis('axis_x', 0, -500, 500), axis('axis_y', 1, -500, 500), axis('axis_z', 2, 10, 600),
        illuminantPicker(lamp, 'lamp_spectrum', 'lamp_d65'),
        controls.button('remove_lamp', () => { page.state.light.lamps.splice(i, 1); chosenLamp = 0; rebuild('#add-lamp'); }, {'aria-label': I.text('remove_lamp') + ' ' + (i + 1)}))));
    });
    group.append(controls.button('add_lamp', () => {
      page.state.light.lamps.push({position_mm: [-90 + 60 * lamps.length, -120, 160], size_mm: fits(null) ? 60 : 0, strength: 1, illuminant: null, on: true, far: false});
      chosenLamp = page.state.light.lamps.length - 1;
      choose('lamp');
      rebuild('#add-lamp');
    }, {id: 'add-lamp', disabled: lamps.length >= I.LAMPS}));
    parts.push(group);
    return parts;
  }

  function comparePage() {
    const mode = controls.choice({key: 'comparison', options: [['', 'mode_none'], ...I.choices.modes.map((one) => [one, 'mode_' + one])], get: () => page.compare?.mode ?? '', set: (value) => {
      const other = page.compare?.other ?? {...I.clone(page.state.light), illuminant: page.state.light.illuminant?.name === 'A' ? {name: 'D65'} : {name: 'A'}};
      page.compare = value === '' ? null : {mode: value, other, at: page.compare?.at ?? (value === 'wipe' || value === 'rgb' ? 0.5 : 0)};
      build();
      changed();
      document.querySelector(`#page-compare input[value="${value}"]`)?.focus();
    }});
    const parts = [mode];
    if (!page.compare) return [...parts, h('p', {class: 'hint', text: 'compare_hint'})];
    parts.push(h('p', {class: 'hint', text: 'about_' + page.compare.mode}), controls.group('line', controls.slider({key: 'wipe_line', low: 0, high: 100, step: 1, get: () => Math.round(100 * (page.compare?.at ?? 0)),
      set: (value) => setWipe(value / 100), show: (value) => I.text('percent', {value})})));
    if (page.compare.mode !== 'rgb') {
      const other = () => page.compare?.other ?? page.state.light;
      parts.push(controls.group('second_light', illuminantPicker(other, 'illuminant', 'as_captured'), ...roomControls(other)),
        controls.button('exchange', () => {
          [page.state.light, page.compare.other] = [page.compare.other, page.state.light];
          rebuild();
        }));
    }
    return parts;
  }

  function objectsPage() {
    const {objects} = page.state;
    if (!objects.length) return [h('p', {class: 'hint', text: 'no_objects'})];
    const one = () => page.state.objects[chosenObject];
    const part = (key, field, index, low, high, show) => controls.slider({key, low, high, step: 1, show, get: () => one()[field][index], set: (value) => { one()[field][index] = value; changed(); }});
    const parts = [controls.group(null,
      controls.select({key: 'object', options: objects.map((each, i) => [String(i), objectWords(each)]), get: () => String(chosenObject), set: (value) => { chosenObject = Number(value); changed(); }}),
      controls.tick({key: 'visible', get: () => one().visible, set: (value) => { one().visible = value; changed(); }})),
    controls.group('turn', part('turn_z', 'turn_deg', 2, -180, 180, degrees), part('turn_x', 'turn_deg', 0, -180, 180, degrees), part('turn_y', 'turn_deg', 1, -180, 180, degrees)),
    controls.group('place', part('axis_x', 'position_mm', 0, -250, 250, millimetres), part('axis_y', 'position_mm', 1, -250, 250, millimetres), part('axis_z', 'position_mm', 2, -100, 250, millimetres),
      controls.button('put_back', () => {
        page.state.objects[chosenObject] = I.clone(base.state.objects[chosenObject]);
        changed();
      }))];
    if (objects.length > 1) {
      let other = objects.findIndex((_, i) => i !== chosenObject);
      const pick = controls.select({key: 'swap_with', options: objects.map((each, i) => [String(i), objectWords(each)]), get: () => String(other), set: (value) => { other = Number(value); }});
      parts.push(controls.group('swap', pick, controls.button('swap_places', () => {
        const [a, b] = [one(), page.state.objects[other]];
        [a.position_mm, b.position_mm] = [b.position_mm, a.position_mm];
        changed();
      })));
    }
    return parts;
  }

  function seeingPage() {
    const {state} = page;
    const parts = [controls.group('eye',
      controls.select({key: 'observer', options: header.observers.map((one) => [one.name, I.nameOf('observer', one.name, one.label)]), get: () => page.state.observer, set: (value) => { page.state.observer = value; changed(); }}),
      controls.select({key: 'deficiency', options: [['', I.text('none')], ...I.choices.deficiencies.map((one) => [one, I.text('deficiency_' + one)])], get: () => page.state.deficiency ?? '',
        set: (value) => { page.state.deficiency = value || null; changed(); }})),
    controls.choice({key: 'overlay', options: [['', 'none'], ...I.choices.overlays.map((one) => [one, 'overlay_' + one])], get: () => page.state.overlay ?? '', set: (value) => { page.state.overlay = value || null; changed(); }})];
    const OWN = ':primaries', wide = window.matchMedia('(color-gamut: p3)').matches;
    const options = [['sRGB', 'sRGB'], ['Display P3', wide ? 'Display P3' : I.text('p3_not_here')], [OWN, I.text('own_primaries')]];
    if (!options.some(([name]) => name === base.state.display.name)) options.unshift([base.state.display.name, base.state.display.name]);
    const PROFILE = ':profile', own = state.display.profile;
    if (own) options.push([PROFILE, own.label]);
    const screen = controls.group('screen', controls.select({key: 'display', options, get: () => page.state.display.name ?? (page.state.display.profile ? PROFILE : OWN), set: (value) => {
      if (value === PROFILE) return;
      page.state.display = value === OWN ? {primaries: {red_xy: [0.64, 0.33], green_xy: [0.3, 0.6], blue_xy: [0.15, 0.06], white_xy: [0.3127, 0.329], gamma: 2.2}} : {name: value};
      rebuild('#page-seeing .group:last-of-type select');
    }}));
    if (state.display.primaries) {
      const cell = (key, i) => h('td', {}, controls.number({name: `${I.text(key)} ${'xy'[i]}`, low: 0.0001, high: 0.9, step: 0.0001, get: () => page.state.display.primaries?.[key][i] ?? '', set: (value) => { page.state.display.primaries[key][i] = value; changed(); }}));
      screen.append(h('table', {}, ...['red_xy', 'green_xy', 'blue_xy', 'white_xy'].map((key) => h('tr', {}, h('th', {scope: 'row', text: key}), cell(key, 0), cell(key, 1)))),
        controls.slider({key: 'gamma', low: 1, high: 4, step: 0.05, get: () => page.state.display.primaries?.gamma ?? 2.2, set: (value) => { page.state.display.primaries.gamma = value; changed(); }, show: (value) => value.toFixed(2)}));
    }
    screen.append(controls.button('open_profile', () => askFile((file) => takeFile(file, null))), controls.button('check_screen', checkScreen));
    parts.push(screen, controls.group('speed', controls.tick({key: 'show_rate', get: () => !$('rate').hidden, set: (value) => { $('rate').hidden = !value; redraw(); }})));
    return parts;
  }

  // ---- dialogs

  function dialog(key, ...content) {
    $('dialog-title').textContent = I.text(key);
    $('dialog-body').replaceChildren(...content);
    if (!$('dialog').open) $('dialog').showModal();
  }

  function checkScreen() {
    const patches = (codes) => h('div', {class: 'patches', 'aria-hidden': 'true'}, ...codes.map((code) => {
      const patch = h('i');
      patch.style.background = `rgb(${code} ${code} ${code})`;
      return patch;
    }));
    const dark = [0, 4, 8, 12, 16, 20, 24, 28], light = [227, 231, 235, 239, 243, 247, 251, 255];
    // Lines of black and white, one device pixel each, shine half as much as white; so does the code 188 of sRGB.
    const lines = h('canvas', {width: 400, height: 64}), pen = lines.getContext('2d');
    for (let row = 0; row < 64; row++) {
      pen.fillStyle = row % 2 ? '#fff' : '#000';
      pen.fillRect(0, row, 400, 1);
    }
    const row = h('div', {class: 'patches', 'aria-hidden': 'true'}, ...[188, null, 188].map((code) => {
      if (code === null) return lines;
      const patch = h('i');
      patch.style.background = 'rgb(188 188 188)';
      return patch;
    }));
    lines.style.cssText = `flex: none; width: ${400 / (window.devicePixelRatio || 1)}px; height: ${64 / (window.devicePixelRatio || 1)}px`;
    const verdict = h('p', {role: 'status'});
    const seen = {dark: 8, light: 8};
    const asked = new I.Controls();
    const ask = (which) => asked.slider({key: 'steps_' + which, low: 1, high: 8, step: 1, get: () => seen[which], show: String, set: (value) => {
      seen[which] = value;
      asked.update();
      verdict.textContent = I.text(Math.min(seen.dark, seen.light) >= 7 ? 'screen_good' : seen.dark < seen.light ? 'screen_dark' : 'screen_light');
    }});
    dialog('check_screen', h('p', {text: 'check_words'}), patches(dark), ask('dark'), patches(light), ask('light'), row, h('p', {text: 'check_lines'}), verdict);
  }

  const table = (rows) => h('table', {}, ...rows.map(([name, value]) => h('tr', {}, h('th', {scope: 'row'}, name), h('td', {}, value))));
  const pairOf = (one) => (one ? I.text('mean_p99', {mean: one.mean.toFixed(3), p99: one.p99.toFixed(3)}) : I.text('not_checked'));

  function truth() {
    const stated = header.stated_errors;
    const rows = [[I.text('against_cpu'), pairOf(stated.cpu)], [I.text('against_reference'), pairOf(stated.reference)], [I.text('data_loss'), pairOf(stated.data_loss)],
      [I.text('room'), header.environments.map((name) => I.nameOf('environment', name)).join(', ')], [I.text('made'), header.made],
      [I.text('programs_linked'), I.text('ms', {ms: Math.round(renderer.figures().programs_linked_ms)})], ...Object.entries(header.hashes).map(([name, value]) => [name, [value].flat().join(' ')])];
    const test = controls.button('selftest', () => selftest());
    dialog('about_picture', table(rows), test);
  }

  async function selftest() {
    dialog('selftest', h('p', {text: 'selftest_runs'}));
    try {
      const rows = await I.selftest(renderer), names = Object.keys(rows[0] ?? {});
      const cell = (value) => (typeof value === 'number' ? Number(value.toPrecision(3)) : value === null ? '–' : String(value));
      dialog('selftest', h('table', {}, h('tr', {}, ...names.map((name) => h('th', {scope: 'col'}, I.nameOf('column', name)))), ...rows.map((one) => h('tr', {}, ...names.map((name) => h('td', {}, cell(one[name])))))));
    } catch (error) {
      dialog('selftest', h('p', {}, I.sentence(error)));
    }
    redraw();
  }

  function help() {
    const keys = (key) => I.text(key).split(/(\[[^\]]+\])/).map((part) => (part.startsWith('[') && part.length > 2 ? h('kbd', {}, part.slice(1, -1)) : part));
    dialog('help', h('p', {text: 'help_words'}), table(['view', 'object', 'room', 'lamp', 'probe', 'ruler'].map((name) => [I.text('tool_' + name), h('span', {}, ...keys('help_' + name))])),
      h('p', {}, ...keys('help_all')));
  }

  function showTruthLine() {
    const {cpu, data_loss: loss} = header.stated_errors;
    $('truth-line').textContent = [I.text('truth_cpu', {error: cpu ? pairOf(cpu) : I.text('not_checked')}), I.text('truth_loss', {error: pairOf(loss)}),
      header.environments.map((name) => I.nameOf('environment', name)).join(', '), header.made].filter(Boolean).join(' · ');
  }

  // ---- files

  function save(blob, name) {
    const link = h('a', {href: URL.createObjectURL(blob), download: name});
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  }

  function snapshot() {
    renderer.draw(page.state, {compare: page.compare, scale: 1});
    canvas.toBlob(async (blob) => {
      if (!blob) return say(I.text('no_picture'));
      const bytes = new Uint8Array(await blob.arrayBuffer());
      return save(new Blob([I.pngWithText(bytes, I.pageToHash(page, base))], {type: 'image/png'}), `${header.scene}.png`);
    }, 'image/png');
  }

  // Ask for a file, and give it to a function.
  function askFile(taker) {
    fileTaker = taker;
    $('file').value = '';
    $('file').click();
  }

  function takePicture(file) {
    const step = lesson.steps[page.step];
    return reading(async () => {
      I.givePicture(lesson, step, new Uint8Array(await file.slice(0, I.MOST_PICTURE + 1).arrayBuffer()), file.name);
      rebuild('#step-title');
    });
  }

  function takeFile(file, taker) {
    return reading(async () => {
      if (file.size > 50e6) throw new I.Refusal('file_too_large', {file: file.name});
      if (/\.png$/i.test(file.name)) {
        const bytes = new Uint8Array(await file.arrayBuffer());
        put(I.hashToPage(I.textOfPng(bytes), base, header), true);
        say(I.text('snapshot_opened'));
      } else if (/\.(csv|txt|tsv)$/i.test(file.name)) {
        const power = I.powerOfTable(await file.text(), file.name);
        (taker ?? ((one) => { page.state.light.illuminant = one; }))(power);
        rebuild();
        say(I.text('light_taken', {file: file.name}));
      } else if (/\.(icc|icm)$/i.test(file.name)) {
        page.state.display = I.screenOfProfile(new Uint8Array(await file.arrayBuffer()), file.name);
        rebuild();
        say(I.text('profile_taken', {file: file.name}));
      } else throw new I.Refusal('file_unknown', {file: file.name});
    });
  }

  // As `tell`, of what takes its time.
  async function reading(act) {
    try {
      await act();
    } catch (error) {
      if (!(error instanceof I.Refusal)) throw error;
      say(I.sentence(error));
    }
  }

  $('file').addEventListener('change', () => { if ($('file').files[0]) fileTaker($('file').files[0]); });
  document.addEventListener('dragover', (event) => event.preventDefault());
  document.addEventListener('drop', (event) => {
    event.preventDefault();
    if (page && event.dataTransfer.files[0]) takeFile(event.dataTransfer.files[0], null);
  });

  // ---- the head

  function speak(code) {
    I.setLanguage(code);
    $('language').value = I.language();
    legendOf = null;
    if (!page) return;
    $('caption').textContent = header.description ?? '';
    showTruthLine();
    build();
    choose(tool);
    showCard();
    changed();
    settle();
  }

  $('reset').addEventListener('click', () => put(I.clone(base), true));
  $('snapshot').addEventListener('click', snapshot);
  $('open').addEventListener('click', () => askFile((file) => takeFile(file, null)));
  $('help-open').addEventListener('click', help);
  $('truth-open').addEventListener('click', truth);
  $('language').addEventListener('change', () => speak($('language').value));

  function fromAddress(hash) {
    if (hash === 'selftest') return void selftest();
    if (!hash) return void put(I.clone(base), false);
    put(I.clone(base), false);
    tell(() => put(I.hashToPage(hash, base, header), false));
  }

  // Where nothing can be drawn: the picture as it was rendered, and why.
  function stayStill(error) {
    document.body.classList.add('still');
    $('poster').hidden = false;
    $('truth-open').hidden = true;
    $('poster-text').textContent = error.code === 'no-webgl2' ? I.text('no_webgl2') : I.sentence(error);
  }

  async function start() {
    I.setLanguage(I.preferredLanguage());
    $('language').append(...I.languages().map(([code, name]) => h('option', {value: code, lang: code}, name)));
    $('language').value = I.language();
    try {
      const data = await I.readPayload($('payload').textContent);
      header = data.header;
      $('payload').remove();
      renderer = I.renderer = new I.Renderer(canvas, data);
      fit();
      await renderer.ready;
    } catch (error) {
      stayStill(error);
      return;
    }
    lesson = header.lesson ? I.clone(header.lesson) : null;
    if (!lesson) tab = 'light';
    base = I.newPage(renderer.defaultState());
    renderer.onlost = () => say(I.text('context_lost'));
    renderer.onrestored = () => {
      $('message').hidden = true;
      redraw();
    };
    page = I.clone(base);
    // The page writes its own state there as soon as it speaks.
    const asked = location.hash.slice(1);
    speak(I.language());
    fromAddress(asked);
    window.addEventListener('hashchange', () => fromAddress(location.hash.slice(1)));
    new ResizeObserver(fit).observe(stage);
    document.body.dataset.ready = 'yes';
  }

  // For tests and for those who look behind the page.
  I.page = () => I.clone(pace.way ? {...page, state: {...page.state, camera: pace.way.to}} : page);
  I.pace = () => ({scale: pace.scale, ms: pace.ms, frames: pace.frames, atRest: settling === null && !pace.way});
  I.lesson = () => I.clone(lesson);
  start();
})(window.Irodori);
